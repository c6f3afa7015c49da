"""Watchdogs, relay and multiplexer: what works with every ECU's software stopped."""

from collections.abc import Callable

import numpy as np
import pytest

from ecus.brake_servo.ports import BrakeActuator
from ecus.steering.ports import SteeringActuator
from ecus.supervisor.ports import SupervisorActuator
from ecus.throttle.ports import ThrottleActuator
from simulation.plant.car import Car
from simulation.plant.hardware import Hardware
from simulation.plant.params import TABBY_EVO

Drive = Callable[..., None]
MS = 1_000_000
FULL_DUTY = SteeringActuator(motor_duty_ratio=1.0, motor_enabled=True)
FULL_THROTTLE = ThrottleActuator(throttle_dac_code=3686, regen_dac_code=410)
FULL_REGEN = ThrottleActuator(throttle_dac_code=410, regen_dac_code=3686)
NO_BRAKE = BrakeActuator(servo_position_ratio=0.0, servo_powered=True)
CLOSE = SupervisorActuator(automatic_relay_closed=True)
OPEN = SupervisorActuator(automatic_relay_closed=False)
LEAVE = SupervisorActuator(automatic_relay_closed=None)


def refreshed(relay: SupervisorActuator) -> Hardware:
    """All three commands given at time 0, all of them away from their safe values."""
    hardware = Hardware(TABBY_EVO, 0)
    hardware.switch_relay(0, relay, stuck=False)
    hardware.refresh_steering(0, FULL_DUTY)
    hardware.refresh_throttle(0, ThrottleActuator(throttle_dac_code=3686, regen_dac_code=3686))
    hardware.refresh_brake(0, BrakeActuator(servo_position_ratio=0.25, servo_powered=True))
    return hardware


def test_closed_relay_and_fed_watchdogs_pass_the_ecus_commands() -> None:
    hardware = refreshed(CLOSE)
    hardware.resolve(50 * MS - 1, driver_throttle_ratio=0.5)
    assert hardware.motor_powered
    assert hardware.duty_ratio == 1.0
    assert (hardware.drive_ratio, hardware.regen_ratio) == (1.0, 1.0)
    assert hardware.servo_powered
    assert hardware.servo_target_ratio == 0.25


def test_closed_relay_and_starved_watchdogs_open_motor_idle_dacs_and_full_brake() -> None:
    hardware = refreshed(CLOSE)
    hardware.resolve(50 * MS, driver_throttle_ratio=0.5)
    assert not hardware.motor_powered
    assert hardware.duty_ratio == 0.0
    assert (hardware.drive_ratio, hardware.regen_ratio) == (0.0, 0.0)
    assert hardware.servo_powered
    assert hardware.servo_target_ratio == 1.0


@pytest.mark.parametrize("now_ns", [0, 49 * MS, 51 * MS])
def test_open_relay_gives_the_driver_his_car_whatever_the_watchdogs(now_ns: int) -> None:
    hardware = refreshed(OPEN)
    hardware.resolve(now_ns, driver_throttle_ratio=0.5)
    assert not hardware.motor_powered
    assert hardware.drive_ratio == pytest.approx(0.5, abs=0.001)
    assert hardware.regen_ratio == 0.0
    assert not hardware.servo_powered


def test_each_watchdog_starves_alone() -> None:
    for survivor in ("steering", "throttle", "brake"):
        hardware = refreshed(CLOSE)
        if survivor == "steering":
            hardware.refresh_steering(40 * MS, FULL_DUTY)
        elif survivor == "throttle":
            hardware.refresh_throttle(40 * MS, FULL_THROTTLE)
        else:
            hardware.refresh_brake(40 * MS, NO_BRAKE)
        hardware.resolve(60 * MS, driver_throttle_ratio=0.0)
        assert hardware.motor_powered == (survivor == "steering")
        assert (hardware.drive_ratio == 1.0) == (survivor == "throttle")
        assert (hardware.servo_target_ratio == 0.0) == (survivor == "brake")


def test_watchdog_lets_go_at_the_next_refresh() -> None:
    hardware = refreshed(CLOSE)
    hardware.resolve(80 * MS, driver_throttle_ratio=0.0)
    assert hardware.servo_target_ratio == 1.0
    hardware.refresh_brake(90 * MS, NO_BRAKE)
    hardware.resolve(90 * MS, driver_throttle_ratio=0.0)
    assert hardware.servo_target_ratio == 0.0


