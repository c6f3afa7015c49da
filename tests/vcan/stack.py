"""The stack on real SocketCAN: a process per node, a car whose parts can be broken, candump.

Processes are forked from one server that has imported everything once: starting Python anew for
each would cost seconds under emulation.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from canbus.python_can_bus import PythonCanBus
from dbc.endpoint import STOPPING_IDS
from dbc.messages import Mode, SupervisorState
from gateway.sentences import ONLY_THE_BUTTON
from runtime.clock import NS_PER_S, monotonic_ns
from runtime.harness import HANDS_OFF, harness_frame
from runtime.nodes import NODES, PLANT
from runtime.process_settings import ProcessSettings
from simulation.plant.state import Truth
from tests.vcan.bus_log import HARNESS_BUS, Line, candump, read_log
from tests.vcan.planner import Planner, answer, planner_main
from tests.vcan.processes import in_namespace, node_main, plant_main

PRELOAD = [
    "tests.vcan.stack", "ecus.steering.ecu", "ecus.throttle.ecu", "ecus.brake_servo.ecu",
    "ecus.supervisor.ecu", "safety_monitor.monitor", "can.interfaces.socketcan",
]
PLANNER = "planner"
MOVING_MPS = 2.0
RECOVERY_S_MAX = 20.0
VEHICLE_BUS = "vcan0"
VEHICLE = "tabby_evo"


def pause(span_s: float) -> None:
    """The wall clock is the subject here."""
    threading.Event().wait(span_s)


class Stack:
    """All nodes, the car and a planner; `with` starts them and ends them.

    Args:
        folder: for logs.
        channel: the vehicle bus, as the log and most nodes see it.
        channels: where other processes see it, by name.
        in_namespaces: processes that live in a network namespace of their own name.
        vehicle: what the nodes believe about the car.
    """

    def __init__(
        self,
        folder: Path,
        *,
        channel: str = VEHICLE_BUS,
        channels: dict[str, str] | None = None,
        in_namespaces: Collection[str] = (),
        vehicle: str = VEHICLE,
    ) -> None:
        self.folder = folder
        self.channel = channel
        self._channels = channels or {}
        self._in_namespaces = in_namespaces
        self._vehicle = vehicle
        self.log_path = folder / "bus.log"
        self.processes: dict[str, Any] = {}
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(PRELOAD)
        self._hands = HANDS_OFF
        self._said_before: dict[str, int] = {}
        self._harness = PythonCanBus(
            "socketcan", HARNESS_BUS, clock=monotonic_ns, acceptance=frozenset()
        )

    def __enter__(self) -> Self:
        self._candump = candump(self.log_path, self.channel, HARNESS_BUS)
        self._candump.__enter__()
        self._harness.__enter__()
        self._start_plant()
        for name in NODES:
            self.start(name)
        self.start_planner()
        return self

    def __exit__(self, *exception: object) -> None:
        for process in self.processes.values():
            if process.is_alive():
                os.kill(process.pid, signal.SIGCONT)
                process.terminate()
        for process in self.processes.values():
            process.join(5.0)
            if process.is_alive():
                process.kill()
                process.join()
        self._harness.close()
        self._candump.__exit__(*sys.exc_info())

    # Processes -------------------------------------------------------------------------------

    def _settings(self, name: str) -> ProcessSettings:
        return ProcessSettings(
            name=name, vehicle=self._vehicle, interface="socketcan",
            channel=self._channels.get(name, self.channel), harness_channel=HARNESS_BUS,
        )

    def _start_plant(self) -> None:
        self._control, theirs = self._context.Pipe()
        self._run(PLANT, plant_main, self._settings(PLANT), self._path(PLANT), theirs)

    def start(self, name: str) -> None:
        """Starts a node, anew if it has ended."""
        self._run(name, node_main, self._settings(name), self._path(name))

    def start_planner(self) -> None:
        """Starts the planner, anew if it has ended."""
        ours, theirs = self._context.Pipe()
        self.planner = Planner(ours)
        channel = self._channels.get(PLANNER, self.channel)
        self._run(PLANNER, planner_main, channel, self._vehicle, theirs)

    def _run(self, name: str, main: Callable[..., None], *arguments: Any) -> None:
        namespace = name if name in self._in_namespaces else None
        process = self._context.Process(
            target=in_namespace, args=(namespace, main, *arguments), name=name
        )
        process.start()
        self.processes[name] = process

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.log"

    def said(self, name: str) -> str:
        """What a node has reported since the car was parked last."""
        path = self._path(name)
        return path.read_text()[self._said_before.get(name, 0) :] if path.exists() else ""

    def kill(self, name: str, number: signal.Signals = signal.SIGKILL) -> float:
        """Sends a signal; answers the time, comparable with the log's."""
        now_s = time.time()
        os.kill(self.processes[name].pid, number)
        return now_s

    # The car and its driver ------------------------------------------------------------------

    def hands(self, **inputs: Any) -> float:
        """What the driver does from now on; answers the time, comparable with the log's."""
        self._hands = replace(self._hands, **inputs)
        now_s = time.time()
        assert self._harness.send(harness_frame("DRIVER_HANDS", self._hands))
        return now_s

    def break_(self, name: str, value: Any = True) -> float:
        """A fault of the car (`PlantFaults`); answers the time."""
        now_s = time.time()
        self._control.send((name, value))
        return now_s

    def truth(self) -> Truth:
        """Where the car truly is."""
        self._control.send(("truth", None))
        truth: Truth = answer(self._control)
        return truth

    def press_button(self) -> None:
        """Auto/Manual, pressed and let go."""
        self.hands(button_pressed=True)
        pause(0.15)
        self.hands(button_pressed=False)

    # Procedures ------------------------------------------------------------------------------

    def recover(self) -> None:
        """After whatever happened: every process runs, nothing is broken, MANUAL, standing."""
        for name, process in list(self.processes.items()):
            if process.is_alive():
                os.kill(process.pid, signal.SIGCONT)
            elif name == PLANNER:
                self.start_planner()
            else:
                self.start(name)
        self._control.send(("repair", None))
        self.planner.stop()
        self._hands = HANDS_OFF
        self.hands(brake_pedal_ratio=0.6)
        self.wait(lambda: abs(self.truth().speed_mps) < 0.01, 10.0)
        self.hands(brake_pedal_ratio=0.0)
        self.wait(self._is_ready, RECOVERY_S_MAX)
        self._said_before = {
            name: len(self._path(name).read_text()) for name in NODES if self._path(name).exists()
        }

    def _is_ready(self) -> bool:
        state = self.planner.state()
        if state.mode is Mode.EMERGENCY:
            self.planner.attempt("reset", timeout_s=1.0)
        elif state.mode is Mode.READY:
            self.press_button()
        return state.mode is Mode.MANUAL and state.why_not_engaged == ONLY_THE_BUTTON

    def engage(self) -> None:
        """From MANUAL to AUTOMATIC."""
        self.press_button()
        self.wait(lambda: self.planner.state().mode is Mode.READY, 1.0)
        assert self.planner.attempt("engage", timeout_s=3.0) is None

    def drive(self, speed_mps: float = 3.0, curvature_per_m: float = 0.0) -> None:
        """Engages and drives until the car moves."""
        self.engage()
        self.planner.go(speed_mps, curvature_per_m)
        self.wait(lambda: self.truth().speed_mps > MOVING_MPS, 5.0)

    def wait(self, condition: Callable[[], bool], limit_s: float) -> None:
        """Until the condition holds, at most so long in the guest's time."""
        deadline_ns = monotonic_ns() + round(limit_s * NS_PER_S)
        while not condition():
            assert monotonic_ns() < deadline_ns, f"not within {limit_s:g} s\n{self.story()}"
            pause(0.05)

    # What was on the bus ---------------------------------------------------------------------

    def log(self, since_s: float = 0.0) -> list[Line]:
        """What was on the vehicle bus."""
        lines = read_log(self.log_path, since_s)
        return [line for line in lines if line.channel == self.channel]

    def harness_log(self, since_s: float) -> list[Line]:
        """What was on the wires."""
        return [line for line in read_log(self.log_path, since_s) if line.channel == HARNESS_BUS]

    def sensed(
        self, since_s: float, is_it: Callable[[Any], bool], limit_s: float = 1.0
    ) -> float:
        """When the first reading of a kind was on the wires."""
        found: list[Line] = []

        def has_come() -> bool:
            found.extend(line for line in self.harness_log(since_s) if is_it(line.content))
            return bool(found)

        self.wait(has_come, limit_s)
        return found[0].time_s

    def first(self, since_s: float, is_it: Callable[[Line], bool], limit_s: float = 2.0) -> Line:
        """Waits for the first frame of a kind."""
        found: list[Line] = []
        seen_s = since_s

        def has_come() -> bool:
            nonlocal seen_s
            lines = self.log(seen_s)  # what was looked at before is not read again
            found.extend(line for line in lines if is_it(line))
            seen_s = lines[-1].time_s if lines else seen_s
            return bool(found)

        self.wait(has_come, limit_s)
        return found[0]

    @property
    def mode(self) -> Mode:
        """What the supervisor said last."""
        states = (line.content for line in reversed(self.log(time.time() - 0.5)))
        mode = next((state.mode for state in states if isinstance(state, SupervisorState)), None)
        assert mode is not None, f"no SUPERVISOR_STATE\n{self.story()}"
        return mode

    def first_brake(self, since_s: float) -> Line:
        """The first EMERGENCY_BRAKE since then."""
        return self.first(since_s, lambda line: line.can_id in STOPPING_IDS)

    def event(self, name: str, text: str, limit_s: float = 2.0) -> None:
        """Waits until a node has reported this."""
        self.wait(lambda: text in self.said(name), limit_s)

    def brakes(self) -> None:
        """Waits until the brakes are fully on and the car stands."""
        self.wait(lambda: self.truth().brake_ratio > 0.9, 1.0)
        self.wait(lambda: abs(self.truth().speed_mps) < 0.01, 5.0)

    def story(self) -> str:
        """What every node has said lately, for a test that fails."""
        return "\n".join(f"{name}: ...{self.said(name)[-400:]}" for name in (*NODES, PLANT))
