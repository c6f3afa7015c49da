"""The throttle ECU backwards: its interlock, its limit, its contact."""

from __future__ import annotations

import math

import pytest

from dbc.messages import Mode
from ecus.throttle.ports import ThrottleActuator, dac_code
from tests.ecus.ecus_fakes import Rig, changed, tabby

RADIUS_M = tabby().geometry.wheel_radius_m
ZERO, FULL = dac_code(0.0), dac_code(1.0)
STANDING_STEPS = 40
"""400 ms, written a second time by hand."""


def moving(speed_mps: float, setpoint_mps: float, reverse_mps: float = 1.5) -> Rig:
    """Drives at a speed."""
    rig = Rig("Throttle", changed(tabby(), traction={"reverse_speed_mps_max": reverse_mps}))
    rig.speed_mps = speed_mps
    rig.rear_wheel_speed_radps = speed_mps / RADIUS_M
    rig.steps(30)
    rig.mode = Mode.READY
    rig.setpoint = setpoint_mps / RADIUS_M
    return rig.drive(setpoint_mps / RADIUS_M)


def reversing(speed_mps: float = -1.0) -> Rig:
    """Has turned round at standstill, and drives backwards."""
    rig = moving(0.0, speed_mps)
    rig.steps(STANDING_STEPS + 10)
    assert rig.output.actuator.reverse_selected
    rig.speed_mps, rig.rear_wheel_speed_radps = speed_mps, speed_mps / RADIUS_M
    rig.steps(150)
    return rig


def echo_mps(rig: Rig) -> float:
    value: float = rig.now_sent("STATUS")[0].applied_wheel_speed_radps * RADIUS_M
    return value


def test_the_drive_turns_round_when_the_car_has_stood_for_400_ms_and_not_before() -> None:
    rig = moving(0.0, 0.0)
    rig.steps(1)
    rig = moving(0.0, -1.0)  # stood before, but not as ACTIVE
    selected = [rig.step().reverse_selected for _ in range(STANDING_STEPS + 3)]
    assert not any(selected[: STANDING_STEPS - 5]) and selected[-1]
    assert echo_mps(rig) < 0.0 and rig.output.actuator.throttle_dac_code > ZERO


@pytest.mark.parametrize("speed_mps", [2.0, 0.2])
def test_a_car_that_rolls_forwards_slows_down_and_never_turns_round(speed_mps: float) -> None:
    rig = moving(speed_mps, -1.0)
    for _ in range(300):
        actuator = rig.step()
        assert not actuator.reverse_selected and actuator.throttle_dac_code == ZERO
    assert echo_mps(rig) == 0.0


@pytest.mark.parametrize("axle", ["front", "rear", "unknown"])
def test_both_axles_must_be_known_to_stand(axle: str) -> None:
    rig = moving(0.0, 0.0)
    if axle == "front":
        rig.speed_mps = 0.12
    elif axle == "rear":
        rig.rear_wheel_speed_radps = 0.12 / RADIUS_M
    else:
        rig.servo = None
    rig.steps(10)
    rig.setpoint = -1.0 / RADIUS_M
    rig.steps(100)
    assert not rig.output.actuator.reverse_selected


def test_backwards_too_it_stops_before_it_turns_round() -> None:
    rig = reversing()
    rig.setpoint = 2.0 / RADIUS_M
    for _ in range(200):
        assert rig.step().reverse_selected and echo_mps(rig) <= 0.0
    rig.speed_mps, rig.rear_wheel_speed_radps = 0.0, 0.0
    rig.steps(STANDING_STEPS + 40)
    assert not rig.output.actuator.reverse_selected and echo_mps(rig) > 0.0


def test_the_setpoint_is_cut_to_the_reverse_speed_of_the_vehicle() -> None:
    rig = reversing()
    rig.setpoint = -5.0 / RADIUS_M
    rig.steps(200)
    assert echo_mps(rig) == pytest.approx(-1.5, abs=0.01)


def test_a_vehicle_without_reverse_stands() -> None:
    rig = moving(0.0, -1.0, reverse_mps=0.0)
    rig.steps(100)
    actuator = rig.output.actuator
    assert not actuator.reverse_selected and actuator.throttle_dac_code == ZERO
    assert echo_mps(rig) == 0.0


def test_too_slow_backwards_drives_and_too_fast_regenerates() -> None:
    rig = reversing()
    rig.speed_mps = -0.5
    assert rig.steps(60).throttle_dac_code > ZERO
    rig.speed_mps = -1.6
    actuator = rig.steps(60)
    assert actuator.throttle_dac_code == ZERO and actuator.regen_dac_code > ZERO
    assert actuator.reverse_selected


def test_an_emergency_cuts_the_torque_and_leaves_the_contact_while_the_car_rolls() -> None:
    rig = reversing()
    rig.servo = 1.0
    actuator = rig.emergency().steps(5)
    assert actuator == ThrottleActuator(
        throttle_dac_code=ZERO, regen_dac_code=ZERO, reverse_selected=True
    )


def test_without_the_servo_it_brakes_backwards_with_all_regeneration() -> None:
    rig = reversing()
    actuator = rig.emergency().steps(60)
    assert actuator.regen_dac_code == FULL and actuator.reverse_selected
    rig.speed_mps = rig.rear_wheel_speed_radps = 0.0
    assert rig.steps(60).regen_dac_code == ZERO


def test_the_driver_gets_the_car_with_the_contact_open() -> None:
    rig = reversing()
    rig.mode, rig.is_authorised = Mode.MANUAL, False
    assert not rig.steps(3).reverse_selected


def test_stopping_backwards_goes_to_standstill_and_stays_in_its_direction() -> None:
    rig = reversing()
    rig.mode = Mode.STOPPING
    rig.steps(150)
    assert rig.output.actuator.reverse_selected and echo_mps(rig) == 0.0


def test_taking_over_a_car_that_rolls_backwards_does_not_reverse_the_drive() -> None:
    rig = moving(-0.4, -1.0)
    rig.steps(100)
    assert not rig.output.actuator.reverse_selected
    assert not math.isnan(echo_mps(rig))
