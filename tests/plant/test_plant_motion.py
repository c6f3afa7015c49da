"""The body: resistance, cornering, braking, standing still, energy, repeatability."""

from collections.abc import Callable
from dataclasses import replace
from math import atan, cos, hypot, pi, sin, tan

import pytest

from simulation.plant.car import Car
from simulation.plant.chassis import Chassis
from simulation.plant.params import GRAVITY_MPS2, TABBY_EVO, PlantParams, plant_params
from simulation.plant.state import Pose

pytestmark = pytest.mark.whole_car

Drive = Callable[..., None]
MakeCar = Callable[..., Car]
WHEELBASE_M = 2.360


def test_free_rolling_slows_by_drag_and_rolling_resistance(car: Car, drive: Drive) -> None:
    drive(car, 6.0, throttle=1.0)
    drive(car, 1.0)
    before = car.truth
    drive(car, 1.0)
    after = car.truth
    mean_mps = 0.5 * (before.speed_mps + after.speed_mps)
    # (121 N rolling + 0.5 * 1.2 * 0.8 * v^2) / 929.6 kg
    expected = (0.014 * 880.0 * GRAVITY_MPS2 + 0.48 * mean_mps**2) / 929.6
    assert before.speed_mps - after.speed_mps == pytest.approx(expected, rel=0.005)


def test_free_rolling_car_comes_to_rest_and_stays(car: Car, drive: Drive) -> None:
    drive(car, 1.0, throttle=0.5)
    drive(car, 20.0)
    rest = car.truth
    assert rest.speed_mps == 0.0
    drive(car, 5.0)
    assert car.truth.pose == rest.pose


@pytest.mark.parametrize("column_rad", [2.0, 6.0, -9.0])
def test_yaw_rate_at_low_speed_is_speed_times_curvature(
    car: Car, drive: Drive, column_rad: float
) -> None:
    drive(car, 2.0, throttle=0.40)
    drive(car, 3.0, throttle=0.055, hold_angle_rad=column_rad)
    truth = car.truth
    assert 1.0 < truth.speed_mps < 3.0
    curvature_per_m = tan(truth.column_angle_rad / 40.0) / WHEELBASE_M
    assert truth.yaw_rate_radps == pytest.approx(truth.speed_mps * curvature_per_m, rel=0.02)


def test_car_understeers_at_higher_lateral_acceleration(car: Car, drive: Drive) -> None:
    drive(car, 3.6, throttle=0.8)
    drive(car, 2.0, throttle=0.14, hold_angle_rad=5.0)
    truth = car.truth
    curvature_per_m = tan(truth.column_angle_rad / 40.0) / WHEELBASE_M
    gain = truth.yaw_rate_radps / (truth.speed_mps * curvature_per_m)
    assert truth.lateral_acceleration_mps2 > 2.5
    # m_front / C_front - m_rear / C_rear = 457.6 / 55000 - 422.4 / 62000 rad per m/s2
    expected = 1.0 / (1.0 + 0.001507 * truth.speed_mps**2 / WHEELBASE_M)
    assert gain == pytest.approx(expected, abs=0.006)


def test_radius_at_full_lock_is_ten_metres(car: Car, drive: Drive) -> None:
    drive(car, 1.5, throttle=0.4)
    drive(car, 3.0, throttle=0.052, hold_angle_rad=9.25)
    begin = car.truth
    drive(car, 1.0, throttle=0.052, hold_angle_rad=9.25)
    end = car.truth
    chord_m = hypot(end.pose.x_m - begin.pose.x_m, end.pose.y_m - begin.pose.y_m)
    turn_rad = end.pose.heading_rad - begin.pose.heading_rad
    assert chord_m / turn_rad == pytest.approx(10.0, rel=0.03)
    assert begin.lateral_acceleration_mps2 > 0.0


def test_positive_angle_turns_left(car: Car, drive: Drive) -> None:
    drive(car, 4.0, throttle=0.3, hold_angle_rad=5.0)
    assert car.truth.yaw_rate_radps > 0.0
    assert car.truth.pose.y_m > 0.5


def test_full_brake_decelerates_with_about_7_mps2_on_dry_road(car: Car, drive: Drive) -> None:
    drive(car, 4.0, throttle=0.8)
    drive(car, 0.6, brake=1.0)
    truth = car.truth
    assert truth.speed_mps > 1.0
    # (6160 N + 121 N + drag) / 929.6 kg, the rotating parts included
    assert truth.longitudinal_acceleration_mps2 == pytest.approx(-6.78, abs=0.05)
    assert not truth.front_wheels_locked
    assert not truth.rear_wheels_locked


