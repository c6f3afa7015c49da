"""`dbw replay`: lines in the log's time, frames onto a bus, a node on its recorded inputs."""

from __future__ import annotations

import io
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from canbus.candump import log_line
from canbus.heard import Heard
from canbus.python_can_bus import PythonCanBus
from dbw import replay_play
from dbw.main import main
from runtime.clock import monotonic_ns, realtime_ns
from tests.telemetry.replayed import Recorded

Capture = pytest.CaptureFixture[str]
LOG = """(0000000001.000000) can0 702#05
(0000000001.500000) can0 7AA#0102
(0000000002.500000) can1 1F334455#R4
(0000000002.500100) can0 703##31122
(0000000002.500200) can0 20000004#0001000000000000
(0000000062.500200) can0 704#05
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "drive.log"
    path.write_text(LOG)
    return path


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """No waiting: the clock moves by what would have been waited for."""
    spans: list[float] = []
    now_ns = [monotonic_ns()]

    class Pause:
        def wait(self, span_s: float) -> None:
            spans.append(round(span_s, 4))
            now_ns[0] += round(span_s * 1e9)

    class Threading:
        Event = Pause

    monkeypatch.setattr(replay_play, "threading", Threading)
    monkeypatch.setattr(replay_play, "monotonic_ns", lambda: now_ns[0])
    return spans


@contextmanager
def ear(channel: str, *, fd: bool = False) -> Iterator[Callable[[], list[Heard]]]:
    """Hears what is sent to a `virtual` channel."""
    with PythonCanBus(
        "virtual", channel, clock=monotonic_ns, realtime=realtime_ns, fd=fd
    ) as bus:
        yield bus.hear


def test_frames_are_lines_in_the_time_of_the_log(
    log: Path, capsys: Capture, waits: list[float]
) -> None:
    assert main(["replay", str(log), "can0", "--speed", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert waits == [0.25, 0.5, 0.0001, 30.0]
    assert [line.split()[0] for line in lines[:2]] == ["(000.000000)", "(000.500000)"]
    assert "STEER_HEARTBEAT" in lines[0] and "7AA" in lines[1]
    assert len(lines) == 5, "all of can0"


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        (["--message", "SteerHeartbeat"], 1),
        (["can0,700:700", "--to", "3"], 4),
        (["can1"], 1),
        (["--from", "1.2", "--to", "2.6"], 4),
        (["--node", "Steering", "--node", "BrakeServo", "--loop", "3"], 6),
    ],
)
def test_frames_are_chosen_as_by_the_monitor_and_looped(
    log: Path, capsys: Capture, options: list[str], shown: int
) -> None:
    assert main(["replay", str(log), "--speed", "max", *options]) == 0
    assert len(capsys.readouterr().out.splitlines()) == shown


def test_long_silences_are_cut(log: Path, waits: list[float]) -> None:
    assert main(["replay", str(log), "can0", "--max-gap", "0.1"]) == 0
    assert waits == [0.1, 0.1, 0.0001, 0.1]


def test_enter_and_numbers_step_through_the_log(
    log: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n2\nwhat\nq\n"))
    assert main(["replay", str(log), "--step"]) == 0
    shown = capsys.readouterr()
    assert len(shown.out.splitlines()) == 3
    assert "Enter, a number and Enter, or q" in shown.err


def test_a_log_comes_through_a_pipe_and_may_be_looped(
    log: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with log.open() as file:
        monkeypatch.setattr("sys.stdin", file)
        assert main(["replay", "-", "--speed", "max", "--loop", "2"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 12


def test_frames_are_sent_onto_the_bus_of_their_channel_with_every_flag(
    log: Path, capsys: Capture
) -> None:
    with ear("replay-a", fd=True) as first, ear("replay-b") as second:
        onto = ["--onto", "can0=replay-a", "--onto", "can1=replay-b"]
        code = main(
            ["replay", str(log), *onto, "--interface", "virtual", "--speed", "max", "--fd"]
        )
        heard, other = first(), second()
    assert code == 0
    wanted = [line.split()[2] for line in LOG.splitlines() if " can0 " in line]
    sent = [log_line(item).split()[2] for item in heard]
    assert sent == [text for text in wanted if not text.startswith("2000")]
    assert [log_line(item).split()[2] for item in other] == ["1F334455#R4"]
    shown = capsys.readouterr()
    assert "5 frames sent" in shown.out
    assert "left out 1 error frames" in shown.err


def test_without_fd_its_frames_are_left_out_and_told(log: Path, capsys: Capture) -> None:
    with ear("replay-c") as hear:
        assert main([
            "replay", str(log), "--onto", "replay-c", "--interface", "virtual", "--speed", "max",
        ]) == 0  # fmt: skip
        assert len(hear()) == 4
    assert "left out 1 FD frames: see --fd" in capsys.readouterr().err


def test_an_identifier_that_somebody_sends_is_not_sent_as_well(log: Path, capsys: Capture) -> None:
    command = [
        "replay", str(log), "--onto", "replay-d", "--interface", "virtual", "--speed", "max",
    ]  # fmt: skip
    ended = threading.Event()

    def talk() -> None:
        with can.Bus(interface="virtual", channel="replay-d") as bus:
            while not ended.wait(0.01):
                bus.send(can.Message(arbitration_id=0x702, data=[5], is_extended_id=False))

    talker = threading.Thread(target=talk)
    with ear("replay-d") as hear:
        talker.start()
        try:
            assert main(command) == 2
            refused = capsys.readouterr().err
            assert "702 STEER_HEARTBEAT" in refused and "--force" in refused
            assert {item.can_id for item in hear()} == {0x702}
            assert main([*command, "--message", "ThrottleHeartbeat", "--fd"]) == 0
            assert main([*command, "--force"]) == 0
            assert 0x7AA in {item.can_id for item in hear()}
        finally:
            ended.set()
            talker.join()


@pytest.fixture(scope="module")
def both_buses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a second of a parked car, vehicle bus and harness in one log."""
    recorded = Recorded()
    recorded.drive.world.run_for(0.5)
    record = recorded.record
    rows = [
        (item.arrival_ns, channel, item.frame)
        for channel, items in (("vcan0", record.vehicle_bus), ("vcan1", record.harness))
        for item in items
    ]
    rows.sort(key=lambda row: row[0])
    path = tmp_path_factory.mktemp("replay") / "both.log"
    path.write_text("".join(
        log_line(Heard(time_ns, channel, frame.can_id, frame.data, len(frame.data))) + "\n"
        for time_ns, channel, frame in rows
    ))  # fmt: skip
    return path