def test_next_change_is_always_the_earliest_watchdog() -> None:
    hardware = refreshed(CLOSE)
    hardware.refresh_throttle(7 * MS, FULL_THROTTLE)
    hardware.refresh_steering(9 * MS, FULL_DUTY)
    hardware.resolve(10 * MS, driver_throttle_ratio=0.0)
    assert hardware.changes_at_ns == 50 * MS  # the brake's
    hardware.resolve(50 * MS, driver_throttle_ratio=0.0)
    assert hardware.changes_at_ns == 57 * MS
    hardware.resolve(57 * MS, driver_throttle_ratio=0.0)
    assert hardware.changes_at_ns == 59 * MS


def test_ecus_that_never_spoke_leave_a_car_in_automatic_with_full_brake(car: Car) -> None:
    car.advance(300 * MS)
    assert car.truth.servo_position_ratio == 1.0


def test_car_brakes_by_itself_50_ms_after_its_brake_ecu_died(car: Car, drive: Drive) -> None:
    drive(car, 0.1)
    dead_ns = car.truth.time_ns - 10 * MS  # its last refresh
    car.advance(dead_ns + 50 * MS)
    assert car.truth.servo_position_ratio == 0.0
    car.advance(dead_ns + 52 * MS)
    assert car.truth.servo_position_ratio > 0.0
    car.advance(dead_ns + 340 * MS)
    assert car.truth.servo_position_ratio == 1.0


def test_steering_motor_opens_50_ms_after_its_ecu_died(car: Car) -> None:
    car.actuate_steering(0, FULL_DUTY)
    car.advance(50 * MS)
    moving_radps = car.truth.column_rate_radps
    assert moving_radps > 2.0
    car.advance(54 * MS)
    assert car.truth.column_rate_radps < moving_radps
    car.advance(500 * MS)
    assert car.truth.column_rate_radps == 0.0


def test_drive_torque_ends_after_its_ecu_died(car: Car, drive: Drive) -> None:
    drive(car, 1.0, throttle=1.0)
    torque_nm = car.truth.motor_torque_nm
    # 40 ms since the last refresh remain, then the drive's own dead time of 40 ms and its lag
    car.advance(car.truth.time_ns + 78 * MS)
    assert car.truth.motor_torque_nm == pytest.approx(torque_nm, rel=0.001)
    car.advance(car.truth.time_ns + 400 * MS)
    assert car.truth.motor_torque_nm < 0.02 * torque_nm


def test_relay_latches_and_a_silent_supervisor_changes_nothing(car: Car) -> None:
    assert car.truth.relay_closed
    car.actuate_supervisor(10 * MS, LEAVE)
    car.advance(5_000 * MS)
    assert car.truth.relay_closed
    car.actuate_supervisor(5_000 * MS, OPEN)
    car.actuate_supervisor(5_010 * MS, LEAVE)
    assert not car.truth.relay_closed


def test_stuck_relay_does_not_move(car: Car) -> None:
    car.faults.relay_stuck = True
    car.actuate_supervisor(10 * MS, OPEN)
    assert car.truth.relay_closed


def test_car_powers_on_in_manual(make_car: Callable[..., Car], drive: Drive) -> None:
    car = make_car(automatic=False)
    assert not car.truth.relay_closed
    drive(car, 0.5, throttle=1.0, brake=1.0, duty=1.0)
    assert car.truth.speed_mps == 0.0
    assert car.truth.servo_position_ratio == 0.0
    assert car.truth.column_angle_rad == 0.0


def test_driver_drives_in_manual_with_pedals_and_wheel(make_car: Callable[..., Car]) -> None:
    car = make_car(automatic=False)
    car.driver.throttle_pedal_ratio = 0.5
    car.driver.steering_torque_nm = 4.0
    car.advance(1_500 * MS)
    assert car.truth.speed_mps > 1.0
    assert car.truth.column_angle_rad > 1.0
    car.driver.throttle_pedal_ratio = 0.0
    car.driver.brake_pedal_ratio = 1.0
    car.advance(3_500 * MS)
    assert car.truth.speed_mps == 0.0


