"""`dbw record` and `dbw convert`: files that outlive a kill, mistakes in one line."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from canbus.heard import Heard
from dbw.main import main
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns
from telemetry.logs.reading import Log
from tests.dbw.test_dbw_monitor import FakeListener
from tests.telemetry.monitored import FOREIGN_DBC
from tests.telemetry.test_telemetry_record import FRAMES, STEERING, expected, heard_of, write

Capture = pytest.CaptureFixture[str]
GROUP = "239.74.163.61"
CAN_ID = 0x100 + os.getpid() % 0x600
"""Of this run alone: all that listen to UDP hear each other, whatever the group."""
SPACE_S = 0.006
"""Between two frames: the kernel holds some 160 of them for a recorder that has to wait."""
WAIT_S = 60
KILL_LOSS_NS_MAX = NS_PER_S


class Ears(FakeListener):
    """Says frames by hand, then Ctrl-C."""

    def hear(self, timeout_ns: int) -> list[Heard]:
        if not self.batches:
            os.kill(os.getpid(), signal.SIGINT)
        return super().hear(timeout_ns)


def run(command: str, capsys: Capture, *arguments: object, code: int = 0) -> tuple[str, list[str]]:
    """Standard output, and the lines on standard error."""
    assert main([command, *map(str, arguments)]) == code
    shown = capsys.readouterr()
    return shown.out, shown.err.splitlines()


def hear(monkeypatch: pytest.MonkeyPatch, *batches: list[Heard]) -> Ears:
    ears = Ears(*batches)
    monkeypatch.setattr("dbw.record.listener_of", lambda *_: ears)
    return ears


def test_ctrl_c_before_the_first_batch_loses_nothing_that_has_come(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(*_: object) -> Ears:
        os.kill(os.getpid(), signal.SIGINT)  # while the bus is being opened
        return Ears(FRAMES[:5])

    monkeypatch.setattr("dbw.record.listener_of", opened)
    path = tmp_path / "a.log"
    out, _ = run("record", capsys, "vcan0", "--out", path)
    assert out == f"5 frames recorded, {path}\n"


@pytest.mark.parametrize("ending", [".log", ".asc", ".blf", ".mcap"])
def test_ctrl_c_ends_a_recording_well(
    ending: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    ears = hear(monkeypatch, FRAMES[:5], FRAMES[5:])
    ears.lost, ears.said = 3, ["can1: gone; waiting for it to come back"]
    before = signal.getsignal(signal.SIGINT)
    path = tmp_path / f"a{ending}"
    out, err = run("record", capsys, "vcan0", "can1", "--out", path)
    assert signal.getsignal(signal.SIGINT) is before
    assert out == f"10 frames recorded, {path}\n"
    assert err[:3] == [
        f"recording vcan0, can1 to {path}",
        "dbw: 3 frames lost, not read in time (3 in all)",
        "dbw: can1: gone; waiting for it to come back",
    ]
    losses = {".asc": 2, ".blf": 2}.get(ending, 0)
    assert len(err) == 3 + losses
    assert heard_of(path) == expected(FRAMES, ending)


def test_filters_choose_what_is_recorded_and_the_default_file_is_named_after_the_time(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    hear(monkeypatch, FRAMES)
    monkeypatch.chdir(tmp_path)
    run("record", capsys, "vcan0,182:7FF,#0")
    (path,) = tmp_path.iterdir()
    assert path.name.startswith("dbw-20") and path.suffix == ".log" and " " not in path.name
    assert heard_of(path) == FRAMES[:1]


def test_rotation_is_told_as_files(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    hear(monkeypatch, [FRAMES[0]] * 10_000, [FRAMES[0]] * 10_000)
    out, _ = run("record", capsys, "-o", tmp_path / "a.log", "--rotate-size", "100k")
    assert out == "20000 frames recorded, 3 files\n"
    sizes = [len(heard_of(tmp_path / f"a-000{n}.log")) for n in (1, 2, 3)]
    assert sizes == [10_000, 10_000, 0]


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["-o", "a.xyz"], "a.xyz: the ending says the format: .log, .asc, .blf, .mcap"),
        (["-o", "a.mf4"], "a.mf4: MF4 would lose everything in a crash: record .log"),
        (["-o", "no/a.log"], "no/a.log cannot be written: No such file"),
        (["-o", "there.log"], "there.log exists: name another file"),
        (["--rotate-size", "0"], "a number of bytes is wanted, as in 500k, 100M or 2G"),
        (["--rotate-size", "1T"], "a number of bytes is wanted"),
        (["--rotate-every", "x"], "a whole number from 1"),
        (["--max-files", "3"], "--max-files without --rotate-size or --rotate-every"),
        (["--dbc", "vehicle"], "--dbc: candump holds frames as they are; MCAP is decoded"),
        (["-o", "a.mcap", "--dbc", "nowhere.dbc"], "nowhere.dbc: cannot be read"),
        (["vcan0", "vcan0"], "a channel is named twice"),
        (["vcan0,1"], "filter '1' of 'vcan0,1': allowed ID:MASK"),
        (["--interface", "nonsense"], "unknown interface name"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_no_file(
    arguments: list[str], error: str, tmp_path: Path, capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("there.log").touch()
    if not {"vcan0", "vcan0,1", "nonsense"} & set(arguments):
        hear(monkeypatch)
    out, err = run("record", capsys, *arguments, code=2)
    assert out == "" and len(err) == 1
    assert err[0].startswith("dbw: error: ") and error in err[0]
    assert [path.name for path in tmp_path.iterdir()] == ["there.log"]


@contextmanager
def recording(path: Path) -> Iterator[tuple[subprocess.Popen[bytes], can.BusABC]]:
    """A recorder in a process of its own on a bus of this machine, and a sender on it."""
    command = [
        sys.executable, "-m", "dbw", "record", f"{GROUP},{CAN_ID:X}:7FF,#0", "--interface",
        "udp_multicast", "--out", str(path),
    ]  # fmt: skip
    with (
        can.Bus(interface="udp_multicast", channel=GROUP, ignore_config=True) as bus,
        subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE) as process,
    ):
        try:
            assert process.stderr is not None
            assert process.stderr.readline().startswith(b"recording ")
            yield process, bus
        finally:
            process.kill()


def send(bus: can.BusABC, number: int) -> int:
    """A frame with its number; answers the time."""
    data = number.to_bytes(8, "big")
    bus.send(can.Message(arbitration_id=CAN_ID, data=data, is_extended_id=False))
    return realtime_ns()


@pytest.mark.wall_clock
@pytest.mark.parametrize("ending", [".log", ".asc", ".blf", ".mcap"])
def test_a_kill_costs_at_most_a_second(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    sent: dict[int, int] = {}
    with recording(path) as (process, bus):
        end_ns = monotonic_ns() + 3 * NS_PER_S
        while monotonic_ns() < end_ns:
            sent[len(sent)] = send(bus, len(sent))
            select.select([], [], [], SPACE_S)
        process.kill()
        killed_ns = realtime_ns()
    found = [int.from_bytes(item.data, "big") for item in heard_of(path)]
    assert found == list(range(len(found))), "no frame is missing within"
    assert found and killed_ns - sent[found[-1]] < KILL_LOSS_NS_MAX


@pytest.mark.wall_clock
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_loses_nothing(number: signal.Signals, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with recording(path) as (process, bus):
        for n in range(200):
            send(bus, n)
            select.select([], [], [], SPACE_S)
        select.select([], [], [], 0.5)  # what waits in a socket of python-can's is heard
        process.send_signal(number)
        assert process.stdout is not None
        assert b"200 frames recorded" in process.stdout.read()
        assert process.wait(WAIT_S) == 0
    log = Log(path)
    assert [int.from_bytes(f.data, "big") for f in log.frames()] == list(range(200))
    assert log.problems.lines() == []


@pytest.mark.parametrize("command", ["decode", "monitor"])
@pytest.mark.parametrize("ending", [".mcap", ".mf4", ".blf"])
def test_other_commands_read_what_was_recorded(
    command: str, ending: str, tmp_path: Path, capsys: Capture
) -> None:
    path = write(tmp_path / f"a{ending}", FRAMES)
    out, _ = run(command, capsys, *(["--log"] if command == "monitor" else []), path)
    assert "STEER_STATUS" in out and len(out.splitlines()) == len(FRAMES)


def test_a_conversion_tells_what_it_wrote_and_what_it_lost(
    tmp_path: Path, capsys: Capture
) -> None:
    log = write(tmp_path / "a.mcap", FRAMES)
    out, err = run("convert", capsys, log, tmp_path / "b.blf")
    assert out == f"10 frames written to {tmp_path / 'b.blf'}\n"
    assert err == [
        f"dbw: {tmp_path / 'b.blf'}: 2 error frames lose their direction in BLF",
        f"dbw: {tmp_path / 'b.blf'}: BLF has numbers for channels: vcan0 is 0, can1 is 1",
    ]


def test_what_cannot_be_read_is_told_and_the_rest_is_converted(
    tmp_path: Path, capsys: Capture
) -> None:
    log = tmp_path / "a.log"
    log.write_text(f"nonsense\n(1.000000) vcan0 182#{STEERING.hex()}\n(1.5) vcan0 7AA#01\n(2.0) v")
    out, err = run("convert", capsys, log, tmp_path / "b.mcap")
    assert out.startswith("2 frames written")
    assert any("2 lines not read: no frame of candump: line 1 'nonsense'" in line for line in err)
    assert [item.can_id for item in heard_of(tmp_path / "b.mcap")] == [0x182, 0x7AA]


def test_unknown_frames_are_in_the_raw_channel_and_another_dbc_decodes(
    tmp_path: Path, capsys: Capture
) -> None:
    log, dbc, out = tmp_path / "a.log", tmp_path / "x.dbc", tmp_path / "b.mcap"
    dbc.write_text(FOREIGN_DBC, encoding="utf-8")
    log.write_text("(1.0) can0 100#9C0101500A000000\n(2.0) can0 182#0011223344556677\n")
    run("convert", capsys, log, out, "--dbc", dbc)
    assert [item.can_id for item in heard_of(out)] == [0x100, 0x182]
    from mcap.reader import make_reader

    with out.open("rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    assert topics.count("/can0/raw") == 2 and len(topics) == 3


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["a.log", "b.xyz"], "b.xyz: the ending says the format: .log, .asc, .blf, .mcap, .mf4"),
        (["a.log", "a.log"], "a.log exists: name another file"),
        (["nowhere.log", "b.blf"], "nowhere.log: cannot be read: No such file"),
        (["a.log", "no/b.blf"], "no/b.blf cannot be written: No such file"),
        (["nonsense", "b.mcap"], "nonsense: no frame in it can be read"),
        (["a.log", "b.blf", "--dbc", "vehicle"], "--dbc: BLF holds frames as they are"),
        (["a.log"], "Missing argument 'OUT'"),
    ],
)
def test_a_conversion_that_cannot_be_leaves_no_file(
    arguments: list[str], error: str, tmp_path: Path, capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("a.log").write_text("(1.0) can0 100#00\n")
    Path("nonsense").write_bytes(bytes(range(256)))
    out, err = run("convert", capsys, *arguments, code=2)
    assert out == "" and error in err[-1] and err[-1].startswith("dbw: error: ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.log", "nonsense"]
