"""Steering column, brake servo and traction against values worked out by hand."""

from collections.abc import Callable
from math import degrees

import pytest

from simulation.plant.car import Car
from simulation.plant.params import TABBY_EVO
from simulation.plant.steering import SteeringColumn
from simulation.plant.traction import Traction

Drive = Callable[..., None]
STEERING = TABBY_EVO.steering


def test_brake_servo_travels_from_released_to_full_in_290_ms(car: Car, drive: Drive) -> None:
    drive(car, 0.28, brake=1.0)
    assert car.truth.servo_position_ratio == pytest.approx(0.28 / 0.29, abs=0.01)
    drive(car, 0.01, brake=1.0)
    assert car.truth.servo_position_ratio == 1.0


def test_slow_servo_takes_its_factor_longer(car: Car, drive: Drive) -> None:
    car.faults.servo_slow_factor = 3.0
    drive(car, 0.29, brake=1.0)
    assert car.truth.servo_position_ratio == pytest.approx(1.0 / 3.0, abs=0.01)


def test_stuck_servo_stays_and_dead_servo_returns(car: Car, drive: Drive) -> None:
    drive(car, 0.15, brake=1.0)
    position = car.truth.servo_position_ratio
    car.faults.servo_stuck = True
    drive(car, 0.5, brake=1.0)
    assert car.truth.servo_position_ratio == position
    car.faults.servo_stuck = False
    car.faults.servo_dead = True
    drive(car, 0.5, brake=1.0)
    assert car.truth.servo_position_ratio == 0.0


def test_servo_rests_within_its_dead_band_of_an_inner_setpoint(car: Car, drive: Drive) -> None:
    drive(car, 0.5, brake=0.5)
    error = abs(car.truth.servo_position_ratio - 0.5)
    assert 0.0 < error <= TABBY_EVO.brakes.servo_dead_band_ratio


def test_driver_brakes_further_than_the_servo_and_never_less(car: Car, drive: Drive) -> None:
    car.driver.brake_pedal_ratio = 0.7
    drive(car, 0.5, brake=0.4)
    assert car.truth.brake_ratio == 0.7
    car.driver.brake_pedal_ratio = 0.2
    drive(car, 0.5, brake=0.4)
    assert car.truth.brake_ratio == car.truth.servo_position_ratio > 0.39


def test_full_duty_reaches_the_loaded_free_speed_of_674_deg_per_s(car: Car, drive: Drive) -> None:
    drive(car, 2.0, throttle=0.3)
    drive(car, 0.70, duty=1.0)
    # 16 N m stall - 0.8 N m dry = (16 / 14 + 0.15) N m s/rad * 11.76 rad/s; the tyres' aligning
    # torque takes a little of it
    assert car.truth.speed_mps > STEERING.scrub_speed_mps
    assert 645.0 < degrees(car.truth.column_rate_radps) < 674.0


def test_standing_tyres_scrub_and_slow_the_wheel(car: Car, drive: Drive) -> None:
    drive(car, 0.70, duty=1.0)
    expected_radps = (16.0 - 0.8 - 2.5) / (16.0 / 14.0 + 0.15)
    assert car.truth.column_rate_radps == pytest.approx(expected_radps, rel=0.01)


def test_duty_acts_after_the_dead_time_and_an_open_output_at_once(car: Car, drive: Drive) -> None:
    drive(car, 0.020, duty=1.0)
    assert car.truth.column_rate_radps == 0.0
    drive(car, 0.010, duty=1.0)
    assert car.truth.column_rate_radps > 0.5
    # 3.3 N m of friction on 0.115 kg m2 stop it in far less than the motor's dead time
    car.faults.steering_motor_fault = True
    drive(car, 0.050, duty=1.0)
    assert car.truth.column_rate_radps == 0.0


def test_dead_motor_turns_nothing_and_reports_nothing(car: Car, drive: Drive) -> None:
    car.faults.steering_motor_dead = True
    drive(car, 0.5, duty=1.0)
    assert car.truth.column_angle_rad == 0.0
    assert not car.sense_steering(car.truth.time_ns).motor_fault


def test_column_stops_at_its_end_stops(car: Car, drive: Drive) -> None:
    for duty in (1.0, -1.0):
        drive(car, 3.0, duty=duty)
        assert car.truth.column_angle_rad == duty * STEERING.end_stop_rad
        assert car.truth.column_rate_radps == 0.0


def test_duty_from_before_an_open_output_never_acts_after_it() -> None:
    column = SteeringColumn(TABBY_EVO)
    for duty, powered in ((1.0, True), (1.0, False), (0.0, True)):
        for _ in range(9):  # the dead time is ten steps
            column.step(duty, powered, 0.0, 0.0, 0.0)
    assert column.rate_radps == pytest.approx(0.0)
    assert column.angle_rad < 0.05


def test_dry_friction_holds_the_column_against_a_small_torque(car: Car, drive: Drive) -> None:
    car.driver.steering_torque_nm = 3.2  # below 0.8 + 2.5 N m
    drive(car, 0.5, coast=True)
    assert car.truth.column_angle_rad == 0.0
    car.driver.steering_torque_nm = 3.5
    drive(car, 0.5, coast=True)
    assert car.truth.column_angle_rad > 0.1


