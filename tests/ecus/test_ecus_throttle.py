"""The throttle ECU through its steps: following, stopping, no traction and regeneration."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from dbc.messages import ErrorCode, Mode, NodeState
from ecus.throttle.ports import DAC_CODE_MAX, IDLE, ThrottleActuator, dac_code
from tests.ecus.ecus_fakes import Rig, flags, tabby

RADIUS_M = tabby().geometry.wheel_radius_m
ZERO = dac_code(0.0)
FULL = dac_code(1.0)
FULL_REGEN = ThrottleActuator(throttle_dac_code=ZERO, regen_dac_code=FULL)
DUE_STEPS = 38
"""1.3 x the servo's 0.29 s is 377 ms: in the 38th step after the first it is due."""


def moving(speed_mps: float = 5.0, setpoint_mps: float | None = None) -> Rig:
    """Driving at a constant speed."""
    rig = Rig("Throttle")
    rig.speed_mps = speed_mps
    rig.steps(30)
    return rig.drive((speed_mps if setpoint_mps is None else setpoint_mps) / RADIUS_M)


def test_dac_codes_are_half_a_volt_to_four_and_a_half_of_12_bits() -> None:
    assert (ZERO, FULL, DAC_CODE_MAX) == (410, 3686, 4095)
    assert [dac_code(-1.0), dac_code(0.5), dac_code(2.0)] == [410, 2048, 3686]


def test_motor_drives_towards_a_higher_setpoint_and_regenerates_towards_a_lower() -> None:
    rig = moving(3.0, 7.0)
    actuator = rig.steps(50)
    assert actuator.throttle_dac_code > ZERO and actuator.regen_dac_code == ZERO
    rig.setpoint = 0.0
    actuator = rig.steps(150)
    assert actuator.throttle_dac_code == ZERO and actuator.regen_dac_code > ZERO


def test_taking_over_starts_from_the_measured_speed() -> None:
    rig = moving(5.0)
    echoes = [m.applied_wheel_speed_radps * RADIUS_M for m in rig.all_sent("STATUS")]
    assert all(echo == pytest.approx(5.0, abs=0.15) for echo in echoes)


def test_echo_obeys_the_acceleration_limit() -> None:
    rig = moving(3.0, 7.0)
    rig.steps(100)
    echoes = [m.applied_wheel_speed_radps * RADIUS_M for m in rig.all_sent("STATUS")]
    steps = [b - a for a, b in pairwise(echoes)]
    assert max(steps) <= 0.020 + 0.003
    assert echoes[-1] > 4.0


def test_setpoint_above_the_vehicles_speed_is_limited() -> None:
    rig = moving(7.0, 80.0)
    rig.steps(200)
    assert rig.now_sent("STATUS")[0].applied_wheel_speed_radps * RADIUS_M == pytest.approx(
        7.5, abs=0.01
    )


def test_setpoint_not_available_slows_down() -> None:
    rig = moving(5.0)
    rig.setpoint = math.nan
    rig.steps(50)
    assert rig.now_sent("STATUS")[0].applied_wheel_speed_radps * RADIUS_M < 4.2


def test_stopping_regenerates_whatever_the_planner_wants() -> None:
    rig = moving(5.0, 7.0)
    rig.mode = Mode.STOPPING
    actuator = rig.steps(100)
    assert actuator.throttle_dac_code == ZERO and actuator.regen_dac_code > ZERO


def test_no_drive_torque_against_the_brake_servo() -> None:
    rig = moving(3.0, 7.0)
    rig.servo = 0.06
    for _ in range(30):
        actuator = rig.step()
    assert actuator.throttle_dac_code == ZERO
    rig.servo = 0.05
    rig.steps(2)
    assert rig.output.actuator.throttle_dac_code > ZERO


@pytest.mark.parametrize("servo", [None, math.nan])
def test_no_drive_torque_while_the_servo_position_is_not_known(servo: float | None) -> None:
    rig = Rig("Throttle")
    rig.servo = servo
    rig.drive(20.0)
    rig.steps(8)
    assert rig.output.actuator.throttle_dac_code == ZERO


# Safe state ----------------------------------------------------------------------------------


def test_safe_state_has_no_traction_and_no_regeneration_while_the_servo_works() -> None:
    rig = moving(5.0, 7.0)
    rig.emergency()
    for count in range(100):
        rig.servo = min(count * 0.04, 1.0)
        assert rig.step() == IDLE


@pytest.mark.parametrize("servo", [0.0, 0.49, math.nan])
def test_servo_stuck_gets_its_travel_time_and_then_all_regeneration(servo: float) -> None:
    rig = moving(5.0)
    rig.servo = servo
    rig.emergency()
    for _ in range(DUE_STEPS):
        assert rig.step() == IDLE
    for _ in range(20):
        assert rig.step() == FULL_REGEN


def test_servo_at_half_its_travel_counts_as_braking() -> None:
    rig = moving(5.0)
    rig.servo = 0.5
    rig.emergency().steps(60)
    assert rig.output.actuator == IDLE


def test_servo_that_moves_after_all_ends_the_regeneration() -> None:
    rig = moving(5.0)
    rig.emergency().steps(60)
    assert rig.output.actuator == FULL_REGEN
    rig.servo = 0.9
    rig.steps(2)
    assert rig.output.actuator == IDLE


