"""One process per node: order, deaths, locks and clean-up. The children are small stand-ins."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from canbus.node import Event
from runtime import process_stack, stack_control
from runtime.clock import monotonic_ns
from runtime.errors import LaunchError
from runtime.launch import ProcessStack, StackSettings, status, stop
from runtime.process_stack import how_it_ended
from runtime.realtime import RealtimeSettings
from runtime.service_notify import ServiceNotify
from runtime.state_file import read_state, record_of, write_state
from runtime.stopping import StopRequest

pytestmark = pytest.mark.wall_clock

FAKE = (sys.executable, "-S", "-E", str(Path(__file__).with_name("fake_dbw.py")))
SETTINGS = StackSettings(
    interface="socketcan", channel="vcan7", harness_channel="vcan8", vehicle="tabby_evo"
)
ALL = {"steering", "throttle", "brake_servo", "supervisor", "safety_monitor", "plant"}


def wait_until(condition: Callable[[], bool], limit_s: float = 20.0) -> None:
    pause = threading.Event()
    deadline_ns = monotonic_ns() + round(limit_s * 1e9)
    while not condition():
        assert monotonic_ns() < deadline_ns, "did not come in time"
        pause.wait(0.01)


class Log:
    """What the children wrote and what the launcher said."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.events: list[Event] = []

    def lines(self) -> list[str]:
        return self.path.read_text().splitlines() if self.path.exists() else []

    def names(self, word: str) -> list[str]:
        return [line.split()[0] for line in self.lines() if line.split()[1] == word]

    def all_up(self) -> bool:
        """All have said so, and the launcher has written them down."""
        state = status("vcan7")
        is_written = state is not None and len(state.nodes) == len(ALL)
        return is_written and len(self.names("up")) == len(ALL)

    @property
    def said(self) -> str:
        return "\n".join(event.text for event in self.events)


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Log]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("FAKE_DBW_LOG", str(tmp_path / "log"))
    yield Log(tmp_path / "log")


class FakeService(ServiceNotify):
    """A service manager that remembers."""

    def __init__(self) -> None:
        super().__init__({})
        self.said: list[str] = []

    def alive(self, now_ns: int) -> None:
        self.said.append("alive")

    def status(self, text: str) -> None:
        self.said.append(text)

    def stopping(self) -> None:
        self.said.append("stopping")

    def is_silent(self) -> bool:
        """Whether nothing but alive or stopping has been said in the launcher's last looks."""
        threading.Event().wait(4 * process_stack.WATCH_S)
        before = len(self.said)
        threading.Event().wait(4 * process_stack.WATCH_S)
        return len(self.said) == before


def stack(
    log: Log,
    settings: StackSettings = SETTINGS,
    standstill: bool = True,
    service: ServiceNotify | None = None,
) -> ProcessStack:
    return ProcessStack(
        settings,
        report=log.events.append,
        command=FAKE,
        standstill=lambda hurry: standstill,
        service=service,
    )


@contextmanager
def supervised(running: ProcessStack) -> Iterator[None]:
    """Supervises in a thread."""
    request = StopRequest()
    thread = threading.Thread(target=running.supervise, args=(request,))
    thread.start()
    try:
        yield
    finally:
        request.count = 1
        thread.join()


def pid_of(running: ProcessStack, name: str) -> int:
    return next(record.pid for record in running.processes if record.name == name)


def test_one_process_per_node_starts_with_its_options_and_ends_brakes_last(log: Log) -> None:
    with stack(log):
        wait_until(log.all_up)
        state = read_state("vcan7")
        assert state is not None
        assert {record.name for record in state.nodes} == ALL
        assert all(record.is_alive for record in state.nodes)
    assert set(log.names("up")) == ALL
    assert (
        "steering up --interface socketcan --channel vcan7 --harness-channel vcan8 "
        "--vehicle tabby_evo --realtime auto" in log.lines()
    )
    assert log.names("down") == [
        "supervisor",
        "safety_monitor",
        "steering",
        "throttle",
        "brake_servo",
        "plant",
    ]
    assert read_state("vcan7") is None
    assert log.said == ""


