"""All nodes and the plant as threads of one process, on two `virtual` buses."""

from __future__ import annotations

import gc
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, Self

from canbus.frame import ReceivedFrame
from canbus.node import Event, EventKind, Node, StepOutput
from canbus.python_can_bus import PythonCanBus
from runtime.clock import NS_PER_S, Clock, monotonic_ns
from runtime.errors import LaunchError
from runtime.harness import HANDS_OFF, HarnessPort, harness_frame
from runtime.node_process import NodeResult, run_node
from runtime.nodes import NODES, PLANT, STOP_ORDER, build_node, build_wires, node_entry
from runtime.plant_process import ACCEPTANCE, PLANT_NODE, PlantSide, build_car, run_plant
from runtime.realtime import RealtimeSettings, apply_realtime, keep_collections_short
from simulation.plant.state import Pose, Truth
from vehicles import Vehicle

VIRTUAL = "virtual"
EVENTS_KEPT = 10_000
JOIN_S_MAX = 2.0
BUTTON_S = 0.15
"""How long `press_button` holds the button: longer than any debouncing."""

SWITCH_INTERVAL_S = 0.000_5
"""A thread that computes gives way after this long while others wait. Python's own 5 ms is half a
cycle: a planner in the same process would delay every node."""

def harness_channel_of(channel: str) -> str:
    """The virtual bus that stands for the wires of a stack on a channel."""
    return f"{channel}-harness"


NodeBuilder = Callable[[str, Vehicle], Node[Any, Any]]


class _Freezable:
    """A node that can be made to hang in the middle of a step, as a program in a loop does."""

    def __init__(self, node: Node[Any, Any]) -> None:
        self._node = node
        self._running = threading.Event()
        self._running.set()
        self.name = node.name
        self.acceptance = node.acceptance

    def freeze(self) -> None:
        """The next step does not return until `thaw`."""
        self._running.clear()

    def thaw(self) -> None:
        """Lets a step that hangs go on."""
        self._running.set()

    def step(self, now_ns: int, received: Sequence[ReceivedFrame], sensors: Any) -> StepOutput[Any]:
        """The node's step, or none as long as it is frozen."""
        output = self._node.step(now_ns, received, sensors)
        self._running.wait()
        return output


class _Worker:
    """One thread of the stack."""

    def __init__(self, name: str, run: Callable[[threading.Event], NodeResult]) -> None:
        self.stop = threading.Event()
        self.result: NodeResult | None = None
        self._run = run
        self.thread = threading.Thread(target=self._main, name=f"dbw-{name}")

    def _main(self) -> None:
        apply_realtime(RealtimeSettings())
        self.result = self._run(self.stop)


