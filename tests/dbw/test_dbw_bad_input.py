"""Each mistake a user can make: one line on stderr, exit code 2, nothing written."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from dbw.main import main

Capture = pytest.CaptureFixture[str]


def write_ring(file: Path, radius_m: float = 25.0, width_m: float = 3.0) -> Path:
    """A round road, anticlockwise from the x axis."""
    lines = ["# x_m,y_m,w_tr_right_m,w_tr_left_m"]
    for number in range(120):
        angle = math.tau * number / 120
        x_m, y_m = radius_m * math.cos(angle), radius_m * math.sin(angle)
        lines.append(f"{x_m:.6f},{y_m:.6f},{width_m},{width_m}")
    file.write_text("\n".join(lines) + "\n")
    return file


def refused(arguments: list[str], folder: Path, capsys: Capture) -> str:
    """Runs a command that must be refused; answers its one line."""
    before = sorted(folder.rglob("*"))
    assert main(arguments) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.startswith("dbw: error: ")
    assert shown.err.count("\n") == 1 and shown.err.endswith("\n")
    assert sorted(folder.rglob("*")) == before
    return shown.err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--track", "monza"], "monza: neither a file nor a built-in road (campus, norisring"),
        (["--track", "missing.csv"], "missing.csv: line 1: no such file"),
        (["--vehicle", "kart"], "vehicle 'kart' is not known: allowed"),
        (["--vehicle", "missing.toml"], "missing.toml: cannot be read"),
        (["--seed", "-1"], "'--seed': '-1': a whole number from 0 to 4294967295 is wanted"),
        (["--seed", "lucky"], "'--seed': 'lucky': a whole number from 0"),
        (["--seed", "4294967296"], "a whole number from 0 to 4294967295"),
        (["--planner-period-ms", "9"], "--planner-period-ms 9: allowed 10 to 630 ms"),
        (["--planner-period-ms", "631"], "--planner-period-ms 631: allowed 10 to 630 ms"),
        (["--planner-period-ms", "fast"], "'--planner-period-ms': 'fast' is not a valid integer"),
        (["--distance-m", "4"], "--distance-m 4: allowed 5 to 800.0 m, the length of campus"),
        (["--distance-m", "801"], "--distance-m 801: allowed 5 to 800.0 m"),
        (["--distance-m", "nan"], "--distance-m nan: allowed 5"),
        (["--interface", "pcan"], "'pcan' is not one of 'virtual', 'socketcan'"),
        (["--interface", "socketcan"], "--interface socketcan needs --realtime"),
        (["--channel", "my bus"], "'my bus': a name without blanks is wanted"),
        (["--channel", ""], "'': a name without blanks is wanted"),
        (["--speed", "3"], "No such option '--speed'"),
        (["lap"], "unexpected extra argument"),
    ],
)
def test_bad_option_of_demo_is_refused(
    options: list[str], said: str, tmp_path: Path, capsys: Capture
) -> None:
    line = refused(["demo", "--out", str(tmp_path / "out"), *options], tmp_path, capsys)
    assert said in line


def test_same_bus_for_vehicle_and_harness_is_refused(tmp_path: Path, capsys: Capture) -> None:
    options = ["--realtime", "--interface", "socketcan", "--harness-channel", "vcan0"]
    line = refused(["demo", "--out", str(tmp_path / "out"), *options], tmp_path, capsys)
    assert "both vcan0: two buses are wanted" in line


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,2,3\n", "line 1: 3 columns, 4 are needed"),
        ("0,0,2,2\n1,x,2,2\n", "line 2: y_m is not a number: 'x'"),
        ("0,0,2,2\n", "1 points, a road needs at least 10"),
        ("\0", "holds a zero byte"),
    ],
)
def test_unreadable_csv_is_refused_with_line_and_reason(
    text: str, said: str, tmp_path: Path, capsys: Capture
) -> None:
    file = tmp_path / "road.csv"
    file.write_text(text)
    line = refused(["demo", "--track", str(file), "--out", str(tmp_path / "out")], tmp_path, capsys)
    assert f"{file}: line" in line and said in line


def test_road_too_tight_or_too_narrow_for_the_vehicle_is_refused(
    tmp_path: Path, capsys: Capture
) -> None:
    tight = write_ring(tmp_path / "tight.csv", radius_m=9.0, width_m=1.5)
    narrow = write_ring(tmp_path / "narrow.csv", width_m=0.9)
    for file, said in ((tight, "holds no line of radius 12"), (narrow, "is too narrow: 1.80 m")):
        arguments = ["demo", "--track", str(file), "--out", str(tmp_path / "out")]
        line = refused(arguments, tmp_path, capsys)
        assert said in line and "x = " in line


@pytest.mark.parametrize("command", [["up", "--plant", "none"], ["ecu", "steering"]])
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--realtime", "fifo:0"], "--realtime fifo:0: allowed auto, off, and fifo:PRIO or rr:"),
        (["--realtime", "yes"], "--realtime yes: allowed auto, off, and fifo:PRIO or rr:PRIO"),
        (["--cpus", "1;2"], "'1;2': numbers of processors with commas are wanted, as in 1,2"),
        (["--cpus", "9999"], "--cpus 9999: refused by the system: allowed are "),
        (["--bitrate", "0"], "'0': a whole number from 1 to 1000000 is wanted"),
        (["--bitrate", "fast"], "'fast': a whole number from 1 to 1000000 is wanted"),
    ],
)
def test_bad_real_time_or_bus_option_is_refused(
    command: list[str], options: list[str], said: str, tmp_path: Path, capsys: Capture
) -> None:
    line = refused([*command, "--interface", "virtual", *options], tmp_path, capsys)
    assert said in line


def test_out_that_is_a_file_is_refused(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "out"
    file.write_text("mine")
    line = refused(["demo", "--out", str(file)], tmp_path, capsys)
    assert f"{file} is a file: a folder is wanted" in line
    assert file.read_text() == "mine"


@pytest.mark.parametrize("below", ["file", "/proc"])
def test_out_that_cannot_be_written_is_refused(below: str, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "file").write_text("")
    line = refused(["demo", "--out", str(tmp_path / below / "out")], tmp_path, capsys)
    assert "cannot be written" in line


def without_socketcan(*arguments: object, **options: object) -> None:
    """Stands in for python-can on a kernel without AF_CAN."""
    raise OSError(97, "Address family not supported by protocol")


@pytest.mark.parametrize(
    "arguments",
    [
        ["demo", "--realtime", "--interface", "socketcan"],
        ["up"],
        ["ecu", "steering"],
        ["ecu", "plant"],
    ],
)
def test_kernel_without_socketcan_is_told_in_one_line(
    arguments: list[str], tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("can.Bus", without_socketcan)
    if arguments[0] == "demo":
        arguments = [*arguments, "--out", str(tmp_path / "out")]
    line = refused(arguments, tmp_path, capsys)
    assert "this kernel has no SocketCAN (AF_CAN); run 'modprobe can_raw'" in line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["up", "--plant", "baja"], "--plant baja: allowed tabby_evo (the vehicle's own) or none"),
        (["up", "--vehicle", "kart"], "vehicle 'kart' is not known"),
        (["up", "--interface", "carrier-pigeon"], "unknown interface name; known: "),
        (["up", "--interface", "virtual"], "interface 'virtual' stays within one process"),
        (["up", "--channel", "a", "--harness-channel", "a"], "both"),
        (["up", "now"], "unexpected extra argument"),
        (["ecu"], "NAME is missing: allowed steering, throttle, brake_servo, supervisor"),
        (["ecu", "gearbox"], "node 'gearbox' is not known: allowed steering"),
        (["ecu", "steering", "--vehicle", "kart"], "vehicle 'kart' is not known"),
        (["ecu", "steering", "--channel", "a", "--harness-channel", "a"], "two buses are wanted"),
        (["down", "--channel", "nobody"], "no stack is up on channel 'nobody'"),
        (["down", "--channel", "a b"], "a name without blanks is wanted"),
        (["status", "--channel", ""], "a name without blanks is wanted"),
    ],
)
def test_bad_option_of_the_stack_commands_is_refused(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "can-by-wire").mkdir(mode=0o700)
    assert said in refused(arguments, tmp_path, capsys)
