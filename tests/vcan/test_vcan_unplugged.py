"""A node unplugged: each one in a network namespace of its own, joined to the bus by cangw."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from canbus.node import EventKind
from dbc.endpoint import sent_by
from dbc.harness import SteeringActuatorWire, ThrottleActuatorWire
from dbc.messages import EmergencyBrake, ErrorCode, Mode
from ecus.throttle.ports import IDLE
from runtime.nodes import NODES
from tests.vcan.answers import is_missed
from tests.vcan.bus_log import HARNESS_BUS
from tests.vcan.namespaces import Namespaces
from tests.vcan.stack import PLANNER, VEHICLE, VEHICLE_BUS, Stack, pause
from vehicles import load_vehicle

APART = (*NODES, PLANNER)
ACTUATORS = ("steering", "throttle", "brake_servo")
HOLD_S_MAX = load_vehicle(VEHICLE).longest_stop_s
"""So long does a steering that is alone hold its angle: nobody tells it that the car stands."""


@pytest.fixture(scope="module")
def namespaces() -> Iterator[Namespaces]:
    with Namespaces(APART, (VEHICLE_BUS, HARNESS_BUS)) as namespaces:
        yield namespaces


@pytest.fixture(scope="module")
def module_stack(
    namespaces: Namespaces, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Stack]:
    with Stack(tmp_path_factory.mktemp("unplugged"), in_namespaces=APART) as stack:
        yield stack


def pids(stack: Stack) -> dict[str, int]:
    return {name: process.pid for name, process in stack.processes.items()}


def misses(stack: Stack, name: str, unplug: Callable[[str], None]) -> None:
    """The others brake in time, and say who is missing."""
    before_s = time.time()
    unplug(name)
    own = sent_by(NODES[name].node)
    line = stack.first_brake(before_s)
    since_s = max(
        sent.time_s for sent in stack.log(before_s - 0.1)
        if sent.can_id in own and sent.time_s < line.time_s
    )
    is_missed(stack, f"ER2: {name} unplugged, since its last frame", since_s, line)


def is_safe_alone(stack: Stack, name: str) -> None:
    """It knows what to do without the others; the car's true brake is what its servo does."""
    stack.event(name, "-> SAFE_ALONE")
    stack.event(name, f"{EventKind.CODE.value}: {ErrorCode.ER2.name}")
    stack.brakes()
    begin_s = time.time()
    if name == "steering":
        stack.sensed(
            begin_s, lambda wire: isinstance(wire, SteeringActuatorWire) and not wire.motor_enabled,
            HOLD_S_MAX,
        )
    if name == "throttle":
        stack.sensed(
            begin_s, lambda wire: isinstance(wire, ThrottleActuatorWire)
            and wire.throttle_dac_code == wire.regen_dac_code == IDLE.throttle_dac_code,
        )


def stays_where_it_is(stack: Stack) -> None:
    pause(0.5)
    assert stack.mode is not Mode.AUTOMATIC
    assert abs(stack.truth().speed_mps) < 0.01


def test_no_node_hears_itself_across_namespaces(driving: Stack) -> None:
    pause(0.5)
    assert driving.mode is Mode.AUTOMATIC
    for name in NODES:
        assert f"{EventKind.FOREIGN.value}:" not in driving.said(name)


@pytest.mark.parametrize("name", ["steering", "throttle", "supervisor", "safety_monitor"])
def test_a_node_unplugged_stops_the_car_and_plugged_in_again_does_not_start_it(
    name: str, driving: Stack, namespaces: Namespaces
) -> None:
    misses(driving, name, namespaces.cut)
    try:
        if name in ACTUATORS:
            is_safe_alone(driving, name)
        driving.brakes()
    finally:
        namespaces.mend(name)
    stays_where_it_is(driving)


def test_a_node_whose_controller_is_pulled_out_brakes_alone_and_is_rearmed_with_another(
    driving: Stack, namespaces: Namespaces
) -> None:
    before = pids(driving)
    misses(driving, "brake_servo", namespaces.pull_out)
    try:
        is_safe_alone(driving, "brake_servo")
    finally:
        namespaces.put_in("brake_servo")
    stays_where_it_is(driving)
    driving.recover()
    driving.drive()
    assert driving.mode is Mode.AUTOMATIC
    assert pids(driving) == before  # nothing was restarted


def test_a_planner_unplugged_stops_the_car(driving: Stack, namespaces: Namespaces) -> None:
    before_s = time.time()
    namespaces.cut(PLANNER)
    try:
        message = driving.first_brake(before_s).content
        assert isinstance(message, EmergencyBrake)
        assert message.code is ErrorCode.ER5
        driving.brakes()
    finally:
        namespaces.mend(PLANNER)
    stays_where_it_is(driving)
