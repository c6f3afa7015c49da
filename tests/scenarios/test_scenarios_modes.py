"""Modes, the driver, engaging and resetting, with all nodes and a car."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from canbus.frame import Frame
from dbc.messages import ErrorCode, Mode, NodeState, Request
from ecus.brake_servo.ecu import BrakeServoEcu
from tests.scenarios.driving import TABBY, Drive

pytestmark = pytest.mark.whole_car


def test_the_car_engages_drives_and_stops_on_request() -> None:
    drive = Drive().go(5.0, 0.02)
    drive.request(Request.DISENGAGE)
    assert drive.is_in(Mode.STOPPING)
    assert drive.run(6.0, until=lambda: drive.is_in(Mode.READY)), drive.log()
    assert abs(drive.speed) < 0.1
    assert not drive.emergencies


def test_the_button_stops_the_car_before_it_gives_ready() -> None:
    drive = Drive().go(5.0)
    drive.car.driver.button_pressed = True
    drive.run(0.1)
    drive.car.driver.button_pressed = False
    assert drive.is_in(Mode.STOPPING)
    assert drive.run(6.0, until=lambda: drive.is_in(Mode.READY))


def test_a_controlled_stop_goes_on_when_the_planner_leaves() -> None:
    drive = Drive().go(5.0)
    drive.request(Request.DISENGAGE, 0.1)
    drive.is_planner_silent = True
    assert drive.run(6.0, until=lambda: drive.is_in(Mode.READY)), drive.log()
    assert not drive.emergencies


@pytest.mark.parametrize(
    ("control", "value"),
    [
        ("steering_torque_nm", 6.0),
        ("steering_torque_nm", -6.0),
        ("throttle_pedal_ratio", 0.3),
        ("brake_pedal_ratio", 0.3),
    ],
)
def test_the_driver_wins_within_100_ms(control: str, value: float) -> None:
    drive = Drive().go(5.0)
    setattr(drive.car.driver, control, value)
    drive.run(0.1)
    assert drive.is_in(Mode.MANUAL), drive.log()
    assert not drive.car.truth.relay_closed
    drive.run(0.5)
    assert drive.brake < 0.05  # UAH: the driver has the car, nothing more
    assert not drive.emergencies


def test_a_touch_of_less_than_50_ms_is_no_take_over() -> None:
    drive = Drive().go(5.0)
    drive.car.driver.throttle_pedal_ratio = 0.3
    drive.run(0.04)
    drive.car.driver.throttle_pedal_ratio = 0.0
    drive.run(0.3)
    assert drive.is_in(Mode.AUTOMATIC)


def test_turning_the_wheel_hard_by_motor_is_not_taken_for_the_driver() -> None:
    drive = Drive().go(3.0)
    for curvature_per_m in (0.09, -0.09, 0.09):
        drive.curvature_per_m = curvature_per_m
        drive.run(1.5)
        assert drive.is_in(Mode.AUTOMATIC), drive.log()


def test_automatic_again_while_rolling_after_a_take_over() -> None:
    drive = Drive().go(5.0)
    drive.car.driver.steering_torque_nm = 6.0
    drive.run(0.2)
    drive.car.driver.steering_torque_nm = 0.0
    drive.run(1.0)
    assert drive.is_in(Mode.MANUAL)
    drive.press_button()
    drive.engage(0.2)
    assert drive.is_in(Mode.AUTOMATIC), drive.state.why_not_engaged
    drive.run(2.0)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert drive.speed == pytest.approx(5.0, abs=0.3)


def test_nobody_is_engaged_without_the_button() -> None:
    drive = Drive().start()
    drive.engage(0.5)
    assert drive.is_in(Mode.MANUAL)
    assert "button" in drive.state.why_not_engaged


def test_nobody_is_engaged_without_a_request() -> None:
    drive = Drive().start()
    drive.press_button()
    drive.run(1.0)
    assert drive.is_in(Mode.READY)
    assert drive.car.truth.motor_torque_nm == pytest.approx(0.0, abs=0.01)


def test_ready_ends_by_itself() -> None:
    drive = Drive().start()
    drive.press_button()
    drive.run(TABBY.times.ready_timeout_s + 0.5)
    assert drive.is_in(Mode.MANUAL)


def brake_under_the_driver(drive: Drive) -> None:
    assert drive.brake < 0.02, drive.log()
    assert not drive.car.truth.relay_closed


@pytest.mark.parametrize(
    "cause",
    [
        "steering_motor_fault", "angle", "emergency_stop", "failsafe", "Supervisor", "Steering",
        "Throttle", "BrakeServo", "SafetyMonitor", "Gateway", "silence", "emergency_request",
    ],
)
def test_nothing_brakes_under_a_driver_in_manual(cause: str) -> None:
    drive = Drive().start()
    drive.car.driver.throttle_pedal_ratio = 0.3
    drive.run(3.0)
    assert drive.speed > 1.0
    if cause == "steering_motor_fault":
        drive.car.faults.steering_motor_fault = True
    elif cause == "angle":
        drive.car.faults.steering_angle_override_rad = math.nan
    elif cause == "emergency_stop":
        drive.car.driver.emergency_stop_pressed = True
    elif cause == "failsafe":
        drive.world.inject(Frame(0x001))
    elif cause == "emergency_request":
        drive.request(Request.EMERGENCY_STOP)
    elif cause == "silence":
        drive.world.wire.filters.append(lambda *_: False)
    else:
        drive.stop_node(cause)
    for _ in range(20):
        drive.run(0.1)
        brake_under_the_driver(drive)
    assert drive.is_in(Mode.MANUAL)


def test_a_code_in_manual_denies_engagement_and_says_so() -> None:
    drive = Drive().start()
    drive.car.faults.steering_motor_fault = True
    drive.run(0.2)
    assert ErrorCode.ER4 in drive.codes
    drive.press_button()
    drive.engage(0.3)
    assert drive.is_in(Mode.READY)
    assert drive.state.why_not_engaged


def test_emergency_is_latched_until_reset_at_standstill_with_every_cause_gone() -> None:
    drive = Drive().go(5.0)
    drive.car.driver.emergency_stop_pressed = True
    drive.run(0.1)
    drive.request(Request.RESET)
    assert drive.is_in(Mode.EMERGENCY)  # moving
    assert drive.brakes_to_standstill()
    drive.run(0.5)
    drive.request(Request.RESET, 1.2)  # the request lapses after 1 s
    assert drive.is_in(Mode.EMERGENCY)  # still pressed
    drive.car.driver.emergency_stop_pressed = False
    drive.run(1.0)
    assert drive.is_in(Mode.EMERGENCY)  # nothing clears by itself
    epoch = drive.supervisor.reset_epoch
    drive.request(Request.RESET)
    assert drive.is_in(Mode.MANUAL), drive.log()
    assert drive.supervisor.reset_epoch == (epoch + 1) % 16
    drive.run(1.5)
    assert drive.codes == ()
    drive.press_button()
    drive.engage(0.2)
    assert drive.is_in(Mode.AUTOMATIC), drive.state.why_not_engaged


def test_the_driver_at_the_brake_does_not_end_an_emergency() -> None:
    drive = Drive().go(5.0)
    drive.request(Request.EMERGENCY_STOP, 0.05)
    drive.car.driver.brake_pedal_ratio = 1.0
    drive.car.driver.steering_torque_nm = 6.0
    drive.run(0.5)
    assert drive.is_in(Mode.EMERGENCY)
    assert drive.brake > 0.9
    assert drive.node_state("Steering") is NodeState.EMERGENCY
    steering = drive.world.stations["Steering"].node
    assert math.isnan(steering._status().applied_steering_wheel_angle_rad)  # the wheel is his


def test_a_node_with_another_configuration_is_never_authorised() -> None:
    drive = Drive()
    other = TABBY.text.replace("730 kg", "731 kg")
    assert other != TABBY.text
    station = drive.world.stations["BrakeServo"]
    station.node = BrakeServoEcu(replace(TABBY, text=other))
    drive.start()
    drive.press_button()
    drive.engage(0.5)
    assert drive.is_in(Mode.READY)
    assert "brake" in drive.state.why_not_engaged.lower()
    drive.run(1.0)
    assert drive.is_in(Mode.READY)
