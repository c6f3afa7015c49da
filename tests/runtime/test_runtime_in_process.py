"""All nodes as threads on the virtual bus, with small stand-ins for the nodes."""

from __future__ import annotations

import itertools
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from canbus.frame import Frame, ReceivedFrame
from canbus.node import NODE_IDS, Event, EventKind, StepOutput
from canbus.python_can_bus import PythonCanBus
from dbc.spec import SignalRangeError
from ecus.brake_servo.ports import RELEASED
from ecus.steering.ports import COAST
from ecus.supervisor.ports import SupervisorActuator
from ecus.throttle.ports import IDLE
from runtime.clock import monotonic_ns
from runtime.errors import LaunchError
from runtime.in_process import InProcessStack
from runtime.nodes import NODES
from vehicles import Vehicle, load_vehicle

pytestmark = pytest.mark.wall_clock

VEHICLE = load_vehicle("tabby_evo")
ACTUATORS: dict[str, Any] = {
    "steering": COAST,
    "throttle": IDLE,
    "brake_servo": RELEASED,
    "supervisor": SupervisorActuator(automatic_relay_closed=True),
    "safety_monitor": None,
}
_numbers = itertools.count()


class Beacon:
    """Sends one frame a step and remembers what it saw."""

    acceptance: frozenset[int] | None = None

    def __init__(self, name: str) -> None:
        self.name = NODES[name].node
        self.actuator = ACTUATORS[name]
        self.steps = 0
        self.sensors: Any = None
        self.heard: set[int] = set()
        self.fails = False

    def step(self, now_ns: int, received: Sequence[ReceivedFrame], sensors: Any) -> StepOutput[Any]:
        if self.fails:
            raise ZeroDivisionError("gain")
        self.steps += 1
        self.sensors = sensors
        self.heard |= {item.frame.can_id for item in received}
        frame = Frame(0x700 + NODE_IDS[self.name], b"\x05")
        return StepOutput(frames=[frame], actuator=self.actuator, events=())


class Bench:
    """A stack of beacons on channels of its own."""

    def __init__(self, nodes: Sequence[str] = tuple(NODES)) -> None:
        self.beacons = {name: Beacon(name) for name in nodes}
        self.stack = InProcessStack(
            vehicle=VEHICLE,
            channel=f"bench-{next(_numbers)}",
            nodes=nodes,
            build=self._build,
        )

    def _build(self, name: str, vehicle: Vehicle) -> Beacon:
        assert vehicle is VEHICLE
        return self.beacons[name]


def wait_until(condition: Callable[[], bool], limit_s: float = 10.0) -> None:
    pause = threading.Event()
    deadline_ns = monotonic_ns() + round(limit_s * 1e9)
    while not condition():
        assert monotonic_ns() < deadline_ns, "did not come in time"
        pause.wait(0.005)


def told(stack: InProcessStack) -> list[Event]:
    """Events, but for those that a busy machine adds."""
    return [event for event in stack.events if event.kind is not EventKind.OVERRUN]


def test_nothing_runs_before_the_block_and_nothing_after_it() -> None:
    before = set(threading.enumerate())
    interval_s = sys.getswitchinterval()
    bench = Bench()
    assert set(threading.enumerate()) == before
    with bench.stack:
        assert len(set(threading.enumerate()) - before) == 6
    assert set(threading.enumerate()) == before
    assert sys.getswitchinterval() == interval_s
    assert set(bench.stack.results) == {*NODES, "plant"}
    assert all(result.exit_code == 0 for result in bench.stack.results.values())


def test_every_node_hears_every_other_and_its_own_sensors() -> None:
    bench = Bench()
    everybody = {0x701, 0x702, 0x703, 0x704, 0x705}
    with bench.stack:
        for beacon in bench.beacons.values():
            own = 0x700 + NODE_IDS[beacon.name]
            wait_until(lambda b=beacon, o=own: b.heard == everybody - {o})  # type: ignore[misc]
        steering = bench.beacons["steering"]
        wait_until(lambda: abs(steering.sensors.column_angle_rad) < 0.1)
        wait_until(lambda: bench.beacons["brake_servo"].sensors.servo_position_ratio < 0.1)
    assert told(bench.stack) == []


def test_a_planner_reaches_the_nodes_by_the_channel() -> None:
    bench = Bench()
    with (
        bench.stack,
        PythonCanBus("virtual", bench.stack.channel, clock=monotonic_ns) as bus,
    ):

        def is_heard_by_all() -> bool:  # a node's first step hears what came just before it alone
            bus.send(Frame(0x202, b"\x01"))
            return all(0x202 in beacon.heard for beacon in bench.beacons.values())

        wait_until(is_heard_by_all)
        assert bus.receive(1_000_000_000)


