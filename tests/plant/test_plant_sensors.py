"""Sensors: noise, quantisation, encoders' counts and the exact age of an edge."""

from collections.abc import Callable
from math import isnan, pi
from statistics import fmean, pstdev

import numpy as np
import pytest

from simulation.plant.car import Car
from simulation.plant.params import TABBY_EVO
from simulation.plant.sensors import Encoder, NoiseSource, quantise_ratio

Drive = Callable[..., None]
SENSORS = TABBY_EVO.sensors
STEP_NS = 2_000_000
MS = 1_000_000
MOTOR_EDGES_PER_M = 64 * 5.8 / (2.0 * pi * 0.284)
WHEEL_EDGES_PER_M = 360 / (2.0 * pi * 0.284)


def make_encoder(edges_per_m: float) -> Encoder:
    return Encoder(edges_per_m, STEP_NS, 1_000, 1_000_000_000, 0)


def roll(encoder: Encoder, speeds_mps: list[float], begin_ns: int = 0) -> int:
    """Steps through speeds at the ends of steps; returns the time of the last one."""
    for speed_mps in speeds_mps:
        encoder.step(begin_ns, speed_mps)
        begin_ns += STEP_NS
    return begin_ns


def assert_reading(reading: tuple[int, float], count: int, age_s: float) -> None:
    assert reading[0] == count
    assert reading[1] == pytest.approx(age_s, abs=2e-6)


def test_edge_age_is_exact_within_a_step() -> None:
    encoder = make_encoder(edges_per_m=100.0)
    # one step from 0 to 2 m/s, then steady: 200 edges/s, one each 5 ms; the phase starts at 0.5
    # and gains 0.2 in the first step, so the first edge comes (1 - 0.7) / 200 s = 1.5 ms later
    end_ns = roll(encoder, [2.0, 2.0, 2.0, 2.0])
    assert_reading(encoder.read(end_ns, False), 1, 0.0045)
    assert encoder.read(3_499_000, False)[0] == 0  # a reading before the edge does not see it


def test_edge_age_solves_for_a_speed_that_changes_within_the_step() -> None:
    encoder = make_encoder(edges_per_m=1000.0)
    # 0 to 1 m/s in 2 ms: phase = 0.5 + 250,000 t^2, an edge at sqrt(2) ms
    encoder.step(0, 1.0)
    assert_reading(encoder.read(STEP_NS, False), 1, 0.002 - 0.0014142)
    assert encoder.read(1_414_000, False)[0] == 0
    assert_reading(encoder.read(1_415_000, False), 1, 0.0)


def test_edge_age_solves_for_acceleration_backwards_too() -> None:
    encoder = make_encoder(edges_per_m=1000.0)
    encoder.step(0, -1.0)
    assert_reading(encoder.read(STEP_NS, False), -1, 0.002 - 0.0014142)


def test_encoder_counts_backwards_with_the_age_of_the_edge_passed() -> None:
    encoder = make_encoder(edges_per_m=100.0)
    end_ns = roll(encoder, [-2.0, -2.0, -2.0, -2.0])
    # 0.5 - 0.2 = 0.3 of a pulse is left after 2 ms: the edge at 0 comes 1.5 ms later
    assert_reading(encoder.read(end_ns, False), -1, 0.0045)


def test_edge_age_has_microseconds_and_saturates_at_one_second() -> None:
    encoder = make_encoder(edges_per_m=100.0)
    assert encoder.read(0, False) == (0, 1.0)
    end_ns = roll(encoder, [2.0, 2.0, 0.0])
    age_s = encoder.read(end_ns, False)[1]
    assert age_s * 1e6 == pytest.approx(round(age_s * 1e6), abs=1e-6)
    end_ns = roll(encoder, [0.0] * 1000, end_ns)
    assert encoder.read(end_ns, False) == (1, 1.0)


def test_speed_from_edges_is_exact_at_walking_pace() -> None:
    """Two edges and their times give the speed to better than a thousandth, counts do not."""
    encoder = make_encoder(MOTOR_EDGES_PER_M)
    end_ns = roll(encoder, [0.3] * 500)
    count, age_s = encoder.read(end_ns, False)
    later_ns = roll(encoder, [0.3] * 50, end_ns)
    later_count, later_age_s = encoder.read(later_ns, False)
    between_s = (later_ns - end_ns) / 1e9 - later_age_s + age_s
    speed_mps = (later_count - count) / MOTOR_EDGES_PER_M / between_s
    assert speed_mps == pytest.approx(0.3, rel=0.001)


