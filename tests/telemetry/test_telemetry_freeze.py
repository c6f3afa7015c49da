"""Freeze frames on disk: whole or not there, bounded, the newest of each code kept."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from canbus.frame import Frame
from dbc.messages import ErrorCode
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from telemetry.why.freeze import FRAMES_MAX, FreezeError, FreezeStore, default_folder
from telemetry.why.watch import CodeOnset
from tests.telemetry.why_drives import frames_with, told_of

pytestmark = pytest.mark.whole_car

SECOND_NS = 1_000_000_000


def onset(code: ErrorCode, frames: tuple[tuple[int, Frame], ...] = ()) -> CodeOnset:
    return CodeOnset(time_ns=SECOND_NS, code=code, node="Steering", reason="LATE", frames=frames)


def add(store: FreezeStore, *codes: ErrorCode) -> None:
    for code in codes:
        store.add(onset(code), unix_ns=1_700_000_000 * SECOND_NS, channel="vcan0")


def test_a_code_of_a_drive_is_stored_with_all_signals_and_found_after_a_restart(
    tmp_path: Path,
) -> None:
    crash = Fault(kind=FaultKind.CRASH, target="Throttle")
    codes = [item for item in told_of(frames_with(crash)) if isinstance(item, CodeOnset)]
    stored = FreezeStore(tmp_path / "new" / "store").add(
        codes[-1], unix_ns=1_700_000_000 * SECOND_NS, channel="can0"
    )
    document = FreezeStore(tmp_path / "new" / "store").load(stored.number)
    assert document["code"] == codes[-1].code.name and document["channel"] == "can0"
    assert document["unix_s"] == 1_700_000_000.0
    assert len(document["frames"]) == len(codes[-1].frames)
    speeds = document["signals"]["THROTTLE_STATUS"]
    assert set(speeds) == {"at_s", "wheel_speed_radps", "applied_wheel_speed_radps"}
    assert len(speeds["at_s"]) == len(speeds["wheel_speed_radps"])
    assert speeds["at_s"][0] < -0.9 and document["signals"]["BRAKE_STATUS"]["at_s"][-1] > 0.9


def test_the_oldest_go_and_the_newest_of_each_code_stays(tmp_path: Path) -> None:
    store = FreezeStore(tmp_path, count_max=3)
    add(store, ErrorCode.ER4, *[ErrorCode.ER2] * 5)
    assert [(item.number, item.code) for item in store.entries()] == [
        (1, "ER4"), (5, "ER2"), (6, "ER2")
    ]
    add(FreezeStore(tmp_path, count_max=1), ErrorCode.ER5)
    assert [(item.number, item.code) for item in store.entries()] == [
        (1, "ER4"), (6, "ER2"), (7, "ER5")
    ]


def test_the_size_of_all_is_bounded(tmp_path: Path) -> None:
    add(FreezeStore(tmp_path, bytes_max=1), ErrorCode.ER1, ErrorCode.ER1, ErrorCode.ER1)
    assert [item.number for item in FreezeStore(tmp_path).entries()] == [3]


def test_of_a_flood_the_frames_next_to_the_code_are_kept(tmp_path: Path) -> None:
    flood = tuple((n * 100_000, Frame(0x4A0)) for n in range(2 * FRAMES_MAX))
    store = FreezeStore(tmp_path)
    store.add(onset(ErrorCode.ER2, flood), unix_ns=0, channel="vcan0")
    document = store.load(1)
    assert len(document["frames"]) == FRAMES_MAX
    assert document["frames_left_out"] == FRAMES_MAX
    assert abs(document["frames"][0][0]) <= 1.0


def test_a_store_that_cannot_be_written_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(FreezeError, match="cannot be written"):
        add(FreezeStore(file), ErrorCode.ER1)


def test_a_write_that_fails_half_way_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = FreezeStore(tmp_path)
    add(store, ErrorCode.ER1)

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FreezeError, match="No space left"):
        add(store, ErrorCode.ER2)
    assert [path.name for path in tmp_path.iterdir()] == ["000001-ER1.json"]


def test_a_number_that_somebody_else_took_is_not_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = FreezeStore(tmp_path)
    add(store, ErrorCode.ER1)
    monkeypatch.setattr(FreezeStore, "entries", lambda self: [])  # as it was before the other wrote
    add(store, ErrorCode.ER1)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "000001-ER1.json", "000002-ER1.json"
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [("{", "no freeze frame"), ("[]", "keys are missing"), ('{"version": 1}', "keys are missing")],
)
def test_a_file_that_is_none_is_named(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "000004-ER2.json").write_text(text)
    with pytest.raises(FreezeError, match=said):
        FreezeStore(tmp_path).load(4)


def test_another_version_and_a_missing_number_are_named(tmp_path: Path) -> None:
    store = FreezeStore(tmp_path)
    add(store, ErrorCode.ER2)
    with pytest.raises(FreezeError, match=r"no freeze frame 9 in .*: stored are 1"):
        store.load(9)
    path = store.entries()[0].path
    path.write_text(json.dumps({**json.loads(path.read_text()), "version": 99}))
    with pytest.raises(FreezeError, match="version 99: 1 is known"):
        store.load(1)


def test_the_folder_is_that_of_xdg_and_ignores_a_relative_one() -> None:
    assert default_folder({"XDG_STATE_HOME": "/s"}) == Path("/s/can-by-wire/freeze-frames")
    home = Path.home() / ".local" / "state" / "can-by-wire" / "freeze-frames"
    assert default_folder({}) == default_folder({"XDG_STATE_HOME": "relative"}) == home
