"""`dbw decode`: text by the pipe, tables by the folder, mistakes in one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dbw.main import main

Capture = pytest.CaptureFixture[str]
LOG = """(0000000001.000000) vcan0 701#05
(0000000002.000000) vcan0 702#05
(0000000003.000000) vcan0 7AA#0102
this is no frame
(0000000004.000000) vcan0 703#7F
(0000000005.000000) vcan0 703#
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "drive.log"
    path.write_text(LOG)
    return path


def test_each_frame_is_a_line_and_what_is_none_is_told(log: Path, capsys: Capture) -> None:
    assert main(["decode", str(log)]) == 0
    shown = capsys.readouterr()
    assert shown.out.splitlines() == [
        "(0000000001.000000) vcan0 701#05  SUPERVISOR_HEARTBEAT  state=OPERATIONAL",
        "(0000000002.000000) vcan0 702#05  STEER_HEARTBEAT  state=OPERATIONAL",
        "(0000000003.000000) vcan0 7AA#0102",
        "(0000000004.000000) vcan0 703#7F  THROTTLE_HEARTBEAT  state=PRE_OPERATIONAL",
        "(0000000005.000000) vcan0 703#",
    ]
    assert "1 line not read" in shown.err and "line 4" in shown.err
    assert "1 frames of THROTTLE_HEARTBEAT have another length" in shown.err


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        (["--message", "SteerHeartbeat"], ["702"]),
        (["--node", "Steering", "--node", "Throttle"], ["702", "703"]),
        (["--signal", "STEER_HEARTBEAT.state"], ["702"]),
        (["--from", "2", "--to", "3.5"], ["702", "7AA"]),
    ],
)
def test_frames_are_chosen_by_name_and_time(
    log: Path, capsys: Capture, options: list[str], shown: list[str]
) -> None:
    assert main(["decode", str(log), *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[2].partition("#")[0] for line in lines] == shown


def test_a_pipe_is_read_and_times_of_the_system_count_from_the_first_frame() -> None:
    text = LOG.replace("(000000000", "(170000000")
    command = [sys.executable, "-m", "dbw", "decode", "-", "--from", "1", "--to", "1.5"]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("(1700000002.000000) vcan0 702#05")
    assert done.stdout.count("\n") == 1


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_tables_are_written(log: Path, tmp_path: Path, capsys: Capture, kind: str) -> None:
    out = tmp_path / "tables"
    assert main(["decode", str(log), f"--{kind}", str(out)]) == 0
    shown = capsys.readouterr()
    assert shown.out == f"written to {out}/: 3 files, 3 rows\n"
    assert "1 frames are in no DBC" in shown.err
    assert (out / f"STEER_HEARTBEAT.{kind}").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["missing.log"], "missing.log: cannot be read"),
        (["pyproject.toml"], "pyproject.toml is no log: "),
        (["pyproject.toml", "--csv", "nowhere"], "pyproject.toml is no log: "),
        (["LOG", "--message", "SteerHartbeat"], "did you mean STEER_HEARTBEAT"),
        (["LOG", "--signal", "state"], "MESSAGE.SIGNAL is wanted"),
        (["LOG", "--csv", "a", "--parquet", "b"], "one of them is wanted"),
        (["LOG", "--from", "nan"], "a number of seconds is wanted"),
        (["LOG", "--dbc", "missing.dbc"], "missing.dbc: cannot be read"),
    ],
)
def test_a_mistake_is_told_in_one_line(
    log: Path, capsys: Capture, arguments: list[str], said: str
) -> None:
    given = [str(log) if word == "LOG" else word for word in arguments]
    assert main(["decode", *given]) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and said in shown.err and shown.err.count("\n") == 1