def test_driver_presses_button_pedals_and_emergency_stop() -> None:
    bench = Bench()
    supervisor, throttle = bench.beacons["supervisor"], bench.beacons["throttle"]
    with bench.stack as stack:
        wait_until(lambda: supervisor.sensors is not None)
        stack.driver(button_pressed=True)
        wait_until(lambda: supervisor.sensors.button_pressed)
        wait_until(lambda: throttle.sensors is not None)
        stack.driver(throttle_pedal_ratio=0.5)
        wait_until(lambda: throttle.sensors.pedal_ratio > 0.4)
        assert supervisor.sensors.button_pressed  # what is not named stays
        stack.driver(button_pressed=False, emergency_stop_pressed=True)
        wait_until(lambda: supervisor.sensors.emergency_stop_pressed)
        wait_until(lambda: not supervisor.sensors.button_pressed)
        wait_until(lambda: bench.beacons["safety_monitor"].sensors.emergency_stop_pressed)


def test_button_is_released_after_it_was_pressed() -> None:
    bench = Bench()
    supervisor = bench.beacons["supervisor"]
    pressed: list[bool] = []
    original = supervisor.step

    def watch(now_ns: int, received: Sequence[ReceivedFrame], sensors: Any) -> StepOutput[Any]:
        pressed.append(sensors.button_pressed)
        return original(now_ns, received, sensors)

    supervisor.step = watch  # type: ignore[method-assign]
    with bench.stack as stack:
        stack.press_button()
        wait_until(lambda: True in pressed and not pressed[-1])


@pytest.mark.parametrize("wrong", [{"brake_pedal_ratio": 1.5}, {"steering_torque_nm": 101.0}])
def test_an_impossible_driver_is_refused_and_changes_nothing(wrong: dict[str, float]) -> None:
    bench = Bench()
    with bench.stack as stack:
        with pytest.raises(SignalRangeError, match=next(iter(wrong))):
            stack.driver(**wrong)  # type: ignore[arg-type]
        stack.driver(button_pressed=True)
        wait_until(lambda: getattr(bench.beacons["supervisor"].sensors, "button_pressed", False))


@pytest.mark.parametrize("way", ["kill", "freeze"])
def test_a_dead_node_is_silent_and_its_watchdog_acts(way: str) -> None:
    bench = Bench()
    beacon = bench.beacons["brake_servo"]
    with bench.stack as stack:
        wait_until(lambda: stack.truth().relay_closed and beacon.steps > 5)
        assert stack.truth().servo_position_ratio < 0.5
        getattr(stack, way)("brake_servo")
        wait_until(lambda: stack.truth().servo_position_ratio > 0.95)
        steps = beacon.steps
        others = [b for b in bench.beacons.values() if b is not beacon]
        goals = {b.name: b.steps + 5 for b in others}
        wait_until(lambda: all(b.steps >= goals[b.name] for b in others))
        assert beacon.steps == steps
    events = told(stack)
    assert [event.node for event in events] == ["BrakeServo"]
    assert ("killed" if way == "kill" else "frozen") in events[0].text


def test_a_node_that_raises_ends_alone_and_is_named() -> None:
    bench = Bench()
    with bench.stack as stack:
        wait_until(lambda: bench.beacons["steering"].steps > 3)
        bench.beacons["steering"].fails = True
        wait_until(lambda: "steering" in stack.results)
        goal = bench.beacons["throttle"].steps + 5
        wait_until(lambda: bench.beacons["throttle"].steps >= goal)
    assert stack.results["steering"].exit_code == 1
    assert "Steering ends: ZeroDivisionError: gain" in told(stack)[0].text


def test_a_dead_plant_is_a_cut_harness() -> None:
    bench = Bench()
    supervisor = bench.beacons["supervisor"]
    with bench.stack as stack:
        wait_until(lambda: bench.beacons["steering"].steps > 5)
        wait_until(
            lambda: supervisor.sensors is not None
            and not supervisor.sensors.emergency_stop_pressed
        )
        stack.kill("plant")
        wait_until(lambda: supervisor.sensors.emergency_stop_pressed)
        sensors = bench.beacons["throttle"].sensors
        wait_until(lambda: bench.beacons["throttle"].sensors is not sensors)
        pedal = bench.beacons["throttle"].sensors.pedal_ratio
        assert pedal != pedal


def test_unknown_names_are_refused() -> None:
    with pytest.raises(LaunchError, match="'gearbox' is not known: allowed steering"):
        InProcessStack(vehicle=VEHICLE, nodes=("gearbox",))
    bench = Bench(("steering", "supervisor"))
    with bench.stack as stack:
        with pytest.raises(LaunchError, match="'throttle' is not running: running plant, steering"):
            stack.kill("throttle")
        with pytest.raises(LaunchError, match="plant cannot be frozen"):
            stack.freeze("plant")


def test_killing_before_the_start_is_refused() -> None:
    with pytest.raises(LaunchError, match="has not been started"):
        Bench().stack.kill("steering")


def test_a_node_that_cannot_be_built_leaves_nothing_open() -> None:
    def build(name: str, vehicle: Vehicle) -> Beacon:
        if name == "supervisor":
            raise ValueError("no gain")
        return Beacon(name)

    before = set(threading.enumerate())
    stack = InProcessStack(vehicle=VEHICLE, channel=f"bench-{next(_numbers)}", build=build)
    with pytest.raises(ValueError, match="no gain"), stack:
        pass
    assert set(threading.enumerate()) == before