def test_back_emf_brakes_a_closed_driver_and_not_an_open_one(
    make_car: Callable[..., Car], drive: Drive
) -> None:
    angles = []
    for coast in (False, True):
        car = make_car()
        car.driver.steering_torque_nm = 6.0
        drive(car, 0.3, coast=coast)
        angles.append(car.truth.column_angle_rad)
    assert angles[1] > 2.0 * angles[0] > 0.0


def test_aligning_torque_turns_a_released_column_back_in_a_curve(car: Car, drive: Drive) -> None:
    drive(car, 4.0, throttle=0.8)
    drive(car, 1.0, throttle=0.1, hold_angle_rad=4.0)
    assert car.truth.lateral_acceleration_mps2 > 2.0
    before_rad = car.truth.column_angle_rad
    drive(car, 1.0, throttle=0.1, coast=True)
    assert car.truth.column_angle_rad < before_rad - 0.3


def test_full_throttle_gives_the_motors_torque_through_the_gearbox(car: Car, drive: Drive) -> None:
    drive(car, 1.5, throttle=1.0)
    truth = car.truth
    assert truth.motor_torque_nm == pytest.approx(128.0, rel=0.001)
    # 128 N m * 5.8 * 0.94 / 0.284 m = 2457 N, less 121 N rolling and 6 N drag, on
    # 880 kg + 4.0 kg m2 / 0.284^2 m2 = 929.6 kg
    drag_n = 0.48 * truth.speed_mps**2
    expected = (2457.3 - 0.014 * 880.0 * 9.80665 - drag_n) / 929.6
    assert truth.longitudinal_acceleration_mps2 == pytest.approx(expected, rel=0.002)


def test_motor_power_never_exceeds_29_5_kw(car: Car, drive: Drive) -> None:
    drive(car, 9.0, throttle=1.0)
    truth = car.truth
    motor_radps = truth.speed_mps / 0.284 * 5.8
    assert motor_radps > 29_500.0 / 128.0
    assert truth.motor_torque_nm * motor_radps == pytest.approx(29_500.0, rel=0.03)


def test_motor_waits_for_its_dead_time(car: Car, drive: Drive) -> None:
    drive(car, 0.040, throttle=1.0)
    assert car.truth.motor_torque_nm == 0.0
    drive(car, 0.080, throttle=1.0)
    assert 0.5 * 128.0 < car.truth.motor_torque_nm < 0.75 * 128.0


def test_regeneration_brakes_with_60_nm_and_fades_out_below_5_kmh(car: Car, drive: Drive) -> None:
    drive(car, 4.0, throttle=0.5)
    drive(car, 1.0, regen=1.0)
    assert car.truth.speed_mps > 1.5
    assert car.truth.motor_torque_nm == pytest.approx(-60.0, rel=0.001)
    assert car.parts.traction.drive_nm == pytest.approx(0.0, abs=0.01)
    # the gearbox's losses brake too: 60 N m * 5.8 / 0.94 / 0.284 m = 1304 N, 121 N rolling
    drag_n = 0.48 * car.truth.speed_mps**2
    assert car.truth.longitudinal_acceleration_mps2 == pytest.approx(
        -(1303.6 + 120.8 + drag_n) / 929.6, rel=0.002
    )
    drive(car, 10.0, regen=1.0)
    assert car.truth.speed_mps == 0.0
    assert car.truth.motor_torque_nm == pytest.approx(0.0, abs=1e-9)


def test_idle_codes_give_no_torque_at_all(car: Car, drive: Drive) -> None:
    drive(car, 1.0)
    assert car.truth.motor_torque_nm == 0.0
    assert car.truth.distance_m == 0.0


def test_dead_traction_gives_no_torque(car: Car, drive: Drive) -> None:
    car.faults.traction_dead = True
    drive(car, 1.0, throttle=1.0)
    assert car.truth.speed_mps == 0.0


@pytest.mark.parametrize(
    ("drive_ratio", "regen_ratio", "wheel_speed_mps", "torque_nm"),
    [
        (1.0, 0.0, 28.0, 29_500.0 / (28.0 / 0.284 * 5.8)),
        (1.0, 0.0, 28.3, 0.0),  # 5500 rpm are 28.2 m/s
        (0.0, 1.0, 5.0, -60.0),
        (0.0, 1.0, 0.6945, -30.0),  # half of the fading speed
        (0.0, 1.0, -5.0, 60.0),  # it brakes backwards too
        (0.0, 1.0, 0.0, 0.0),
    ],
)
def test_settled_motor_torque(
    drive_ratio: float, regen_ratio: float, wheel_speed_mps: float, torque_nm: float
) -> None:
    traction = Traction(TABBY_EVO.traction, 2_000_000, 0.284)
    for _ in range(1000):
        force_n = traction.step(drive_ratio, regen_ratio, False, wheel_speed_mps)
    assert traction.torque_nm == pytest.approx(torque_nm, rel=0.001, abs=1e-9)
    efficiency = 0.94 if drive_ratio else 1.0 / 0.94
    assert force_n == pytest.approx(torque_nm * 5.8 * efficiency / 0.284, rel=0.001, abs=1e-6)