def test_slippery_road_limits_braking_and_locks_the_wheels(car: Car, drive: Drive) -> None:
    drive(car, 4.0, throttle=0.8)
    car.faults.friction_mu = 0.3
    drive(car, 0.8, brake=1.0)
    truth = car.truth
    assert truth.speed_mps > 1.0
    assert -3.1 < truth.longitudinal_acceleration_mps2 < -2.6
    assert truth.front_wheels_locked
    assert truth.rear_wheels_locked
    wheel_count = car.sense_brake(truth.time_ns).wheel_count
    motor_count = car.sense_throttle(truth.time_ns).encoder_count
    drive(car, 0.1, brake=1.0)
    assert car.sense_brake(car.truth.time_ns).wheel_count == wheel_count
    assert car.sense_throttle(car.truth.time_ns).encoder_count == motor_count


def test_locked_wheels_turn_again_when_the_brake_is_released(car: Car, drive: Drive) -> None:
    drive(car, 4.0, throttle=0.8)
    car.faults.friction_mu = 0.3
    drive(car, 0.8, brake=1.0)
    drive(car, 0.5)
    assert not car.truth.front_wheels_locked
    begin = car.sense_throttle(car.truth.time_ns).encoder_count
    way_m = car.truth.distance_m
    drive(car, 0.5)
    edges = car.sense_throttle(car.truth.time_ns).encoder_count - begin
    expected = (car.truth.distance_m - way_m) * 64 * 5.8 / (2.0 * pi * 0.284)
    assert edges == pytest.approx(expected, rel=0.01)


def test_braking_on_ice_in_a_curve_leaves_little_side_force(
    make_car: MakeCar, drive: Drive
) -> None:
    yaw_rates = []
    for brake in (0.0, 1.0):
        car = make_car()
        drive(car, 3.0, throttle=0.8)
        car.faults.friction_mu = 0.25
        drive(car, 0.8, hold_angle_rad=6.0, brake=brake)
        assert car.truth.speed_mps > 2.0
        yaw_rates.append(car.truth.yaw_rate_radps / car.truth.speed_mps)
    assert 0.0 <= yaw_rates[1] < 0.6 * yaw_rates[0]


def test_lateral_acceleration_stays_within_grip(car: Car, drive: Drive) -> None:
    drive(car, 8.0, throttle=1.0)
    worst = 0.0
    for _ in range(100):
        drive(car, 0.02, hold_angle_rad=9.0)
        worst = max(worst, abs(car.truth.lateral_acceleration_mps2))
    assert 5.0 < worst < 0.9 * GRAVITY_MPS2


def test_brakes_hold_the_car_on_a_slope(car: Car, drive: Drive) -> None:
    car.faults.slope_rad = 0.10
    drive(car, 0.4, brake=1.0)
    start = car.truth.pose
    drive(car, 10.0, brake=1.0)
    assert car.truth.pose == start
    assert car.truth.longitudinal_acceleration_mps2 == 0.0


def test_car_rolls_backwards_when_released_on_a_slope(car: Car, drive: Drive) -> None:
    car.faults.slope_rad = 0.10
    drive(car, 2.0)
    truth = car.truth
    # (880 * 9.80665 * sin(0.1) - 121) N / 929.6 kg over two seconds
    assert truth.speed_mps == pytest.approx(-1.59, abs=0.02)
    assert truth.pose.x_m < -1.0


def test_brake_force_never_pushes_the_car_backwards(car: Car, drive: Drive) -> None:
    drive(car, 2.0, throttle=0.5)
    lowest = 1.0
    for _ in range(200):
        drive(car, 0.01, brake=1.0, regen=1.0)
        lowest = min(lowest, car.truth.speed_mps)
    assert lowest == 0.0
    rest = car.truth.pose
    drive(car, 1.0, brake=1.0, regen=1.0)
    assert car.truth.pose == rest


@pytest.mark.parametrize("column_rad", [0.0, 4.0, 9.0])
def test_coasting_never_gains_energy(car: Car, drive: Drive, column_rad: float) -> None:
    drive(car, 2.5, throttle=0.7)
    drive(car, 1.0, hold_angle_rad=column_rad)
    energy_j = car.truth.kinetic_energy_j
    for _ in range(800):
        drive(car, 0.02, hold_angle_rad=column_rad)
        now_j = car.truth.kinetic_energy_j
        assert now_j <= energy_j
        energy_j = now_j
    assert car.truth.speed_mps < 3.0


def test_more_people_make_the_car_slower(make_car: MakeCar, drive: Drive) -> None:
    speeds = []
    for people in (2, 4):
        car = make_car(params=TABBY_EVO.with_occupants(people))
        drive(car, 3.0, throttle=0.5)
        speeds.append(car.truth.speed_mps)
    assert speeds[1] / speeds[0] == pytest.approx(929.6 / 1079.6, rel=0.03)