def test_driver_throttle_reaches_the_drive_only_through_the_open_relay(
    car: Car, drive: Drive
) -> None:
    car.driver.throttle_pedal_ratio = 1.0
    drive(car, 0.5)
    assert car.truth.motor_torque_nm == 0.0
    car.actuate_supervisor(car.truth.time_ns, OPEN)
    drive(car, 0.5)
    assert car.truth.motor_torque_nm > 100.0


def test_opening_the_relay_releases_the_servo_by_its_spring(car: Car, drive: Drive) -> None:
    drive(car, 0.4, brake=1.0)
    car.actuate_supervisor(car.truth.time_ns, OPEN)
    drive(car, 0.125, brake=1.0)
    assert car.truth.servo_position_ratio == pytest.approx(0.5, abs=0.02)
    drive(car, 0.135, brake=1.0)
    assert car.truth.servo_position_ratio == 0.0


def test_regeneration_input_brakes_in_automatic_only(car: Car, drive: Drive) -> None:
    drive(car, 3.0, throttle=0.6)
    for now_ns in range(car.truth.time_ns, car.truth.time_ns + 400 * MS, 10 * MS):
        car.actuate_throttle(now_ns, FULL_REGEN)
        car.actuate_brake(now_ns, NO_BRAKE)
    assert car.truth.motor_torque_nm == pytest.approx(-60.0, rel=0.05)
    car.actuate_supervisor(car.truth.time_ns, OPEN)
    drive(car, 0.5, regen=1.0)
    assert abs(car.truth.motor_torque_nm) < 0.5


@pytest.mark.parametrize("code", [-1, 4096])
def test_dac_code_that_does_not_exist_is_the_ecus_bug(car: Car, code: int) -> None:
    with pytest.raises(AssertionError, match="DAC code"):
        car.actuate_throttle(0, ThrottleActuator(throttle_dac_code=code, regen_dac_code=410))


@pytest.mark.parametrize("ratio", [-0.01, 1.01, float("nan")])
def test_servo_setpoint_out_of_range_is_the_ecus_bug(car: Car, ratio: float) -> None:
    with pytest.raises(AssertionError, match="servo_position_ratio"):
        car.actuate_brake(0, BrakeActuator(servo_position_ratio=ratio, servo_powered=True))


@pytest.mark.parametrize("duty", [-1.01, 1.01, float("nan")])
def test_duty_out_of_range_is_the_ecus_bug(car: Car, duty: float) -> None:
    with pytest.raises(AssertionError, match="motor_duty_ratio"):
        car.actuate_steering(0, SteeringActuator(motor_duty_ratio=duty, motor_enabled=True))


REVERSE = ThrottleActuator(throttle_dac_code=2048, regen_dac_code=410, reverse_selected=True)


@pytest.mark.parametrize(
    ("relay", "now_ns", "is_reverse"), [(CLOSE, 0, True), (CLOSE, 50 * MS, False), (OPEN, 0, False)]
)
def test_the_reverse_contact_needs_a_closed_relay_and_a_fed_watchdog(
    relay: SupervisorActuator, now_ns: int, is_reverse: bool
) -> None:
    hardware = Hardware(TABBY_EVO, 0)
    hardware.switch_relay(0, relay, stuck=False)
    hardware.refresh_throttle(0, REVERSE)
    hardware.resolve(now_ns, driver_throttle_ratio=0.0)
    assert hardware.reverse_selected is is_reverse


@pytest.mark.parametrize(("stuck", "sign"), [(None, -1.0), (False, 1.0), (True, -1.0)])
def test_the_contact_says_which_way_the_motor_turns_unless_it_sticks(
    stuck: bool | None, sign: float
) -> None:
    car = Car(TABBY_EVO, np.random.default_rng(1))
    car.faults.reverse_contact_stuck = stuck
    car.actuate_supervisor(0, CLOSE)
    for now_ns in range(0, 1_000 * MS, 20 * MS):
        car.actuate_throttle(now_ns, REVERSE)
        car.actuate_brake(now_ns, NO_BRAKE)
    car.advance(1_000 * MS)
    assert sign * car.truth.speed_mps > 0.5 and sign * car.truth.motor_torque_nm > 10.0
