"""A drive in wall time: a running stack on two buses, and this process as planner and driver.

The stack may be threads of this process or processes of their own; either way the planner meets
it over CAN, and the truth comes from the plant over the harness bus.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from typing import Self

import numpy as np

from canbus.frame import ReceivedFrame
from canbus.python_can_bus import PythonCanBus
from dbc.harness import PlantMotionWire, PlantPositionWire
from dbw.plan import DrivePlan
from dbw.stage import DriveFailed
from gateway.api import Car
from gateway.connect import connect
from planner.gnss import GnssFix, GnssReceiver
from planner.pose import Pose
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns
from runtime.harness import HANDS_OFF, SPEC_OF_NAME, decode_harness, harness_frame
from runtime.launch import InProcessStack, ProcessStack, StackSettings
from simulation.trace import Trace
from telemetry.bus_log import BusLog
from telemetry.recording import BusRecorder, DriveRecorder

BUTTON_S = 0.15
TRUTH_ACCEPTANCE = frozenset(
    SPEC_OF_NAME[name].can_id for name in ("PLANT_POSITION", "PLANT_MOTION")
)
RECEIVE_NS = 50_000_000
TRUTH_NS_MAX = 500_000_000
"""Without a true pose for this long there is no plant to measure against."""

Stack = AbstractContextManager[object]
Check = Callable[[], None]


class TruthListener:
    """The plant's true pose from the harness bus, in the road's coordinates.

    The plant stands wherever it was started; its first pose is the line's start. Each pose goes
    to the satellite receiver when it arrives, and to the recorder while that is wanted.

    Args:
        bus: The harness bus, open.
        start: Where on the road the car stands.
        receiver: Gets every true position.
        recorder: Gets them too, between `begin` and the end.
    """

    def __init__(
        self, bus: PythonCanBus, start: Pose, receiver: GnssReceiver, recorder: DriveRecorder
    ) -> None:
        self._bus = bus
        self._start = start
        self._receiver = receiver
        self._recorder = recorder
        self._fixes: deque[GnssFix] = deque()
        self._position: PlantPositionWire | None = None
        self._anchor: tuple[float, float, float] | None = None
        self._is_recording = False
        self._newest_ns = monotonic_ns()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="truth", daemon=True)

    def __enter__(self) -> Self:
        """Starts to listen, in a thread."""
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stops and joins it."""
        self._ended.set()
        self._thread.join()

    @property
    def is_silent(self) -> bool:
        """Whether true poses came and come no longer."""
        is_over = monotonic_ns() - self._newest_ns > TRUTH_NS_MAX
        return self._anchor is not None and is_over

    def take_fixes(self) -> list[GnssFix]:
        """Fixes that have arrived since the last call; the first call starts the recording."""
        self._is_recording = True
        fixes: list[GnssFix] = []
        while self._fixes:
            fixes.append(self._fixes.popleft())
        return fixes

    def _run(self) -> None:
        while not self._ended.is_set():
            for item in self._bus.receive(RECEIVE_NS):
                self._take(item)

    def _take(self, item: ReceivedFrame) -> None:
        reading = decode_harness(item)
        if reading is None:
            return
        if isinstance(reading.content, PlantPositionWire):
            self._position = reading.content
        elif isinstance(reading.content, PlantMotionWire) and self._position is not None:
            self._take_pose(item.arrival_ns, self._position, reading.content)

    def _take_pose(
        self, time_ns: int, position: PlantPositionWire, motion: PlantMotionWire
    ) -> None:
        if self._anchor is None:
            self._anchor = (position.x_m, position.y_m, motion.heading_rad)
        x0_m, y0_m, heading0_rad = self._anchor
        turn_rad = self._start.heading_rad - heading0_rad
        dx_m, dy_m = position.x_m - x0_m, position.y_m - y0_m
        x_m = self._start.x_m + dx_m * math.cos(turn_rad) - dy_m * math.sin(turn_rad)
        y_m = self._start.y_m + dx_m * math.sin(turn_rad) + dy_m * math.cos(turn_rad)
        self._newest_ns = time_ns
        if self._is_recording:
            self._recorder.add_truth(time_ns, x_m, y_m, motion.speed_mps)
        self._fixes.extend(self._receiver.step(time_ns, x_m, y_m))


