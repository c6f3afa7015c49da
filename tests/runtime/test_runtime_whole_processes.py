"""The real nodes, one process each: engage, drive, lose one, go down while the planner drives."""

from __future__ import annotations

import itertools
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from canbus.node import Event
from canbus.python_can_bus import PythonCanBus
from dbc.messages import Mode
from gateway.api import Car
from gateway.connect import connect
from runtime.clock import monotonic_ns
from runtime.harness import HANDS_OFF, harness_frame
from runtime.launch import ProcessStack, StackSettings
from runtime.service_notify import ServiceNotify
from runtime.stopping import StopRequest
from tests.runtime import folder_bus
from tests.runtime.fake_manager import Manager
from vehicles import load_vehicle

pytestmark = [pytest.mark.wall_clock, pytest.mark.slow]

DRIVE_TICKS = 75


class Drive:
    """A stack of processes, a planner, and what the launcher said."""

    def __init__(
        self, folder: Path, service: ServiceNotify | None = None, vehicle: str = "tabby_evo"
    ) -> None:
        self.vehicle = vehicle
        self.channel, self.harness_channel = str(folder / "v"), str(folder / "h")
        self.events: list[Event] = []
        self.stack = ProcessStack(
            StackSettings(
                interface=folder_bus.NAME,
                channel=self.channel,
                harness_channel=self.harness_channel,
                vehicle=vehicle,
            ),
            report=self.events.append,
            command=(sys.executable, "-m", "tests.runtime.folder_bus"),
            service=service,
        )

    def press_button(self) -> None:
        for is_pressed in (True, False):
            frame = harness_frame("DRIVER_HANDS", replace(HANDS_OFF, button_pressed=is_pressed))
            with PythonCanBus(folder_bus.NAME, self.harness_channel, clock=monotonic_ns) as bus:
                bus.send(frame)
            threading.Event().wait(0.2)

    def engage(self, car: Car) -> None:
        wait_until(lambda: car.state.mode is Mode.MANUAL)
        self.press_button()
        wait_until(lambda: car.state.mode is Mode.READY)
        car.engage()
        for _ in itertools.islice(car.ticks(), DRIVE_TICKS):
            car.command(speed_mps=1.5, curvature_per_m=0.0)
        if car.state.mode is not Mode.AUTOMATIC:
            pytest.skip(f"the machine is too busy for nodes with a 10 ms cycle: {car.state.codes}")

    @property
    def said(self) -> str:
        return "\n".join(event.text for event in self.events)


def wait_until(condition: Callable[[], bool]) -> None:
    pause = threading.Event()
    deadline_ns = monotonic_ns() + 120_000_000_000
    while not condition():
        assert monotonic_ns() < deadline_ns, "did not come in time"
        pause.wait(0.01)


@pytest.fixture(params=["tabby_evo"])
def drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> Iterator[Drive]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(Path(__file__).parents[2])
    folder_bus.register()
    yield Drive(tmp_path, vehicle=request.param)


def planner(drive: Drive) -> Car:
    return connect(folder_bus.NAME, drive.channel, vehicle=load_vehicle(drive.vehicle))


@pytest.mark.parametrize("drive", ["tabby_evo", "baja_5b"], indirect=True)
def test_a_killed_process_is_named_and_the_others_stop_the_car(drive: Drive) -> None:
    with drive.stack as stack, planner(drive) as car:
        drive.engage(car)
        victim = next(record for record in stack.processes if record.name == "throttle")
        os.kill(victim.pid, signal.SIGKILL)
        wait_until(lambda: car.state.mode is Mode.EMERGENCY)
        wait_until(lambda: car.state.brake_position_ratio > 0.95)
        assert [r.name for r in stack.processes if not r.is_alive] == ["throttle"]


@pytest.mark.parametrize("drive", ["baja_5b"], indirect=True)
def test_the_motor_drives_are_started_set_up_and_commanded_by_other_processes(
    drive: Drive,
) -> None:
    heard: set[int] = set()

    def are_commanded() -> bool:
        heard.update(item.frame.can_id for item in bus.receive(10_000_000))
        return {0x211, 0x312, 0x313, 0x191, 0x292, 0x293} <= heard

    with (
        drive.stack,
        planner(drive) as car,
        PythonCanBus(folder_bus.NAME, drive.channel, clock=monotonic_ns) as bus,
    ):
        wait_until(are_commanded)
        wait_until(lambda: car.state.codes == ())


def test_going_down_stops_a_car_whose_planner_drives_on(drive: Drive) -> None:
    modes: list[Mode | None] = []
    speeds: list[float] = []

    def drive_on(car: Car, done: threading.Event) -> None:
        with suppress(Exception):  # the planner does not know better, the car does
            for state in car.ticks():
                if done.is_set():
                    return
                modes.append(state.mode)
                speeds.append(state.speed_mps)
                if state.mode is Mode.AUTOMATIC:
                    car.command(speed_mps=1.5, curvature_per_m=0.0)

    done = threading.Event()
    with planner(drive) as car:
        with drive.stack as stack:
            drive.engage(car)
            thread = threading.Thread(target=drive_on, args=(car, done))
            thread.start()
            wait_until(lambda: len(modes) > 5)
        done.set()
        thread.join()
    assert not any(record.is_alive for record in stack.processes)
    assert modes[0] is Mode.AUTOMATIC and Mode.EMERGENCY in modes
    heard = [speed for speed in speeds if speed == speed]
    assert heard[0] > 0.5 and abs(heard[-1]) < 0.1
    assert drive.said == ""


def test_the_launcher_is_ready_when_every_node_runs_and_silent_when_one_loop_hangs(
    drive: Drive, tmp_path: Path
) -> None:
    with Manager(tmp_path / "notify") as manager, StopRequest() as request:
        watched = Drive(tmp_path, ServiceNotify(manager.environment))
        heard: list[str] = []

        def has_said(text: str) -> bool:
            heard.extend(manager.heard())
            return any(text in message for message in heard)

        with watched.stack as stack:
            thread = threading.Thread(target=stack.supervise, args=(request,))
            thread.start()
            wait_until(lambda: has_said("READY=1"))
            victim = next(record for record in stack.processes if record.name == "steering")
            os.kill(victim.pid, signal.SIGSTOP)
            wait_until(lambda: "hangs: no cycle" in watched.said)
            assert has_said("STATUS=steering")
            heard.clear()
            threading.Event().wait(1.0)  # two pings' time
            assert not has_said("WATCHDOG=1")
            os.kill(victim.pid, signal.SIGCONT)
            wait_until(lambda: has_said("WATCHDOG=1"))
            request.count = 1
            thread.join()
        assert has_said("STOPPING=1")