def test_a_car_without_plant_gets_none(log: Log) -> None:
    settings = StackSettings(
        interface="socketcan",
        channel="can0",
        harness_channel="can1",
        vehicle="tabby_evo",
        with_plant=False,
        nodes=("steering", "supervisor"),
    )
    with stack(log, settings):
        wait_until(lambda: len(log.names("up")) == 2)
    assert set(log.names("up")) == {"steering", "supervisor"}


def test_bitrate_and_real_time_options_reach_every_process(log: Log) -> None:
    realtime = RealtimeSettings(scheduling="fifo:40", lock_memory=True, cpus=(0, 1))
    with stack(log, replace(SETTINGS, bitrate_bps=250_000, realtime=realtime)):
        wait_until(log.all_up)
    options = "--bitrate 250000 --realtime fifo:40 --lock-memory --cpus 0,1"
    assert sum(line.endswith(options) for line in log.lines()) == len(ALL)


def test_the_watchdog_is_told_only_once_every_child_does_its_cycles(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_DBW_MUTE", "1")
    service = FakeService()
    with stack(log, service=service) as running, supervised(running):
        wait_until(log.all_up)
        assert service.is_silent() and service.said == []
    monkeypatch.delenv("FAKE_DBW_MUTE")
    with stack(log, service=service) as running, supervised(running):
        wait_until(lambda: service.said.count("alive") > 3)
    assert service.said[-1] == "stopping"


def test_the_watchdog_is_told_nothing_more_when_a_child_has_died(log: Log) -> None:
    service = FakeService()
    with stack(log, service=service) as running, supervised(running):
        wait_until(lambda: "alive" in service.said)
        os.kill(pid_of(running, "throttle"), signal.SIGKILL)
        wait_until(lambda: "died" in log.said)
        assert "died: signal SIGKILL" in service.said[-1]
        assert service.is_silent()


def test_a_child_whose_loop_hangs_is_named_and_the_watchdog_told_nothing_more(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = FakeService()
    with stack(log, service=service) as running, supervised(running):
        wait_until(lambda: "alive" in service.said)
        pid = pid_of(running, "brake_servo")
        os.kill(pid, signal.SIGUSR1)
        wait_until(lambda: "hangs" in log.said)
        assert f"brake_servo (process {pid}) hangs: no cycle for 1 s" in log.said
        assert all(record.is_alive for record in running.processes)
        assert service.is_silent()


def test_no_process_is_ended_before_the_wait_for_standstill_is_over(log: Log) -> None:
    def standstill(hurry: Callable[[], bool]) -> bool:
        assert log.names("down") == []
        assert all(record.is_alive for record in running.processes)
        return False

    running = ProcessStack(SETTINGS, report=log.events.append, command=FAKE, standstill=standstill)
    with running:
        wait_until(log.all_up)
    assert len(log.names("down")) == len(ALL)
    assert "cannot tell that the car stands" in log.said


def test_a_child_that_dies_is_named_and_the_others_go_on(log: Log) -> None:
    with StopRequest() as request, stack(log) as running:
        wait_until(log.all_up)
        victim = next(r for r in running.processes if r.name == "throttle")
        os.kill(victim.pid, signal.SIGKILL)

        def stop_later() -> None:
            wait_until(lambda: "died" in log.said)
            assert all(r.is_alive for r in running.processes if r.name != "throttle")
            os.kill(os.getpid(), signal.SIGTERM)

        helper = threading.Thread(target=stop_later)
        helper.start()
        assert running.supervise(request) == 1
        helper.join()
    assert f"throttle (process {victim.pid}) died: signal SIGKILL" in log.said
    assert "throttle" not in log.names("down") and len(log.names("down")) == len(ALL) - 1


def test_a_child_that_ends_by_itself_is_named_with_its_exit_code(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_DBW_DIES", "plant")
    with StopRequest() as request, stack(log) as running:
        wait_until(lambda: len(log.names("up")) == len(ALL) - 1)
        plant = next(r for r in running.processes if r.name == "plant")
        wait_until(lambda: not plant.is_alive)
        request.count = 1
        assert running.supervise(request) == 1
    assert f"plant (process {plant.pid}) died: exit code 3" in log.said


def test_launcher_ends_when_no_child_is_left(log: Log) -> None:
    settings = StackSettings(
        interface="socketcan",
        channel="vcan7",
        harness_channel="vcan8",
        vehicle="tabby_evo",
        with_plant=False,
        nodes=("steering",),
    )
    with StopRequest() as request, stack(log, settings) as running:
        wait_until(lambda: log.names("up") == ["steering"])
        os.kill(running.processes[0].pid, signal.SIGTERM)
        assert running.supervise(request) == 1
    assert "no process is left" in log.said


def test_told_to_stop_with_every_child_alive_is_success(log: Log) -> None:
    with StopRequest() as request, stack(log) as running:
        wait_until(log.all_up)
        os.kill(os.getpid(), signal.SIGINT)
        assert running.supervise(request) == 0


def test_a_child_that_does_not_listen_is_killed(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_stack, "TERMINATE_S_MAX", 0.2)
    monkeypatch.setenv("FAKE_DBW_DEAF", "steering")
    with stack(log) as running:
        wait_until(log.all_up)
    assert not any(record.is_alive for record in running.processes)
    assert "steering" in log.said and "killed" in log.said


def test_a_second_stack_on_the_same_channel_is_refused(log: Log) -> None:
    with stack(log):
        wait_until(log.all_up)
        with pytest.raises(LaunchError, match="a stack is up on channel 'vcan7'"), stack(log):
            pass
        assert len(log.names("up")) == len(ALL)
        assert read_state("vcan7") is not None


def test_a_stale_state_file_is_cleaned_up(log: Log) -> None:
    with stack(log):
        wait_until(log.all_up)
        old = read_state("vcan7")
    assert old is not None
    write_state(old)
    with stack(log):
        wait_until(lambda: len(log.names("up")) == 2 * len(ALL))
    assert read_state("vcan7") is None


def test_children_of_an_earlier_stack_are_not_joined_by_new_ones(log: Log) -> None:
    bystander = subprocess.Popen([sys.executable, "-S", "-E", "-c", "input()"], stdin=-1)
    try:
        with stack(log):
            old = read_state("vcan7")
        left = record_of("throttle", bystander.pid)
        assert old is not None and left is not None
        write_state(replace(old, nodes=(left,)))
        with pytest.raises(LaunchError, match="still run on channel 'vcan7': throttle"), stack(log):
            pass
        assert bystander.poll() is None
    finally:
        bystander.kill()
        bystander.communicate()


def test_a_command_that_cannot_be_started_leaves_nothing_behind(log: Log) -> None:
    broken = ProcessStack(
        SETTINGS,
        report=log.events.append,
        command=("/no/such/program",),
        standstill=lambda hurry: True,
    )
    with pytest.raises(LaunchError, match="cannot start plant"), broken:
        pass
    assert read_state("vcan7") is None


def test_virtual_bus_does_not_reach_other_processes(log: Log) -> None:
    settings = StackSettings(
        interface="virtual", channel="a", harness_channel="b", vehicle="tabby_evo"
    )
    with (
        pytest.raises(LaunchError, match="'virtual' stays within one process"),
        stack(log, settings),
    ):
        pass


def test_one_channel_for_both_buses_is_refused(log: Log) -> None:
    settings = StackSettings(
        interface="socketcan", channel="vcan0", harness_channel="vcan0", vehicle="tabby_evo"
    )
    with pytest.raises(LaunchError, match="must be two buses"), stack(log, settings):
        pass


def test_an_unknown_node_is_refused_by_name(log: Log) -> None:
    settings = StackSettings(
        interface="socketcan",
        channel="vcan7",
        harness_channel="vcan8",
        vehicle="tabby_evo",
        nodes=("clutch",),
    )
    with pytest.raises(LaunchError, match="'clutch' is not known: allowed steering"):
        stack(log, settings)


@pytest.mark.parametrize(
    ("code", "words"),
    [(3, "exit code 3"), (-9, "signal SIGKILL"), (-11, "signal SIGSEGV"), (-200, "signal 200")],
)
def test_how_a_process_ended_is_said_in_words(code: int, words: str) -> None:
    assert how_it_ended(code) == words


LAUNCHER = """
import sys
from runtime.process_stack import ProcessStack, StackSettings
settings = StackSettings(
    interface="socketcan", channel="vcan7", harness_channel="vcan8", vehicle="tabby_evo"
)
stack = ProcessStack(
    settings, report=lambda event: None, command=sys.argv[1:], standstill=lambda hurry: True
)
sys.exit(stack.run())
"""


@pytest.fixture
def launcher(log: Log) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, "-c", LAUNCHER, *FAKE])
    try:
        wait_until(log.all_up)
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def test_stop_from_another_process_ends_everything_in_order(
    log: Log, launcher: subprocess.Popen[bytes]
) -> None:
    reaper = threading.Thread(target=launcher.wait)
    reaper.start()
    result = stop("vcan7")
    reaper.join()
    assert launcher.returncode == 0
    assert set(result.stopped) == {"launcher", *ALL}
    assert result.killed == () and not result.was_stale
    assert log.names("down")[-2:] == ["brake_servo", "plant"]
    assert status("vcan7") is None


def test_status_tells_what_is_alive(log: Log, launcher: subprocess.Popen[bytes]) -> None:
    state = status("vcan7")
    assert state is not None
    assert {record.name for record in state.alive} == {"launcher", *ALL}
    assert (state.interface, state.vehicle) == ("socketcan", "tabby_evo")


def test_children_of_a_killed_launcher_do_not_go_on(
    log: Log, launcher: subprocess.Popen[bytes]
) -> None:
    state = status("vcan7")
    assert state is not None
    launcher.kill()
    launcher.wait()
    wait_until(lambda: not state.alive)
    assert len(log.names("orphan")) == len(ALL)
    assert stop("vcan7").was_stale
    assert status("vcan7") is None


def test_children_that_outlive_their_launcher_are_ended_in_order_by_stop(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_DBW_STAYS", "1")
    monkeypatch.setenv("FAKE_DBW_DEAF", "throttle")
    monkeypatch.setattr(stack_control, "TERMINATE_S_MAX", 1.0)
    launcher = subprocess.Popen([sys.executable, "-c", LAUNCHER, *FAKE])
    try:
        wait_until(log.all_up)
    finally:
        launcher.kill()
        launcher.wait()
    result = stop("vcan7")
    assert result.killed == ("throttle",)
    assert set(result.stopped) == ALL - {"throttle"}
    assert log.names("down") == [
        "supervisor",
        "safety_monitor",
        "steering",
        "brake_servo",
        "plant",
    ]
    assert status("vcan7") is None


def test_a_launcher_that_hangs_is_killed_with_its_children(
    log: Log, launcher: subprocess.Popen[bytes]
) -> None:
    os.kill(launcher.pid, signal.SIGSTOP)
    reaper = threading.Thread(target=launcher.wait)
    reaper.start()
    result = stop("vcan7", limit_s=0.2)
    reaper.join()
    assert result.killed[-1] == "launcher"
    assert status("vcan7") is None
    assert log.names("down")[-2:] == ["brake_servo", "plant"]


def test_stop_without_a_stack_says_so(log: Log) -> None:
    with pytest.raises(LaunchError, match="no stack is up on channel 'vcan7'"):
        stop("vcan7")


def test_stop_signals_nobody_whose_start_time_differs(log: Log) -> None:
    bystander = subprocess.Popen([sys.executable, "-S", "-E", "-c", "input()"], stdin=-1)
    try:
        with stack(log):
            wait_until(log.all_up)
            old = read_state("vcan7")
        assert old is not None
        own = record_of("plant", bystander.pid)
        assert own is not None
        earlier = replace(own, start_ticks=own.start_ticks - 1)
        nodes = tuple(replace(earlier, name=record.name) for record in old.nodes)
        write_state(replace(old, launcher=replace(nodes[0], name="launcher"), nodes=nodes))
        assert stop("vcan7").was_stale
        assert bystander.poll() is None
    finally:
        bystander.kill()
        bystander.communicate()