class InProcessStack:
    """The whole car in one process; started and stopped by `with`.

    Args:
        vehicle: what the nodes believe, and which plant stands behind it.
        channel: text that names the virtual bus; the harness is `<channel>-harness`. A planner in
            this process connects to `interface="virtual"` and this channel.
        nodes: names of the nodes to run, all five by default.
        seed: of the plant's sensor noise.
        start_pose: where the car stands.
        clock: for all of it.
        build: how a node is made from its name.

    Raises:
        LaunchError: a node is unknown, or the vehicle has no plant.
    """

    def __init__(
        self,
        *,
        vehicle: Vehicle,
        channel: str = "dbw",
        nodes: Sequence[str] = tuple(NODES),
        seed: int = 0,
        start_pose: Pose | None = None,
        clock: Clock = monotonic_ns,
        build: NodeBuilder = build_node,
    ) -> None:
        for name in nodes:
            node_entry(name)
        self.vehicle = vehicle
        self.channel = channel
        self.harness_channel = harness_channel_of(channel)
        self._names = tuple(nodes)
        self._seed = seed
        self._start_pose = start_pose or Pose(x_m=0.0, y_m=0.0, heading_rad=0.0)
        self._clock = clock
        self._build = build
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self._hands = HANDS_OFF
        self._pause = threading.Event()  # never set: what `press_button` waits on
        self._buses = ExitStack()
        self._freezables: dict[str, _Freezable] = {}
        self._workers: dict[str, _Worker] = {}
        self._plant: PlantSide | None = None
        self._plant_is_up = threading.Event()
        self._old_switch_interval_s = 0.0

    def __enter__(self) -> Self:
        """Opens the buses, then starts the plant and the nodes.

        Raises:
            BusError: a bus cannot be opened.
        """
        assert not self._workers, "the stack runs already"
        with ExitStack() as buses:
            workers = {PLANT: self._plant_worker(buses)}
            for name in self._names:
                workers[name] = self._node_worker(name, buses)
            self._buses = buses.pop_all()
        self._workers = workers
        self._old_switch_interval_s = sys.getswitchinterval()
        keep_collections_short()
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        workers[PLANT].thread.start()
        self._plant_is_up.wait(JOIN_S_MAX)  # a car has its sensors before its nodes boot
        for name in self._names:
            workers[name].thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stops and joins every thread, brake and plant last, and closes the buses."""
        hanging = [name for name in STOP_ORDER if name in self._workers and not self._end(name)]
        sys.setswitchinterval(self._old_switch_interval_s)
        gc.unfreeze()
        self._buses.close()
        if hanging and exception[0] is None:
            raise LaunchError(f"did not end within {JOIN_S_MAX:g} s: {', '.join(hanging)}")

    @property
    def events(self) -> tuple[Event, ...]:
        """What nodes and runtime have reported, the newest `EVENTS_KEPT`."""
        return tuple(self._events.copy())

    @property
    def results(self) -> dict[str, NodeResult]:
        """How the nodes that are over ended, by name."""
        return {
            name: worker.result
            for name, worker in self._workers.items()
            if worker.result is not None
        }

    def truth(self) -> Truth:
        """The car as it is, at most a cycle old."""
        assert self._plant is not None, "the stack has not been started"
        return self._plant.truth

    def driver(
        self,
        *,
        steering_torque_nm: float | None = None,
        throttle_pedal_ratio: float | None = None,
        brake_pedal_ratio: float | None = None,
        button_pressed: bool | None = None,
        emergency_stop_pressed: bool | None = None,
    ) -> None:
        """Changes what the person in the car does; None leaves it as it is.

        Args:
            steering_torque_nm: on the steering wheel, positive left, -100 to 100.
            throttle_pedal_ratio: 0 to 1.
            brake_pedal_ratio: 0 to 1.
            button_pressed: the Auto/Manual button.
            emergency_stop_pressed: the emergency stop.

        Raises:
            SignalRangeError: a value out of range; then nothing changes.
        """
        given = {
            "steering_torque_nm": steering_torque_nm,
            "throttle_pedal_ratio": throttle_pedal_ratio,
            "brake_pedal_ratio": brake_pedal_ratio,
            "button_pressed": button_pressed,
            "emergency_stop_pressed": emergency_stop_pressed,
        }
        changes: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
        hands = replace(self._hands, **changes)
        frame = harness_frame("DRIVER_HANDS", hands)
        # Opened for this frame alone: a bus that nobody reads would keep everything ever sent.
        with PythonCanBus(VIRTUAL, self.harness_channel, clock=self._clock) as bus:
            bus.send(frame)
        self._hands = hands

    def press_button(self, hold_s: float = BUTTON_S) -> None:
        """Presses and releases the Auto/Manual button; takes `hold_s`."""
        self.driver(button_pressed=True)
        self._pause.wait(hold_s)
        self.driver(button_pressed=False)

    def kill(self, name: str) -> None:
        """Ends one node, or the plant, as if its processor had died; the others are not told."""
        self._worker(name)
        if not self._end(name):
            raise LaunchError(f"{name} did not end within {JOIN_S_MAX:g} s")
        self._say(name, "killed")

    def freeze(self, name: str) -> None:
        """Makes one node hang for good, as a program in an endless loop."""
        self._worker(name)
        if name == PLANT:
            raise LaunchError("the plant cannot be frozen: it is the world, kill it instead")
        self._freezables[name].freeze()
        self._say(name, "frozen")

    def _worker(self, name: str) -> _Worker:
        worker = self._workers.get(name)
        if worker is None:
            known = ", ".join(self._workers) or "none, the stack has not been started"
            raise LaunchError(f"{name!r} is not running: running {known}")
        return worker

    def _end(self, name: str) -> bool:
        """Stops and joins one thread; whether it ended in time."""
        worker = self._workers[name]
        worker.stop.set()
        if name in self._freezables:
            self._freezables[name].thaw()
        worker.thread.join(JOIN_S_MAX)
        return not worker.thread.is_alive()

    def _say(self, name: str, text: str) -> None:
        node = PLANT_NODE if name == PLANT else NODES[name].node
        now_ns = self._clock()
        self._events.append(
            Event(time_ns=now_ns, node=node, kind=EventKind.STATE, text=f"{node} {text}")
        )

    def _open(self, channel: str, acceptance: frozenset[int] | None) -> PythonCanBus:
        return PythonCanBus(VIRTUAL, channel, clock=self._clock, acceptance=acceptance)

    def _node_worker(self, name: str, buses: ExitStack) -> _Worker:
        node = _Freezable(self._build(name, self.vehicle))
        self._freezables[name] = node
        wires = build_wires(name)
        bus = buses.enter_context(self._open(self.channel, node.acceptance))
        harness = buses.enter_context(self._open(self.harness_channel, wires.acceptance))
        port = HarnessPort(wires, harness)
        phase_ns = node_entry(name).phase_ns

        def run(stop: threading.Event) -> NodeResult:
            try:
                return run_node(
                    node, bus, port, self._clock, stop, self._events.append, phase_ns=phase_ns
                )
            finally:  # a dead node reads nothing: what is sent on must not pile up for it
                bus.close()
                harness.close()

        return _Worker(name, run)

    def _plant_worker(self, buses: ExitStack) -> _Worker:
        start_ns = self._clock()
        car = build_car(
            self.vehicle, seed=self._seed, start_pose=self._start_pose, start_ns=start_ns
        )
        plant = PlantSide(car, start_ns)
        bus = buses.enter_context(self._open(self.harness_channel, ACCEPTANCE))
        drives = plant.drive_acceptance
        vehicle_bus = buses.enter_context(self._open(self.channel, drives)) if drives else None
        self._plant = plant

        def run(stop: threading.Event) -> NodeResult:
            try:
                return run_plant(
                    plant,
                    bus,
                    self._clock,
                    stop,
                    self._events.append,
                    lambda truth: self._plant_is_up.set(),
                    vehicle_bus=vehicle_bus,
                )
            finally:
                bus.close()
                if vehicle_bus is not None:
                    vehicle_bus.close()

        return _Worker(PLANT, run)


assert BUTTON_S * NS_PER_S > 10 * 10_000_000  # ten of the supervisor's cycles