def test_dead_encoder_stands_still_and_does_not_jump_when_it_returns() -> None:
    encoder = make_encoder(MOTOR_EDGES_PER_M)
    end_ns = roll(encoder, [5.0] * 100)
    count, age_s = encoder.read(end_ns, False)
    assert encoder.read(end_ns, True) == (count, age_s)
    end_ns = roll(encoder, [5.0] * 100, end_ns)
    assert_reading(encoder.read(end_ns, True), count, age_s + 0.2)
    assert encoder.read(end_ns, False)[0] == count
    end_ns = roll(encoder, [5.0] * 5, end_ns)
    assert encoder.read(end_ns, False)[0] - count == pytest.approx(
        0.05 * MOTOR_EDGES_PER_M, abs=1.0
    )


def test_motor_encoder_matches_the_way_straight_ahead(car: Car, drive: Drive) -> None:
    drive(car, 4.0, throttle=0.2)
    drive(car, 3.0)
    truth = car.truth
    count = car.sense_throttle(truth.time_ns).encoder_count
    # driven wheels slip by force / 90 kN: under half a per cent here
    assert count == pytest.approx(truth.distance_m * MOTOR_EDGES_PER_M, rel=0.006)
    wheel_count = car.sense_brake(truth.time_ns).wheel_count
    assert wheel_count == pytest.approx(truth.distance_m * WHEEL_EDGES_PER_M, abs=1.0)


def test_left_rear_wheel_goes_the_shorter_way_in_a_left_curve(car: Car, drive: Drive) -> None:
    drive(car, 4.0, throttle=0.3, hold_angle_rad=6.0)
    begin = car.truth
    count = car.sense_brake(begin.time_ns).wheel_count
    drive(car, 2.0, throttle=0.1, hold_angle_rad=6.0)
    end = car.truth
    edges = car.sense_brake(end.time_ns).wheel_count - count
    way_m = end.distance_m - begin.distance_m
    inner_m = way_m - 0.6575 * (end.pose.heading_rad - begin.pose.heading_rad)
    assert edges == pytest.approx(inner_m * WHEEL_EDGES_PER_M, rel=0.005)
    assert edges < 0.97 * way_m * WHEEL_EDGES_PER_M


def test_encoders_count_backwards_when_the_car_rolls_backwards(car: Car, drive: Drive) -> None:
    car.faults.slope_rad = 0.1
    drive(car, 2.0)
    now_ns = car.truth.time_ns
    assert car.sense_throttle(now_ns).encoder_count == pytest.approx(
        -car.truth.distance_m * MOTOR_EDGES_PER_M, abs=2.0
    )
    assert car.sense_brake(now_ns).wheel_count < -100


def test_dead_encoders_are_told_apart(car: Car, drive: Drive) -> None:
    drive(car, 2.0, throttle=0.5)
    now_ns = car.truth.time_ns
    car.faults.motor_encoder_dead = True
    motor = car.sense_throttle(now_ns).encoder_count
    wheel = car.sense_brake(now_ns).wheel_count
    drive(car, 0.5, throttle=0.5)
    now_ns = car.truth.time_ns
    assert car.sense_throttle(now_ns).encoder_count == motor
    assert car.sense_throttle(now_ns).encoder_edge_age_s >= 0.5
    assert car.sense_brake(now_ns).wheel_count > wheel


def test_column_angle_has_the_stated_noise_zero_and_resolution(car: Car) -> None:
    readings = [car.sense_steering(k * MS).column_angle_rad for k in range(2000)]
    assert fmean(readings) == pytest.approx(SENSORS.column_angle_zero_rad, abs=2e-4)
    assert pstdev(readings) == pytest.approx(SENSORS.column_angle_noise_rad, rel=0.1)
    for reading in readings:
        steps = reading / SENSORS.column_angle_step_rad
        assert steps == pytest.approx(round(steps), abs=1e-6)


def test_column_angle_between_two_steps_is_interpolated(car: Car, drive: Drive) -> None:
    drive(car, 0.4, duty=1.0)
    begin = car.truth
    expected = begin.column_angle_rad + SENSORS.column_angle_zero_rad
    reading = car.sense_steering(begin.time_ns + 100_000).column_angle_rad
    # 2 ms at this rate are 20 mrad, 0.1 ms only 1 mrad; noise is 1.5 mrad
    assert begin.column_rate_radps > 8.0
    assert reading == pytest.approx(expected, abs=0.007)


def test_unreadable_stuck_and_overridden_angle(car: Car, drive: Drive) -> None:
    drive(car, 0.3, duty=0.5)
    now_ns = car.truth.time_ns
    reading = car.sense_steering(now_ns).column_angle_rad
    car.faults.steering_angle_stuck = True
    drive(car, 0.3, duty=0.5)
    now_ns = car.truth.time_ns
    assert car.sense_steering(now_ns).column_angle_rad == reading
    car.faults.steering_angle_override_rad = float("nan")
    assert isnan(car.sense_steering(now_ns).column_angle_rad)
    car.faults.steering_angle_override_rad = 12.0
    assert car.sense_steering(now_ns).column_angle_rad == 12.0
    car.faults.steering_angle_override_rad = None
    car.faults.steering_angle_stuck = False
    assert car.sense_steering(now_ns).column_angle_rad > reading + 0.1