@pytest.mark.parametrize(("front_mps", "rear_mps"), [(-0.5, -0.5), (-0.5, 0.0), (0.0, -0.5)])
def test_a_car_that_stopped_uphill_without_a_servo_is_braked_when_it_rolls_back(
    front_mps: float, rear_mps: float
) -> None:
    rig = moving(5.0)
    rig.emergency().steps(60)
    rig.speed_mps = rig.rear_wheel_speed_radps = 0.0
    assert rig.steps(60) == IDLE
    rig.speed_mps = front_mps
    rig.rear_wheel_speed_radps = rear_mps / tabby().geometry.wheel_radius_m
    assert rig.steps(60) == FULL_REGEN


def test_missing_servo_is_replaced_by_regeneration_at_once() -> None:
    rig = moving(5.0)
    rig.servo = None
    rig.steps(6)
    rig.emergency().step()
    assert rig.output.actuator == FULL_REGEN


def test_servo_ecu_never_heard_counts_as_missing() -> None:
    rig = Rig("Throttle", started=False)
    rig.servo = None
    rig.speed_mps = 3.0
    rig.steps(30)
    rig.emergency().step()
    assert rig.state is NodeState.EMERGENCY and rig.output.actuator == FULL_REGEN


@pytest.mark.parametrize(
    ("speed_mps", "regenerates"), [(0.32, True), (0.28, False), (-0.28, False), (-0.32, True)]
)
def test_regeneration_ends_at_walking_pace(speed_mps: float, regenerates: bool) -> None:
    rig = moving(5.0)
    rig.servo = None
    rig.emergency().steps(10)
    rig.speed_mps = speed_mps
    rig.steps(60)
    assert rig.output.actuator == (FULL_REGEN if regenerates else IDLE)


@pytest.mark.parametrize(
    ("speed_mps", "rear_mps", "regenerates"),
    [(0.0, 3.0, True), (0.28, 0.32, True), (0.0, 0.28, False), (0.0, math.nan, False),
     (0.0, -3.0, True), (-2.0, 3.0, True)],
)
def test_regeneration_goes_on_while_one_axle_rolls(
    speed_mps: float, rear_mps: float, regenerates: bool
) -> None:
    rig = moving(5.0)
    rig.rear_wheel_speed_radps = rear_mps / RADIUS_M
    rig.speed_mps = speed_mps
    rig.emergency().steps(100)
    assert rig.output.actuator == (FULL_REGEN if regenerates else IDLE)


def test_a_rear_axle_that_is_no_longer_heard_does_not_roll() -> None:
    rig = moving(5.0)
    rig.rear_wheel_speed_radps = 3.0 / RADIUS_M
    rig.speed_mps = 0.0
    rig.emergency().steps(100)
    assert rig.output.actuator == FULL_REGEN
    rig.servo = None  # nor is its BRAKE_STATUS
    rig.steps(7)
    assert rig.output.actuator == IDLE


def test_bus_gone_entirely_ends_in_zero_traction_and_all_regeneration() -> None:
    rig = moving(5.0, 7.0)
    rig.mode = rig.servo = rig.age_ms = None
    rig.steps(6)
    assert rig.state is NodeState.SAFE_ALONE
    assert rig.output.actuator == FULL_REGEN


def test_travel_time_starts_anew_with_each_emergency() -> None:
    rig = moving(5.0)
    rig.emergency().steps(60)
    rig.mode, rig.is_authorised, rig.reset_epoch = Mode.MANUAL, False, 1
    assert rig.steps(5) == IDLE
    rig.drive(rig.setpoint)
    rig.emergency().steps(DUE_STEPS)
    assert rig.output.actuator == IDLE
    rig.step()
    assert rig.output.actuator == FULL_REGEN


# Sensors -------------------------------------------------------------------------------------


def test_status_tells_the_wheel_speed_and_no_echo_when_released() -> None:
    rig = Rig("Throttle")
    rig.speed_mps = 4.0
    rig.steps(50)
    status = rig.now_sent("STATUS")[0]
    assert status.wheel_speed_radps * RADIUS_M == pytest.approx(4.0, rel=0.01)
    assert math.isnan(status.applied_wheel_speed_radps)


def test_impossible_encoder_saturates_instead_of_breaking_the_frame() -> None:
    rig = Rig("Throttle")
    rig.speed_mps = 1e5
    rig.steps(5)
    assert rig.now_sent("STATUS")[0].wheel_speed_radps == 320.0


def test_broken_pedal_is_er1_and_not_available_but_no_driver() -> None:
    rig = Rig("Throttle")
    rig.sense(pedal_ratio=math.nan)
    rig.steps(10)
    driver = rig.all_sent("DRIVER")[-1]
    assert math.isnan(driver.pedal_ratio) and not driver.driver_active
    assert flags(driver) == {ErrorCode.ER1} and driver.present_codes == 1 << 1


@pytest.mark.parametrize("reading", [7.0, -0.5])
def test_a_pedal_out_of_bounds_is_not_available_and_no_driver(reading: float) -> None:
    rig = Rig("Throttle")
    rig.sense(pedal_ratio=reading)
    rig.steps(10)
    driver = rig.all_sent("DRIVER")[-1]
    assert math.isnan(driver.pedal_ratio) and not driver.driver_active