class WallStage:
    """Implements `dbw.stage.Stage` on a stack that it starts and stops.

    Args:
        plan: What is to be driven.
        seed: Of the satellite receiver's noise.
        interface: python-can's name.
        channel: The vehicle bus.
        harness_channel: The wires between plant and nodes.
        stack: The nodes and the plant; entered first, left last.
        check_stack: Raises DriveFailed when a part of the stack is gone.
    """

    def __init__(
        self,
        plan: DrivePlan,
        seed: int,
        *,
        interface: str,
        channel: str,
        harness_channel: str,
        stack: Stack,
        check_stack: Check,
    ) -> None:
        self._interface = interface
        self._harness_channel = harness_channel
        self._stack = stack
        self._check_stack = check_stack
        self._buses = ExitStack()
        self._listener: TruthListener | None = None
        self._start = plan.line.start
        self._receiver = GnssReceiver(np.random.default_rng(seed))
        self._log_bus = PythonCanBus(
            interface, channel, clock=monotonic_ns, realtime=realtime_ns
        )
        self.log = BusLog()
        self.recorder = DriveRecorder()
        self.car: Car = connect(
            interface,
            channel,
            vehicle=plan.vehicle,
            planner_period_s=plan.planner_period_ns / NS_PER_S,
        )

    def __enter__(self) -> Self:
        """Opens the buses, starts the stack, connects the planner.

        Raises:
            BusError: A bus cannot be opened; nothing was started.
            LaunchError: The stack cannot be started.
        """
        with ExitStack() as buses:
            buses.enter_context(self._log_bus)
            harness = buses.enter_context(self._harness_bus(TRUTH_ACCEPTANCE))
            buses.enter_context(self._stack)
            buses.enter_context(BusRecorder(self._log_bus, monotonic_ns, self.log))
            listener = TruthListener(harness, self._start, self._receiver, self.recorder)
            self._listener = buses.enter_context(listener)
            buses.enter_context(self.car)
            self._buses = buses.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stops the car if it drives, then everything else."""
        self._buses.close()

    @property
    def trace_sha256(self) -> str:
        """Hash of what was recorded; another in every run, for the wall clock is in it."""
        trace = Trace(keep=False)
        for row in self.log.rows():
            trace(*row)
        return trace.sha256

    def press_button(self) -> None:
        """The person in the car presses Auto/Manual and lets go."""
        with self._harness_bus(frozenset()) as bus:
            for is_pressed in (True, False):
                hands = replace(HANDS_OFF, button_pressed=is_pressed)
                bus.send(harness_frame("DRIVER_HANDS", hands))
                threading.Event().wait(BUTTON_S)

    def observe(self) -> Iterable[GnssFix]:
        """Answers the fixes that have arrived; the truth is noted as it comes."""
        assert self._listener is not None, "only within `with`"
        return self._listener.take_fixes()

    def check(self) -> None:
        """Raises DriveFailed when the stack or the plant is gone."""
        assert self._listener is not None, "only within `with`"
        self._check_stack()
        if self._listener.is_silent:
            raise DriveFailed(f"no true pose from the plant for {TRUTH_NS_MAX / NS_PER_S:g} s")

    def _harness_bus(self, acceptance: frozenset[int]) -> PythonCanBus:
        return PythonCanBus(
            self._interface,
            self._harness_channel,
            clock=monotonic_ns,
            realtime=realtime_ns,
            acceptance=acceptance,
        )


def in_process_stage(plan: DrivePlan, seed: int, channel: str) -> WallStage:
    """All nodes as threads of this process, on python-can's `virtual` bus.

    Raises:
        LaunchError: The vehicle has no plant.
    """
    stack = InProcessStack(vehicle=plan.vehicle, channel=channel, seed=seed)

    def check() -> None:
        for name, result in stack.results.items():
            raise DriveFailed(f"{name} has ended: {result.failure or 'no reason given'}")

    return WallStage(
        plan,
        seed,
        interface="virtual",
        channel=channel,
        harness_channel=stack.harness_channel,
        stack=stack,
        check_stack=check,
    )


def process_stage(
    plan: DrivePlan, seed: int, settings: StackSettings, say: Callable[[str], None]
) -> WallStage:
    """One process per node, on an interface that reaches them all.

    Args:
        plan: What is to be driven.
        seed: Of the satellite receiver; the plant's process has its own.
        settings: What to start.
        say: Gets what the launcher reports.
    """
    stack = ProcessStack(settings, report=lambda event: say(f"{event.node}: {event.text}"))

    def check() -> None:
        dead = [record.name for record in stack.processes if not record.is_alive]
        if dead:
            raise DriveFailed(f"processes that have ended: {', '.join(dead)}")

    return WallStage(
        plan,
        seed,
        interface=settings.interface,
        channel=settings.channel,
        harness_channel=settings.harness_channel,
        stack=stack,
        check_stack=check,
    )
