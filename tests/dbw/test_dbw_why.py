"""`dbw why`: what it prints, its JSON, its mistakes, and what it does live."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from campaign.futures import BEGIN_NS
from canbus.frame import ReceivedFrame
from dbw.main import main
from dbw.why_live import LiveWatch
from runtime.clock import monotonic_ns
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from telemetry.why.freeze import FreezeStore
from tests.telemetry.why_drives import VEHICLE, candump, frames_with

Capture = pytest.CaptureFixture[str]
CRASH = Fault(kind=FaultKind.CRASH, target="Throttle")
INCIDENT_KEYS = {
    "number", "kind", "at_s", "summary", "mode_before", "mode_after", "mode_frame", "codes",
    "cause", "other_causes", "first_said", "said", "actions", "times", "why_not_engaged", "notes",
    "begin_s", "end_s", "commands",
}
DOCS = (Path(__file__).parents[2] / "docs" / "telemetry.md").read_text(encoding="utf-8")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "drive.log"
    path.write_text(candump(frames_with(CRASH)))
    return path


def document_of(log: Path, capsys: Capture, *options: str) -> Any:
    assert main(["why", str(log), "--json", *options]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_log_is_explained_in_words(log: Path, capsys: Capture) -> None:
    assert main(["why", str(log)]) == 0
    text = capsys.readouterr().out
    assert "The car braked because the throttle ECU fell silent: its last THROTTLE_STATUS" in text
    assert "missing: THROTTLE_STATUS 0x183, time-out 60 ms" in text
    assert f"$ dbw why {log} --from 7.058 --to 9.058" in text
    assert max(map(len, text.splitlines())) < 400


def test_the_command_that_is_told_shows_the_same_incident(log: Path, capsys: Capture) -> None:
    (incident,) = document_of(log, capsys)["incidents"]
    command = next(item for item in incident["commands"] if item.startswith("dbw why"))
    assert main(command.split()[1:]) == 0
    assert incident["summary"] in capsys.readouterr().out
    assert document_of(log, capsys, "--from", "0", "--to", "5")["incidents"] == []


def test_the_json_has_the_keys_that_the_docs_name(log: Path, capsys: Capture) -> None:
    document = document_of(log, capsys)
    (incident,) = document["incidents"]
    assert set(incident) == INCIDENT_KEYS
    for key in (*document, *incident, *incident["cause"], *incident["cause"]["trigger"]):
        assert f"`{key}`" in DOCS, key
    trigger = incident["cause"]["trigger"]
    assert (trigger["type"], trigger["message"]) == ("absence", "THROTTLE_STATUS")
    assert trigger["last"]["at_s"] + trigger["timeout_ms"] / 1e3 == pytest.approx(
        trigger["overdue_since_s"]
    )
    assert [item["mode"] for item in document["modes"]][-1] == "EMERGENCY"


def test_times_of_a_log_with_the_systems_clock_count_from_its_first_frame(
    tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / "later.log"
    path.write_text(candump((ns + 1_700_000_000 * 10**9, f) for ns, f in frames_with(CRASH)))
    document = document_of(path, capsys)
    assert document["origin_unix_s"] == pytest.approx(1_700_000_000, abs=1)
    assert document["incidents"][0]["at_s"] == pytest.approx(8.057, abs=0.01)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the log holds no frame"),
        ("(1.0) can0 4A0#00\n", "none of the 1 frames has an identifier of dbc/vehicle.dbc"),
        ("(1.0) can0 181#00\n(2.0) can0 18", "1 line not read"),
    ],
)
def test_an_empty_a_foreign_and_a_torn_log_say_so(
    tmp_path: Path, capsys: Capture, text: str, said: str
) -> None:
    path = tmp_path / "odd.log"
    path.write_text(text)
    assert main(["why", str(path)]) == 0
    shown = capsys.readouterr().out
    assert said in shown and "no incidents" in shown


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "one of LOG, --live and --stored is wanted"),
        (["a.log", "--live"], "one of LOG, --live and --stored is wanted"),
        (["--live", "--from", "1"], "--from needs a LOG"),
        (["a.log", "--to", "nan"], "--to nan: a number of seconds is wanted"),
        (["missing.log"], "missing.log: cannot be read: No such file or directory"),
        (["pyproject.toml"], "pyproject.toml is no log: "),
        (["--stored", "x"], "--stored x: a number of `dbw why --stored` is wanted"),
        (["--live", "--interface", "none"], "unknown interface name"),
        (["a.log", "--vehicle", "tank"], "tank"),
    ],
)
def test_a_mistake_is_told_in_one_line(options: list[str], said: str, capsys: Capture) -> None:
    assert main(["why", *options]) == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert shown.err.startswith("dbw: error: ") or "listening" in shown.err


def live(store: FreezeStore | None, *, as_json: bool) -> LiveWatch:
    """A live watch that has heard the drive; arrivals are in the past of this machine's clock."""
    watch = LiveWatch(VEHICLE, store, "vcan0", as_json=as_json)
    frames = [item for item in frames_with(CRASH) if item[0] > BEGIN_NS - 10**9]
    end_ns = monotonic_ns()
    received = [ReceivedFrame(end_ns + ns - frames[-1][0], frame) for ns, frame in frames]
    watch.take(received, end_ns + 2 * 10**9)
    watch.finish()
    return watch


def test_live_it_tells_modes_incidents_and_freeze_frames(tmp_path: Path, capsys: Capture) -> None:
    live(FreezeStore(tmp_path), as_json=False)
    text = capsys.readouterr().out
    assert "AUTOMATIC -> EMERGENCY" in text and "the throttle ECU fell silent" in text
    assert "freeze frame 1" in text
    assert main(["why", "--stored", "--store", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(FreezeStore(tmp_path).entries()) >= 2
    assert main(["why", "--stored", "1", "--store", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "SUPERVISOR_STATE" in shown and "mode=EMERGENCY" in shown
    assert main(["why", "--stored", "99", "--store", str(tmp_path)]) == 2


def test_live_json_is_one_object_a_line(tmp_path: Path, capsys: Capture) -> None:
    live(FreezeStore(tmp_path), as_json=True)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["type"] for line in lines} == {"incident", "freeze_frame"}
    assert main(["why", "--stored", "--json", "--store", str(tmp_path)]) == 0
    assert {row["number"] for row in json.loads(capsys.readouterr().out)} >= {1, 2}


def test_a_store_that_cannot_be_written_does_not_end_the_watch(
    tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "file").write_text("")
    live(FreezeStore(tmp_path / "file"), as_json=False)
    shown = capsys.readouterr()
    assert "cannot be written" in shown.err and "fell silent" in shown.out


def test_an_empty_store_says_so(tmp_path: Path, capsys: Capture) -> None:
    assert main(["why", "--stored", "--store", str(tmp_path / "none")]) == 0
    assert "no freeze frame in" in capsys.readouterr().out