def _manoeuvre(car: Car, drive: Drive) -> None:
    drive(car, 4.0, throttle=0.5)
    drive(car, 4.0, throttle=0.10, hold_angle_rad=5.0)
    drive(car, 4.0, throttle=0.10, hold_angle_rad=-4.0)
    drive(car, 4.0, regen=0.3, hold_angle_rad=2.0)
    drive(car, 4.0, throttle=0.2, hold_angle_rad=0.0)


def test_halving_the_step_changes_a_manoeuvre_of_20_s_little(
    make_car: MakeCar, drive: Drive
) -> None:
    ends = []
    for step_ns in (2_000_000, 1_000_000):
        car = make_car(params=replace(TABBY_EVO, step_ns=step_ns))
        _manoeuvre(car, drive)
        ends.append(car.truth)
    coarse, fine = ends
    assert coarse.distance_m > 60.0
    assert hypot(coarse.pose.x_m - fine.pose.x_m, coarse.pose.y_m - fine.pose.y_m) < 0.10
    assert abs(coarse.speed_mps - fine.speed_mps) < 0.01
    assert abs(coarse.pose.heading_rad - fine.pose.heading_rad) < 0.005


def test_same_seed_is_equal_to_the_bit_and_another_is_not(make_car: MakeCar, drive: Drive) -> None:
    readings = []
    truths = []
    for seed in (7, 7, 8):
        car = make_car(seed=seed)
        _manoeuvre(car, drive)
        now_ns = car.truth.time_ns
        truths.append(car.truth)
        readings.append(
            (car.sense_steering(now_ns), car.sense_throttle(now_ns), car.sense_brake(now_ns))
        )
    assert truths[0] == truths[1]
    assert readings[0] == readings[1]
    assert readings[0] != readings[2]


def test_pose_between_two_steps_is_interpolated(make_car: MakeCar, drive: Drive) -> None:
    start = Pose(x_m=5.0, y_m=-3.0, heading_rad=pi / 6.0)
    car = make_car(start_pose=start)
    assert car.pose == start
    drive(car, 3.0, throttle=0.8)
    begin = car.truth
    car.advance(begin.time_ns + 700_000)
    way_m = begin.speed_mps * 0.0007
    assert car.pose.x_m - begin.pose.x_m == pytest.approx(way_m * cos(pi / 6.0), rel=0.01)
    assert car.pose.y_m - begin.pose.y_m == pytest.approx(way_m * sin(pi / 6.0), rel=0.01)


def test_one_long_advance_equals_many_short_ones(make_car: MakeCar, drive: Drive) -> None:
    long, short = make_car(), make_car()
    for car in (long, short):
        drive(car, 2.0, throttle=0.5)
    end_ns = long.truth.time_ns + 400_000_000  # past the watchdogs of all actuators
    long.advance(end_ns)
    for now_ns in range(short.truth.time_ns, end_ns, 700_000):
        short.advance(now_ns)
    short.advance(end_ns)
    assert long.truth == short.truth
    assert long.truth.servo_position_ratio == 1.0


def test_front_axle_carries_its_share_of_the_side_force_rolling_and_slipping() -> None:
    for speed_mps in (0.8, 4.0):
        chassis = Chassis(TABBY_EVO)
        chassis.speed_mps = speed_mps
        for _ in range(200):
            chassis.step(0.1, 170.0, 0.0)
        expected_n = 0.52 * 880.0 * chassis.speed_mps * chassis.yaw_rate_radps
        assert chassis.front_axle_force_lateral_n == pytest.approx(expected_n, rel=0.06)


def test_time_that_runs_back_is_the_callers_bug(car: Car) -> None:
    car.advance(5_000_000)
    with pytest.raises(AssertionError, match="time runs back"):
        car.advance(4_000_000)


def test_unknown_vehicle_is_refused_with_the_known_names() -> None:
    with pytest.raises(ValueError, match=r"no plant named 'beetle'.*tabby_evo"):
        plant_params("beetle")


def test_tabby_evo_is_found_by_its_name() -> None:
    params: PlantParams = plant_params("tabby_evo")
    assert params is TABBY_EVO
    assert params.mass_kg == 880.0
    # +-9.25 rad of steering wheel at 40:1 is the paper's geometry: 10.0 m at the rear axle
    assert WHEELBASE_M / tan(9.25 / 40.0) == pytest.approx(10.0, abs=0.05)
    assert atan(WHEELBASE_M / 10.0) * 40.0 < params.steering.end_stop_rad
