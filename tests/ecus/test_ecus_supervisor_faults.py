"""The supervisor through its steps: every driving fault."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import pytest

from canbus.frame import Frame
from canbus.node import EventKind
from dbc.endpoint import Endpoint
from dbc.messages import (
    EmergencyBrake,
    ErrorCode,
    HeartbeatState,
    Mode,
    NodeState,
    Reason,
    Request,
    Verdict,
)
from tests.ecus.ecus_fakes import BUS_OFF, EMERGENCY_SENDERS, MS, changed, tabby
from tests.ecus.supervisor_fakes import NODES, Street
from vehicles.vehicle import DriverPolicy

ACTUATORS = ("Steering", "Throttle", "BrakeServo")
UWA = changed(
    tabby(),
    policy={
        "driver_steers_against": DriverPolicy.EMERGENCY,
        "driver_brakes_alone": DriverPolicy.EMERGENCY,
    },
)


def silence(name: str) -> Callable[[Street], None]:
    def act(street: Street) -> None:
        street.nodes[name].is_silent = True
        street.until(Mode.EMERGENCY, 12 if name == "Gateway" else 11)

    return act


def restart(name: str) -> Callable[[Street], None]:
    def act(street: Street) -> None:
        street.nodes[name].nmt = None
        street.step()

    return act


def nmt_stopped(name: str) -> Callable[[Street], None]:
    def act(street: Street) -> None:
        street.extra.append(Frame(0x700 + 2 + NODES.index(name), bytes([HeartbeatState.STOPPED])))
        street.step()

    return act


def safe_alone(name: str) -> Callable[[Street], None]:
    def act(street: Street) -> None:
        street.nodes[name].state = NodeState.SAFE_ALONE
        street.extra.append(street.driver_frame(name))
        street.step()

    return act


def verdict(value: Verdict) -> Callable[[Street], None]:
    def act(street: Street) -> None:
        street.verdict = value
        street.step()

    return act


def late(street: Street) -> None:
    street.step(span_ns=61 * MS)


def overruns(street: Street) -> None:
    for _ in range(3):
        street.step(span_ns=16 * MS)


def bus_off(street: Street) -> None:
    street.extra.append(BUS_OFF)
    street.step()


def foreign_sender(street: Street) -> None:
    twin = Endpoint("Supervisor", ())
    street.extra.append(twin.frame("SUPERVISOR_STATE", street.shown))
    street.step()


def requested(street: Street) -> None:
    street.ask(Request.EMERGENCY_STOP).until(Mode.EMERGENCY, 2)


FAULTS: dict[str, tuple[ErrorCode, Reason, Callable[[Street], None]]] = {
    **{
        f"{name} silent": (
            ErrorCode.ER2,
            Reason.VERDICT_MISSING if name == "SafetyMonitor" else Reason.NODE_SILENT,
            silence(name),
        )
        for name in NODES
    },
    **{
        f"{name} restarted": (
            ErrorCode.ER2,
            Reason.VERDICT_MISSING if name == "SafetyMonitor" else Reason.NODE_SILENT,
            restart(name),
        )
        for name in NODES
    },
    **{
        f"{name} stopped": (ErrorCode.ER2, Reason.NMT_COMMAND, nmt_stopped(name)) for name in NODES
    },
    **{
        f"{name} safe alone": (ErrorCode.ER1, Reason.NODE_EMERGENCY, safe_alone(name))
        for name in ACTUATORS
    },
    "verdict DENY": (ErrorCode.ER1, Reason.VERDICT_BRAKE, verdict(Verdict.DENY)),
    "verdict BRAKE": (ErrorCode.ER1, Reason.VERDICT_BRAKE, verdict(Verdict.BRAKE)),
    "late": (ErrorCode.ER2, Reason.LATE, late),
    "overruns": (ErrorCode.ER2, Reason.OVERRUNS, overruns),
    "bus-off": (ErrorCode.ER2, Reason.BUS_OFF, bus_off),
    "stranger with our identifier": (ErrorCode.ER1, Reason.FOREIGN_SENDER, foreign_sender),
    "requested": (ErrorCode.ER1, Reason.REQUESTED, requested),
}
ALL_FAULTS = [pytest.param(*values, id=name) for name, values in FAULTS.items()]


@pytest.mark.parametrize(("code", "reason", "act"), ALL_FAULTS)
@pytest.mark.parametrize("stop", [False, True], ids=["automatic", "stopping"])
def test_driving_fault_is_an_emergency_with_its_code_told_at_once_and_latched(
    code: ErrorCode, reason: Reason, act: Callable[[Street], None], stop: bool
) -> None:
    street = Street()
    street.speed_mps = 5.0
    street.automatic()
    if stop:
        street.push()
        street.steps(20)
        assert street.mode is Mode.STOPPING
        street.forget()
    act(street)
    state = street.shown
    assert state.mode is Mode.EMERGENCY and street.modes.count(Mode.EMERGENCY) == 1
    (brake,) = street.brakes()
    assert (brake.code, brake.reason) == (code, reason)
    assert brake.cause_age_ms <= 101
    assert {code, ErrorCode.ER1} <= street.codes  # ER1: braking is in progress
    assert state.brake_authorised and state.steering_authorised and not state.throttle_authorised
    assert street.output.actuator.automatic_relay_closed is True
    assert f"emergency brake: {code.name} {reason.name}" in street.logged(EventKind.CODE)
    for node in street.nodes.values():
        node.is_silent = False
    street.verdict = Verdict.PERMIT
    street.speed_mps, street.request = 0.0, Request.NONE
    street.steps(105)
    assert street.mode is Mode.EMERGENCY and {code, ErrorCode.ER1} <= street.codes
    assert len(street.brakes()) == 1


def _silent_node(street: Street, name: str) -> None:
    street.nodes[name].is_silent = True


@pytest.mark.parametrize(("code", "reason", "act"), ALL_FAULTS)
@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.READY])
def test_no_fault_brakes_before_the_car_drives_itself(
    code: ErrorCode, reason: Reason, act: Callable[[Street], None], mode: Mode
) -> None:
    street = Street()
    if mode is Mode.READY:
        street.ready()
    with suppress(AssertionError):  # some wait in vain for EMERGENCY
        act(street)
    street.steps(20)
    assert set(street.modes) == {mode} and not street.brakes()


@pytest.mark.parametrize("name", EMERGENCY_SENDERS)
def test_emergency_brake_of_any_node_is_passed_on_with_its_code_reason_and_age(name: str) -> None:
    if name == "Supervisor":
        return
    street = Street().automatic()
    message = EmergencyBrake(
        code=ErrorCode.ER4, reason=Reason.MOTOR_FAULT, cause_age_ms=7, reset_epoch=0
    )
    street.emergency_brake(name, message)
    state = street.step()
    (brake,) = street.brakes()
    assert state.mode is Mode.EMERGENCY
    assert (brake.code, brake.reason) == (ErrorCode.ER4, Reason.MOTOR_FAULT)
    assert brake.cause_age_ms == 8  # and 1 ms on its way
    assert 4 in street.codes


@pytest.mark.parametrize("name", [n for n in EMERGENCY_SENDERS if n != "Supervisor"])
@pytest.mark.parametrize("scene", ["boot", "ready"])
def test_emergency_brake_of_any_node_brakes_nobody_under_a_human(name: str, scene: str) -> None:
    street = Street()
    if scene == "ready":
        street.ready()
    for _ in range(20):
        street.emergency_brake(name)
        street.step()
    assert Mode.EMERGENCY not in street.modes and not street.brakes()


@pytest.mark.parametrize("name", NODES)
def test_node_silent_for_less_than_its_timeout_is_tolerated(name: str) -> None:
    street = Street().automatic()
    _silent_node(street, name)
    street.steps(4)
    street.nodes[name].is_silent = False
    street.steps(30)
    assert street.mode is Mode.AUTOMATIC


@pytest.mark.parametrize(
    ("name", "first_ms", "last_ms"),
    [("Steering", 60, 70), ("SafetyMonitor", 60, 70), ("Gateway", 100, 120)],
)
def test_silent_node_brakes_after_its_timeout(name: str, first_ms: int, last_ms: int) -> None:
    street = Street().automatic()
    _silent_node(street, name)
    steps = street.until(Mode.EMERGENCY, 15)
    (brake,) = street.brakes()
    assert first_ms <= brake.cause_age_ms <= last_ms and steps * 10 <= last_ms + 10


@pytest.mark.parametrize("name", ACTUATORS)
def test_actuator_not_active_100_ms_after_automatic_is_an_emergency(name: str) -> None:
    street = Street().ready()
    street.nodes[name].is_obedient = False
    street.ask(Request.ENGAGE).until(Mode.AUTOMATIC)
    street.request = Request.NONE
    street.steps(10)
    assert street.mode is Mode.AUTOMATIC
    street.step()
    assert street.ecu.mode is Mode.EMERGENCY
    assert street.brakes()[0].reason is Reason.NODE_EMERGENCY


def test_first_of_several_faults_is_told_and_all_are_latched() -> None:
    street = Street().automatic()
    street.emergency_brake("Throttle", EmergencyBrake(
        code=ErrorCode.ER5, reason=Reason.PLANNER_SILENT, cause_age_ms=90, reset_epoch=0
    ))
    street.verdict = Verdict.BRAKE
    street.nodes["Gateway"].nmt = HeartbeatState.STOPPED
    street.step()
    assert street.brakes()[0].reason is Reason.PLANNER_SILENT
    assert {1, 5} <= street.codes


def test_emergency_outranks_the_driver() -> None:
    street = Street().automatic()
    street.verdict = Verdict.BRAKE
    street.nodes["BrakeServo"].is_driver_active = True
    street.extra.append(street.driver_frame("BrakeServo"))
    assert street.step().mode is Mode.EMERGENCY
    street.steps(50)
    assert street.mode is Mode.EMERGENCY


def test_very_old_cause_saturates() -> None:
    street = Street().automatic()
    street.emergency_brake("Gateway", EmergencyBrake(
        code=ErrorCode.ER1, reason=Reason.REQUESTED, cause_age_ms=65_535, reset_epoch=0
    ))
    street.step()
    assert street.brakes()[0].cause_age_ms == 65_535
