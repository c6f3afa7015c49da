"""The supervisor through its steps: driver policy, restart, the latched emergency's reset."""

from __future__ import annotations

import pytest

from canbus.frame import Frame
from dbc.endpoint import FAILSAFE_ID
from dbc.messages import (
    EmergencyBrake,
    ErrorCode,
    Inhibit,
    Mode,
    NodeState,
    Reason,
    Request,
    Verdict,
)
from tests.ecus.ecus_fakes import changed, tabby
from tests.ecus.supervisor_fakes import Street
from vehicles import Vehicle
from vehicles.vehicle import DriverPolicy

ACTUATORS = ("Steering", "Throttle", "BrakeServo")
UWA = changed(
    tabby(),
    policy={
        "driver_steers_against": DriverPolicy.EMERGENCY,
        "driver_brakes_alone": DriverPolicy.EMERGENCY,
    },
)


# Driver policy -------------------------------------------------------------------------------


def _against(street: Street, torque_nm: float) -> Mode:
    street.wheel_angle_rad, street.applied_angle_rad = 0.0, 0.5
    street.torque_nm = torque_nm
    street.steps(4)
    street.nodes["Steering"].is_driver_active = True
    street.extra.append(street.driver_frame("Steering"))
    return street.step().mode


@pytest.mark.parametrize(
    ("vehicle", "torque_nm", "mode"),
    [
        (UWA, -3.0, Mode.EMERGENCY),
        (UWA, 3.0, Mode.MANUAL),
        (tabby(), -3.0, Mode.MANUAL),
    ],
    ids=["UWA against", "UWA along", "UAH against"],
)
def test_driver_who_steers_against_the_system(
    vehicle: Vehicle, torque_nm: float, mode: Mode
) -> None:
    street = Street(vehicle).automatic()
    assert _against(street, torque_nm) is mode
    reasons = {brake.reason for brake in street.brakes()}
    assert reasons == ({Reason.DRIVER_AGAINST_SYSTEM} if mode is Mode.EMERGENCY else set())


def test_steering_against_a_system_that_does_not_steer_is_no_emergency() -> None:
    street = Street(UWA).automatic()
    street.applied_angle_rad = float("nan")
    street.torque_nm = -3.0
    street.steps(4)
    street.nodes["Steering"].is_driver_active = True
    street.until(Mode.MANUAL, 2)


@pytest.mark.parametrize(
    ("vehicle", "applied", "mode"),
    [
        (UWA, 0.0, Mode.EMERGENCY),
        (UWA, float("nan"), Mode.EMERGENCY),
        (UWA, 0.3, Mode.MANUAL),
        (tabby(), 0.0, Mode.MANUAL),
    ],
    ids=["UWA alone", "UWA released", "UWA together", "UAH alone"],
)
def test_driver_who_brakes_while_the_system_does_not(
    vehicle: Vehicle, applied: float, mode: Mode
) -> None:
    street = Street(vehicle).automatic()
    street.applied_brake = applied
    street.steps(4)
    street.nodes["BrakeServo"].is_driver_active = True
    street.extra.append(street.driver_frame("BrakeServo"))
    assert street.step().mode is mode


def test_throttle_pedal_is_never_an_emergency() -> None:
    street = Street(UWA).automatic()
    street.nodes["Throttle"].is_driver_active = True
    street.until(Mode.MANUAL, 2)
    assert not street.brakes()


# Restart of the supervisor -------------------------------------------------------------------


@pytest.mark.parametrize("name", ACTUATORS)
@pytest.mark.parametrize("state", [NodeState.SAFE_ALONE, NodeState.EMERGENCY])
def test_restarted_supervisor_adopts_an_emergency_it_finds(name: str, state: NodeState) -> None:
    street = Street(booted=False)
    for node in street.nodes.values():
        node.is_obedient = False
    street.nodes[name].state = state
    street.until(Mode.EMERGENCY, 60)
    assert Mode.MANUAL not in street.modes
    (brake,) = street.brakes()
    assert (brake.code, brake.reason) == (ErrorCode.ER1, Reason.ADOPTED) and 1 in street.codes
    assert street.output.actuator.automatic_relay_closed is True
    street.steps(150)
    assert street.mode is Mode.EMERGENCY and 1 in street.codes


def test_restarted_supervisor_frees_nothing_while_a_node_still_drives() -> None:
    street = Street(booted=False)
    for node in street.nodes.values():
        node.state, node.is_obedient = NodeState.ACTIVE, False
    street.steps(100)
    assert set(street.modes) == {Mode.INIT}
    assert street.output.actuator.automatic_relay_closed is None
    street.nodes["BrakeServo"].state = NodeState.SAFE_ALONE
    street.until(Mode.EMERGENCY, 4)


def test_adopted_emergency_is_reset_by_the_button_without_any_request_ever() -> None:
    street = Street(booted=False)
    street.nodes["BrakeServo"].state = NodeState.SAFE_ALONE
    street.until(Mode.EMERGENCY, 60)
    street.steps(60)
    street.push()
    assert street.mode is Mode.MANUAL and street.shown.reset_epoch == 1


# Reset ---------------------------------------------------------------------------------------


def _reset(street: Street, how: str) -> None:
    if how == "button":
        street.push()
    else:
        street.ask(Request.RESET).steps(6)