def test_a_node_does_what_the_record_says(both_buses: Path, capsys: Capture) -> None:
    assert main(["replay", str(both_buses), "--through", "steering"]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"Steering: \d\d steps, 0\.00\d s to 0\.\d+ s", shown)
    assert re.search(r"STEER_STATUS +\d+ equal\n", shown)
    assert re.search(r"STEERING_ACTUATOR +\d+ equal\n", shown)
    assert shown.endswith("the code does what the record says\n")


def test_another_car_in_the_same_node_is_found(both_buses: Path, capsys: Capture) -> None:
    command = ["replay", str(both_buses), "--through", "steering", "--vehicle", "baja_5b"]
    assert main(command) == 1
    shown = capsys.readouterr().out
    assert re.search(r"STEER_DRIVER differs: torque_nm recorded -?[\d.]+, here -?[\d.]+", shown)
    assert shown.endswith("the code does not do what the record says\n")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--speed", "0"], "a number from 0.001 to 1000 is wanted, or max"),
        (["--speed", "nan"], "a number from 0.001 to 1000 is wanted, or max"),
        (["--onto", "a=x", "--onto", "a=y"], "--onto a=y: [CHANNEL=]CHANNEL"),
        (["--onto", "a="], "--onto a=: [CHANNEL=]CHANNEL"),
        (["--onto", "vcan0", "--interface", "telepathy"], "unknown interface name"),
        (["--message", "SteerHeartbaet"], "nearest STEER_HEARTBEAT"),
        (["can0,12"], "filter '12'"),
        (["--through", "gateway"], "allowed steering, throttle, brake_servo, supervisor"),
        (["--through", "steering"], "the vehicle bus, vcan0, is not in this log, which has can0"),
        (
            ["--through", "steering", "--channel", "can0", "--harness-channel", "can1"],
            "does not hold the start of Steering (its boot-up, 702#00)",
        ),
        (["--through", "steering", "--onto", "vcan0"], "--through and --onto"),
        (["--from", "later"], "a number of seconds is wanted"),
    ],
)
def test_what_cannot_be_done_is_told_in_one_line(
    log: Path, capsys: Capture, options: list[str], reason: str
) -> None:
    assert main(["replay", str(log), *options]) == 2
    shown = capsys.readouterr()
    assert reason in shown.err and shown.err.count("\n") == 1
    assert not shown.out


def test_a_log_that_is_none_and_a_pipe_with_steps_are_refused(
    tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / "letter.txt"
    path.write_text("Dear Sir,\n")
    assert main(["replay", str(path)]) == 2
    assert "is no log" in capsys.readouterr().err
    assert main(["replay", str(tmp_path / "missing.log")]) == 2
    assert "cannot be read" in capsys.readouterr().err
    assert main(["replay", "-", "--step"]) == 2
    assert "the log must be a file" in capsys.readouterr().err
