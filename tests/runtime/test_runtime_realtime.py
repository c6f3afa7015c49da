"""What is asked of the system, and what happens when it says no. Nothing is granted for real."""

from __future__ import annotations

import ctypes
import errno
import os
from collections.abc import Collection
from types import SimpleNamespace

import pytest

from canbus.bus import BusError
from runtime import node_process, plant_process
from runtime.errors import LaunchError
from runtime.node_process import run_node_process
from runtime.plant_process import run_plant_process
from runtime.process_settings import ProcessSettings
from runtime.realtime import AUTO_SCHEDULING, RealtimeSettings, apply_realtime


class System:
    """Grants or refuses; remembers what was asked."""

    def __init__(self) -> None:
        self.grants = True
        self.asked: list[tuple[int, int]] = []
        self.locked: list[int] = []
        self.cpus = {0, 1, 2, 3}

    def schedule(self, pid: int, policy: int, param: os.sched_param) -> None:
        assert pid == 0, "another thread than our own"
        self.asked.append((policy, param.sched_priority))
        if not self.grants:
            raise PermissionError(errno.EPERM, "not permitted")

    def mlockall(self, flags: int) -> int:
        self.locked.append(flags)
        ctypes.set_errno(0 if self.grants else errno.ENOMEM)
        return 0 if self.grants else -1

    def pin(self, pid: int, cpus: Collection[int]) -> None:
        usable = set(cpus) & {0, 1, 2, 3}
        if not usable:
            raise OSError(errno.EINVAL, "Invalid argument")
        self.cpus = usable


@pytest.fixture
def system(monkeypatch: pytest.MonkeyPatch) -> System:
    system = System()
    monkeypatch.setattr(os, "sched_setscheduler", system.schedule)
    monkeypatch.setattr(os, "sched_setaffinity", system.pin)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(system.cpus))
    monkeypatch.setattr(ctypes, "CDLL", lambda *arguments, **options: system)
    return system


def test_auto_takes_turns_with_nodes_of_equal_priority_and_passes_nothing_on(
    system: System,
) -> None:
    assert apply_realtime(RealtimeSettings()) is None
    assert AUTO_SCHEDULING == "rr:10"
    assert system.asked == [(os.SCHED_RR | os.SCHED_RESET_ON_FORK, 10)]
    assert system.locked == []


def test_auto_that_is_refused_is_told_and_goes_on(system: System) -> None:
    system.grants = False
    complaint = apply_realtime(RealtimeSettings())
    assert complaint is not None and "no real-time priority (CAP_SYS_NICE)" in complaint


def test_off_asks_for_nothing(system: System) -> None:
    assert apply_realtime(RealtimeSettings(scheduling="off")) is None
    assert not system.asked and not system.locked


@pytest.mark.parametrize(
    ("scheduling", "policy"), [("fifo:40", os.SCHED_FIFO), ("rr:40", os.SCHED_RR)]
)
def test_what_is_named_is_asked_for(system: System, scheduling: str, policy: int) -> None:
    settings = RealtimeSettings(scheduling=scheduling, lock_memory=True, cpus=(1, 2))
    assert apply_realtime(settings) is None
    assert system.asked == [(policy | os.SCHED_RESET_ON_FORK, 40)]
    assert system.locked == [1 | 2] and system.cpus == {1, 2}


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (RealtimeSettings(scheduling="fifo:50"), "--realtime fifo:50: refused .*CAP_SYS_NICE"),
        (RealtimeSettings(scheduling="off", lock_memory=True), "--lock-memory: .*CAP_IPC_LOCK"),
    ],
)
def test_what_is_named_and_refused_is_an_error(
    system: System, settings: RealtimeSettings, said: str
) -> None:
    system.grants = False
    with pytest.raises(LaunchError, match=said):
        apply_realtime(settings)


@pytest.mark.parametrize("cpus", [(7,), (2, 7)])
def test_processors_the_machine_lacks_are_refused_even_beside_ones_it_has(
    system: System, cpus: tuple[int, ...]
) -> None:
    with pytest.raises(LaunchError, match=r"--cpus .*7: refused .* allowed are 0,1,2,3"):
        apply_realtime(RealtimeSettings(cpus=cpus))
    assert system.cpus == {0, 1, 2, 3}


@pytest.mark.parametrize("text", ["fifo", "fifo:0", "fifo:100", "fifo:-1", "idle:3", "", "RR:1"])
def test_scheduling_that_does_not_exist_is_refused_with_what_does(text: str) -> None:
    with pytest.raises(LaunchError, match="allowed auto, off, and fifo:PRIO or rr:PRIO"):
        RealtimeSettings(scheduling=text)


@pytest.mark.parametrize("run", [run_node_process, run_plant_process])
def test_a_process_that_is_refused_ends_before_it_opens_a_bus(system: System, run: object) -> None:
    system.grants = False
    settings = ProcessSettings(
        name="steering",
        vehicle="tabby_evo",
        interface="nosuchbus",
        channel="a",
        harness_channel="b",
        realtime=RealtimeSettings(scheduling="fifo:50"),
    )
    assert callable(run)
    with pytest.raises(LaunchError, match="fifo:50: refused"):
        run(settings, lambda event: None)


@pytest.mark.parametrize(
    ("run", "module"), [(run_node_process, node_process), (run_plant_process, plant_process)]
)
def test_garbage_is_collected_before_the_priority_is_taken(
    run: object, module: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full collection takes tens of ms: at the priority no other node of its processor runs."""
    done: list[str] = []
    monkeypatch.setattr(module, "keep_collections_short", lambda: done.append("collected"))
    monkeypatch.setattr(module, "apply_realtime", lambda _: done.append("real time"))
    settings = ProcessSettings(
        name="steering", vehicle="tabby_evo", interface="nosuchbus", channel="a",
        harness_channel="b",
    )  # fmt: skip
    assert callable(run)
    with pytest.raises(BusError):
        run(settings, lambda event: None)
    assert done == ["collected", "real time"]


def test_a_node_listens_for_two_cycles_before_its_first_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done: list[object] = []
    listening = SimpleNamespace(Event=lambda: SimpleNamespace(wait=done.append))
    monkeypatch.setattr(node_process, "threading", listening)
    monkeypatch.setattr(node_process, "keep_collections_short", lambda: None)
    monkeypatch.setattr(node_process, "run_node", lambda *_, **__: done.append("steps"))
    settings = ProcessSettings(
        name="steering", vehicle="tabby_evo", interface="virtual", channel="listens",
        harness_channel="too", realtime=RealtimeSettings(scheduling="off"),
    )  # fmt: skip
    run_node_process(settings, lambda event: None)
    assert done == [0.02, "steps"]


def test_the_command_line_of_a_child_says_the_same_as_the_settings() -> None:
    assert RealtimeSettings().options == ["--realtime", "auto"]
    settings = RealtimeSettings(scheduling="rr:5", lock_memory=True, cpus=(1, 3))
    assert settings.options == ["--realtime", "rr:5", "--lock-memory", "--cpus", "1,3"]