@pytest.mark.parametrize("how", ["button", "request"])
def test_reset_at_standstill_with_all_causes_gone_gives_manual_and_raises_the_epoch(
    how: str,
) -> None:
    street = Street().emergency()
    assert street.shown.inhibit is Inhibit.CODE_LATCHED
    street.steps(40)
    _reset(street, how)
    assert street.mode is Mode.MANUAL and street.shown.reset_epoch == 1
    assert street.steps(10).reset_epoch == 1 and not street.codes
    assert street.output.actuator.automatic_relay_closed is False
    street.request = Request.NONE
    street.automatic()


@pytest.mark.parametrize("how", ["button", "request"])
@pytest.mark.parametrize(
    "what",
    ["MOVING", "EMERGENCY_STOP_PRESSED", "FAILSAFE", "MISSING_STEERING", "MISSING_THROTTLE",
     "MISSING_BRAKE_SERVO", "ER1", "ER2", "ER4", "ER6", "SPEED_UNKNOWN"],
)
def test_each_obstacle_to_a_reset_keeps_the_emergency_and_is_shown(what: str, how: str) -> None:
    street = Street().emergency()
    inhibit = Inhibit.NODE_UNHEALTHY
    if what == "MOVING":
        street.speed_mps, inhibit = 0.11, Inhibit.MOVING
    elif what == "SPEED_UNKNOWN":
        street.speed_mps, inhibit = float("nan"), Inhibit.MOVING
    elif what == "EMERGENCY_STOP_PRESSED":
        street.is_stop_pressed, inhibit = True, Inhibit.EMERGENCY_STOP_PRESSED
    elif what == "FAILSAFE":
        inhibit = Inhibit.EMERGENCY_STOP_PRESSED
    elif what.startswith("MISSING"):
        name = {"STEERING": "Steering", "THROTTLE": "Throttle", "BRAKE_SERVO": "BrakeServo"}
        street.nodes[name[what.removeprefix("MISSING_")]].is_silent = True
        inhibit = Inhibit[what]
    else:
        street.nodes["Throttle"].present = 1 << int(what[2])
    street.steps(40)
    if what == "FAILSAFE":
        street.extra.append(Frame(FAILSAFE_ID))
        street.step()
    assert street.shown.inhibit is inhibit
    _reset(street, how)
    assert street.mode is Mode.EMERGENCY and street.shown.reset_epoch == 0


@pytest.mark.parametrize("code", [0, 3, 5])
def test_codes_that_end_by_themselves_do_not_block_a_reset(code: int) -> None:
    street = Street().emergency()
    street.nodes["Throttle"].present = 1 << code
    street.steps(40)
    _reset(street, "button")
    assert street.mode is Mode.MANUAL


@pytest.mark.parametrize("name", ["SafetyMonitor", "Gateway"])
def test_leaving_to_manual_needs_neither_verdict_nor_gateway(name: str) -> None:
    street = Street().emergency()
    street.nodes[name].is_silent = True
    street.verdict = Verdict.DENY
    street.steps(40)
    _reset(street, "button")
    assert street.mode is Mode.MANUAL


def test_reset_needs_standstill_for_three_tenths_of_a_second() -> None:
    street = Street().emergency()
    street.speed_mps = 2.0
    street.steps(20)
    while street.speed_mps > 0.15:  # as fast as tyres can
        street.speed_mps -= 0.05
        street.step()
    street.speed_mps = 0.0
    street.steps(20)
    _reset(street, "button")
    assert street.mode is Mode.EMERGENCY
    street.steps(20)
    _reset(street, "button")
    assert street.ecu.mode is Mode.MANUAL


def test_reset_in_manual_unlatches_without_leaving() -> None:
    street = Street()
    street.steps(40)
    street.ask(Request.RESET).steps(20)
    assert set(street.modes) == {Mode.MANUAL} and street.shown.reset_epoch == 1


def test_reset_in_ready_unlatches_without_leaving() -> None:
    street = Street().ready()
    street.ask(Request.RESET).steps(20)
    assert street.mode is Mode.READY and street.shown.reset_epoch == 1


def test_reset_is_not_granted_to_a_car_that_drives_itself() -> None:
    street = Street().automatic()
    street.steps(40)
    street.ask(Request.RESET).steps(10)
    assert street.mode is Mode.AUTOMATIC and street.shown.reset_epoch == 0


def test_reset_epoch_counts_to_fifteen_and_begins_anew() -> None:
    street = Street()
    street.steps(40)
    epochs = []
    for _ in range(17):
        street.ask(Request.RESET).steps(4)
        epochs.append(street.shown.reset_epoch)
    assert epochs == [*range(1, 16), 0, 1]


def test_codes_stay_shown_until_the_reset_and_an_emcy_tells_both() -> None:
    street = Street().automatic()
    street.emergency_brake("Steering", EmergencyBrake(
        code=ErrorCode.ER6, reason=Reason.SENSOR_OUT_OF_BOUNDS, cause_age_ms=0, reset_epoch=0
    ))
    street.step()
    street.steps(200)
    assert street.codes == {1, 6}
    _reset(street, "button")
    assert street.mode is Mode.MANUAL and not street.codes
    emcys = [frame.data for frame in street.sent if frame.can_id == 0x081]
    assert [data[:2] for data in emcys] == [b"\x01\xff", b"\x00\x00"]
    assert emcys[0][3:6] == bytes([ErrorCode.ER1, Reason.BRAKING_IN_PROGRESS, 1 << 1])


def test_disengage_and_button_do_nothing_in_emergency() -> None:
    street = Street().emergency()
    street.speed_mps = 3.0
    street.ask(Request.DISENGAGE).steps(10)
    street.push()
    street.ask(Request.ENGAGE).steps(10)
    assert set(street.modes) == {Mode.EMERGENCY}