def test_torque_sensor_reads_the_driver_on_a_still_wheel(car: Car, drive: Drive) -> None:
    car.driver.steering_torque_nm = 2.0
    drive(car, 0.2)
    readings = [car.sense_steering(200 * MS).driver_torque_nm for _ in range(500)]
    assert fmean(readings) == pytest.approx(2.0 + SENSORS.torque_zero_nm, abs=0.01)
    assert pstdev(readings) == pytest.approx(SENSORS.torque_noise_nm, rel=0.1)


def test_torque_sensor_reads_the_hand_wheels_inertia_against_the_motor(
    car: Car, drive: Drive
) -> None:
    drive(car, 0.06, duty=1.0)
    begin = car.truth
    drive(car, 0.01, duty=1.0)
    acceleration = (car.truth.column_rate_radps - begin.column_rate_radps) / 0.01
    reading = car.sense_steering(car.truth.time_ns).driver_torque_nm
    assert acceleration > 30.0
    # 0.03 kg m2 held back by nobody's hands, seen through a 10 ms filter
    assert reading == pytest.approx(-0.03 * acceleration, rel=0.25)
    assert reading < -1.0


def test_torque_sensor_clips_at_its_range_and_can_be_overridden(car: Car) -> None:
    car.driver.steering_torque_nm = 40.0
    assert car.sense_steering(0).driver_torque_nm == SENSORS.torque_nm_max
    car.faults.steering_torque_override_nm = -3.0
    assert car.sense_steering(0).driver_torque_nm == -3.0


def test_motor_fault_line_is_reported(car: Car) -> None:
    assert not car.sense_steering(0).motor_fault
    car.faults.steering_motor_fault = True
    assert car.sense_steering(0).motor_fault


def test_brake_pedal_is_moved_by_the_servo_too(car: Car, drive: Drive) -> None:
    drive(car, 0.4, brake=0.6)
    now_ns = car.truth.time_ns
    reading = car.sense_brake(now_ns)
    assert reading.pedal_ratio == pytest.approx(0.6, abs=0.02)
    assert reading.servo_position_ratio == pytest.approx(0.6, abs=0.02)
    car.driver.brake_pedal_ratio = 0.9
    drive(car, 0.1, brake=0.6)
    reading = car.sense_brake(car.truth.time_ns)
    assert reading.pedal_ratio == pytest.approx(0.9, abs=0.01)
    assert reading.servo_position_ratio == pytest.approx(0.6, abs=0.02)


def test_pedals_are_quantised_and_can_be_overridden(car: Car) -> None:
    car.driver.throttle_pedal_ratio = 0.4
    ratio = car.sense_throttle(0).pedal_ratio
    assert ratio == pytest.approx(0.4, abs=0.006)
    assert ratio * 1023 == pytest.approx(round(ratio * 1023), abs=1e-9)
    car.faults.throttle_pedal_override_ratio = 0.7
    car.faults.brake_pedal_override_ratio = 0.8
    car.faults.servo_position_override_ratio = 0.1
    assert car.sense_throttle(0).pedal_ratio == 0.7
    assert car.sense_brake(0).pedal_ratio == 0.8
    assert car.sense_brake(0).servo_position_ratio == 0.1


def test_panel_inputs_reach_the_supervisor(car: Car) -> None:
    reading = car.sense_supervisor(0)
    assert (reading.button_pressed, reading.emergency_stop_pressed) == (False, False)
    car.driver.button_pressed = True
    car.driver.emergency_stop_pressed = True
    reading = car.sense_supervisor(0)
    assert (reading.button_pressed, reading.emergency_stop_pressed) == (True, True)


def test_quantised_ratio_stays_within_its_range() -> None:
    assert quantise_ratio(-0.2, 1023) == 0.0
    assert quantise_ratio(1.2, 1023) == 1.0
    assert quantise_ratio(0.5004, 10) == 0.5


def test_a_silent_ecu_does_not_change_another_ones_noise(make_car: Callable[..., Car]) -> None:
    talking, alone = make_car(), make_car()
    for k in range(50):
        talking.sense_steering(k * MS)
    assert talking.sense_brake(50 * MS) == alone.sense_brake(50 * MS)


def test_noise_is_the_generators_own() -> None:
    source = NoiseSource(np.random.default_rng(3))
    drawn = [source.draw() for _ in range(1500)]
    assert drawn[:1024] == np.random.default_rng(3).standard_normal(1024).tolist()[::-1]
    assert len(set(drawn)) == 1500
