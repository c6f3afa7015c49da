"""Signals over time: what is drawn where, and that no peak is lost on the way."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image

from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import ErrorCode, Inhibit, Mode, SteerDriver, SteerStatus
from telemetry.databases import load_databases
from telemetry.decode.tables import Decoded, Decoder
from telemetry.logs.frames import ChannelNames, FrameFlag, LogFrame, columns_of
from telemetry.plot.model import Line, Plot, plot_of, thinned
from telemetry.plot.page import write_page
from telemetry.plot.png import write_png
from tests.scenarios.driving import supervisor_state

MS = 1_000_000
ANGLE = ("STEER_STATUS", "steering_wheel_angle_rad")
APPLIED = ("STEER_STATUS", "applied_steering_wheel_angle_rad")
INHIBIT = ("SUPERVISOR_STATE", "inhibit")


def frame(time_ms: int, name: str, message: object, counter: int, crc_error: int = 0) -> LogFrame:
    found = encode(SPEC_OF_NAME[name], message, counter)
    data = bytes([found.data[0] ^ crc_error, *found.data[1:]])
    return LogFrame(time_ms * MS, "can0", found.can_id, FrameFlag(0), len(data), data)


def steer(time_ms: int, angle_rad: float, crc_error: int = 0) -> LogFrame:
    message = SteerStatus(
        steering_wheel_angle_rad=angle_rad, applied_steering_wheel_angle_rad=math.nan
    )
    return frame(time_ms, "STEER_STATUS", message, time_ms // 10 % 15, crc_error)


def state(time_ms: int, mode: Mode) -> LogFrame:
    return frame(time_ms, "SUPERVISOR_STATE", supervisor_state(mode), time_ms // 10 % 15)


def decoded(*frames: LogFrame) -> Decoded:
    columns = columns_of(frames, range(1, len(frames) + 1), ChannelNames())
    return Decoder(load_databases(())).decode(columns)


def plot(*frames: LogFrame, signals: tuple[tuple[str, str], ...] = (ANGLE,)) -> Plot:
    return plot_of(decoded(*frames), signals, title="drive.log", zero_ns=0)


def a_drive() -> Plot:
    """Three modes, an angle, and what held the car back."""
    modes = [Mode.MANUAL] * 10 + [Mode.AUTOMATIC] * 10 + [Mode.EMERGENCY] * 10
    frames = [item for n, mode in enumerate(modes) for item in (state(10 * n, mode),
              steer(10 * n + 2, 0.1 * n))]  # fmt: skip
    return plot(*frames, signals=(ANGLE, INHIBIT, APPLIED))


def test_signals_of_one_unit_share_a_panel_and_names_have_their_own() -> None:
    angle, inhibit = a_drive().panels
    assert [line.label for line in angle.lines] == [".".join(ANGLE), ".".join(APPLIED)]
    assert angle.unit == "rad" and not angle.names
    assert inhibit.names == (Inhibit.NONE.name,)
    assert set(inhibit.lines[0].value) == {0.0}


def test_modes_last_until_the_next_one_comes() -> None:
    modes = a_drive().modes
    assert modes is not None
    assert [(span.mode, span.start_s, span.end_s) for span in modes] == [
        (Mode.MANUAL, 0.0, 0.1), (Mode.AUTOMATIC, 0.1, 0.2), (Mode.EMERGENCY, 0.2, 0.29),
    ]  # fmt: skip


def test_codes_are_bands_from_any_node_that_tells_them() -> None:
    fields = dict.fromkeys(SteerDriver.__dataclass_fields__, 0)
    quiet = SteerDriver(**fields)  # type: ignore[arg-type]
    loud = SteerDriver(**{**fields, "er4": True})  # type: ignore[arg-type]
    frames = [state(0, Mode.MANUAL)]
    frames += [
        frame(20 * n, "STEER_DRIVER", loud if 3 <= n < 6 else quiet, n % 15) for n in range(10)
    ]
    codes = plot(*frames, steer(5, 0.0)).codes
    (span,) = codes
    assert (span.code, span.start_s, span.end_s) == (ErrorCode.ER4, 0.06, 0.12)


def test_a_silence_is_a_gap_and_no_value_is_none() -> None:
    line = plot(*(steer(10 * n, 1.0) for n in range(20)), steer(500, 2.0)).panels[0].lines[0]
    assert line.value[-1] == pytest.approx(2.0) and math.isnan(line.value[-2])
    assert line.time_s[-2] == pytest.approx(0.2), "a cycle after the last frame"
    assert np.all(np.diff(line.time_s) > 0)
    (applied,) = plot(steer(0, 1.0), signals=(APPLIED,)).panels[0].lines
    assert np.isnan(applied.value).all() and not applied.names


def test_frames_with_a_wrong_crc_are_left_out_and_counted() -> None:
    result = plot(steer(0, 1.0), steer(10, 9.0, crc_error=1), steer(20, 1.0))
    assert result.left_out == 1
    assert result.panels[0].lines[0].value.tolist() == pytest.approx([1.0, 1.0])
    assert result.modes is None


def test_thinning_keeps_every_peak() -> None:
    value = np.zeros(100_000)
    value[31_417], value[92_653] = 5.0, -3.0
    value[50_000:50_500] = np.nan
    line = Line(label="", time_s=np.arange(100_000) / 100.0, value=value, names=())
    time_s, few = thinned(line, points_max=2_000)
    assert len(few) == len(time_s) == 2_000
    assert np.nanmax(few) == 5.0 and np.nanmin(few) == -3.0
    assert time_s[np.nanargmax(few)] == pytest.approx(314.17, abs=1.0)
    assert np.isnan(few).any()
    same_time_s, same = thinned(line, points_max=100_000)
    assert same is value and same_time_s is line.time_s


def test_the_picture_has_lines_and_modes(tmp_path: Path) -> None:
    write_png(tmp_path / "plot.png", a_drive())
    pixels = np.asarray(image.imread(tmp_path / "plot.png"))
    height, width, _ = pixels.shape
    assert width == 1950 and height > 600
    emergency = np.array([0xD5, 0x5E, 0x00]) / 255.0
    assert (np.abs(pixels[..., :3] - emergency).max(axis=2) < 0.01).sum() > 5_000


def test_the_page_holds_everything_and_loads_nothing(tmp_path: Path) -> None:
    write_page(tmp_path / "plot.html", a_drive())
    page = (tmp_path / "plot.html").read_text(encoding="utf-8")
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=", page)
    found = re.search(r"const plot = (\{.*\});", page)
    assert found
    content = json.loads(found[1])
    assert [panel["unit"] for panel in content["panels"]] == ["rad", ""]
    angle, applied = content["panels"][0]["lines"]
    assert len(angle["time"]) == len(angle["value"]) == 30
    assert applied["value"] == [None] * 30
    assert [span["name"] for span in content["modes"]] == ["MANUAL", "AUTOMATIC", "EMERGENCY"]


def test_a_name_from_a_dbc_cannot_end_the_script(tmp_path: Path) -> None:
    result = a_drive()
    evil = Line(
        label="</script><b>", time_s=np.zeros(1), value=np.zeros(1), names=("</script>",)
    )
    panels = (replace(result.panels[0], lines=(evil,)),)
    write_page(tmp_path / "plot.html", replace(result, panels=panels, title="</title><b>"))
    page = (tmp_path / "plot.html").read_text(encoding="utf-8")
    assert page.count("</script>") == 2, "the library's and the page's own"
    assert "<title>&lt;/title&gt;&lt;b&gt;</title>" in page
