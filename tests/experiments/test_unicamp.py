"""UNICAMP's car, the controllers that drive it, and the measures taken of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from canbus.drive_client import DriveTrouble
from experiments.chance import generator
from experiments.uah.tuning import Gains, Grid, candidates
from experiments.unicamp.circles import circle_radius_m, settling_s
from experiments.unicamp.corners import corners, radius_m_min
from experiments.unicamp.drive_bus import LEFT, STEER
from experiments.unicamp.drivers import OurDriver, PaperDriver, PaperGains
from experiments.unicamp.plant import BAJA, STEERING_GEAR_RATIO, UNICAMP_PLANT, Baja
from experiments.unicamp.profile import delay_s, profile_mps, steady_error_percent
from experiments.unicamp.tuning import (
    GRID,
    PAPER_GRID,
    TUNED,
    TUNED_PAPER,
    best,
    both_sides,
    curvature_error,
    ours,
    papers,
)
from experiments.unicamp.wire import RPM_PER_MPS, Driver, Known, ThreeDrives
from gateway.curvature_control import YawReading
from simulation.drives.motor import EC45, RE50

pytestmark = pytest.mark.whole_car


def car(**changes: object) -> Baja:
    return Baja(replace(UNICAMP_PLANT, **changes), generator(0, "test"))  # type: ignore[arg-type]


def put(car: Baja, told_deg: float, left_mps: float, right_mps: float) -> None:
    """Motors where and as fast as that takes, by the vehicle file; then 20 ms."""
    car.steering.angle_rad = math.radians(told_deg) * BAJA.steering.ratio * STEERING_GEAR_RATIO
    for motor, speed_mps in ((car.left, left_mps), (car.right, right_mps)):
        motor.speed_radps = speed_mps / BAJA.geometry.wheel_radius_m * BAJA.traction.gear_ratio
    for _ in range(4):
        car.advance(0.005)


def test_the_plant_of_the_circles_is_pinned() -> None:
    plant = UNICAMP_PLANT
    assert (STEERING_GEAR_RATIO, plant.linkage.transmission_ratio) == (20.0, 1.0)
    assert math.degrees(plant.linkage.play_rad) == pytest.approx(1.0)
    assert math.degrees(plant.linkage.dead_zone_rad) == pytest.approx(0.5)
    tyres = plant.tyres
    assert (tyres.rolling_ratio, tyres.friction_ratio) == (0.995, 0.8)
    assert (tyres.slip_stiffness_ratio, tyres.cornering_stiffness_ratio) == (3.0, 10.0)
    assert math.degrees(plant.imu.bias_radps) == pytest.approx(0.2)
    assert math.degrees(plant.imu.noise_radps) == pytest.approx(0.1)
    assert plant.imu.vibration_radps == 0.01
    assert (plant.imu.period_ns, plant.imu.latency_ns) == (10_000_000, 10_000_000)
    assert (plant.steering_motor, plant.wheel_motor, plant.mass_kg) == (EC45, RE50, 20.0)


def test_the_linkage_has_play_on_the_way_back_and_a_dead_zone_about_straight_ahead() -> None:
    baja, found = car(), []
    for told_deg in (1.4, 1.6, 6.0, 4.1, 3.0, -1.4, -6.0):
        put(baja, told_deg, 0.0, 0.0)
        found.append(math.degrees(baja.road_wheel_rad))
    assert found == pytest.approx([0.0, 0.1, 4.5, 4.5, 3.5, 0.0, -4.5], abs=1e-9)


def test_wheels_that_fit_the_angle_roll_without_slip_on_the_kinematic_circle() -> None:
    baja = car(linkage=replace(UNICAMP_PLANT.linkage, play_rad=0.0, dead_zone_rad=0.0))
    angle_deg = math.degrees(math.atan(BAJA.geometry.wheelbase_m / 1.6))
    put(baja, angle_deg, 0.35, 0.45)
    assert baja.yaw_rate_radps == pytest.approx(0.995 * 0.25)
    assert baja.speed_mps == pytest.approx(0.995 * 0.4)
    assert baja.left.load_torque_nm == pytest.approx(0.0, abs=1e-9)


def test_equal_wheels_push_the_car_out_of_its_circle_and_load_their_motors() -> None:
    baja = car(linkage=replace(UNICAMP_PLANT.linkage, play_rad=0.0, dead_zone_rad=0.0))
    angle_deg = math.degrees(math.atan(BAJA.geometry.wheelbase_m / 1.6))
    put(baja, angle_deg, 0.4, 0.4)
    assert 0.80 * 0.25 < baja.yaw_rate_radps < 0.97 * 0.25
    # to the left the left wheel drags the car back: its tyre drives the motor less than the road
    assert baja.left.load_torque_nm < -0.01 and baja.right.load_torque_nm > 0.01
    left_nm = baja.left.load_torque_nm
    put(baja, -angle_deg, 0.4, 0.4)
    assert baja.yaw_rate_radps < 0.0
    assert baja.right.load_torque_nm == pytest.approx(left_nm)


def test_tyres_are_in_balance() -> None:
    """Side forces and drive forces, by hand from the slips that the motion shows."""
    baja = car()
    put(baja, 15.0, 0.5, 0.4)
    base_m, track_m, angle = BAJA.geometry.wheelbase_m, BAJA.geometry.track_m, baja.road_wheel_rad
    before = (baja.x_m, baja.y_m, baja.heading_rad)
    baja.advance(1e-6)
    forward = (baja.x_m - before[0]) / 1e-6, (baja.y_m - before[1]) / 1e-6
    heading, rate, speed = before[2], baja.yaw_rate_radps, baja.speed_mps
    side = -math.sin(heading) * forward[0] + math.cos(heading) * forward[1]
    front = 10.0 * 2.0 * -(math.cos(angle) * (side + base_m * rate) - math.sin(angle) * speed)
    rear = 10.0 * 2.0 * -side
    left = 3.0 * (baja.wheel_mps(baja.left) - (speed - 0.5 * track_m * rate))
    right = 3.0 * (baja.wheel_mps(baja.right) - (speed + 0.5 * track_m * rate))
    assert left + right - math.sin(angle) * front == pytest.approx(0.0, abs=1e-6)
    assert rear + math.cos(angle) * front == pytest.approx(0.0, abs=1e-4)
    turning = 0.5 * track_m * (right - left) + base_m * math.cos(angle) * front
    assert turning == pytest.approx(0.0, abs=1e-6)


def test_the_imu_tells_the_truth_with_its_bias_after_its_latency() -> None:
    baja = car(imu=replace(UNICAMP_PLANT.imu, noise_radps=0.0, vibration_radps=0.0))
    assert baja.gyroscope.shown(0) is None
    baja.read_imu(0)
    baja.read_imu(10_000_000)
    assert baja.gyroscope.shown(9_999_999) is None
    reading = baja.gyroscope.shown(15_000_000)
    assert reading == YawReading(time_ns=0, yaw_rate_radps=math.radians(0.2))
    newest = baja.gyroscope.shown(20_000_000)
    assert newest is not None and newest.time_ns == 10_000_000


def test_the_papers_controller_is_fig_3() -> None:
    driver = PaperDriver(PaperGains(
        proportional_rad_m=0.2, integral_rad_m_per_s=0.3, derivative_rad_m_s=0.01,
    ))  # fmt: skip
    driver.speed_mps, driver.curvature_per_m = 0.4, 0.5

    def told(rate_radps: float) -> float:
        known = Known(now_ns=0, left_mps=0.0, right_mps=0.0,
                      yaw=YawReading(time_ns=0, yaw_rate_radps=rate_radps))  # fmt: skip
        targets = driver.decide(known)
        assert (targets.left_mps, targets.right_mps) == (0.4, 0.4)
        return targets.road_wheel_rad - math.atan(0.5 * 0.570)

    assert told(0.16) == pytest.approx(0.2 * 0.1 + 0.3 * 0.1 * 0.1 + 0.01 * 0.1 / 0.1)
    assert told(0.16) == pytest.approx(0.2 * 0.1 + 0.3 * 0.1 * 0.2)


def test_a_circle_is_found_from_its_points() -> None:
    angle = np.linspace(0.3, 4.0, 50)
    radius_m = circle_radius_m(5.0 + 1.6 * np.cos(angle), -2.0 + 1.6 * np.sin(angle))
    assert radius_m == pytest.approx(1.6)


def test_a_response_that_is_the_profile_late_has_that_delay_and_no_steady_error() -> None:
    time_s = np.arange(0.0, 13.0, 0.02)
    late = profile_mps(time_s - 0.117)
    assert delay_s(time_s, late) == pytest.approx(0.117)
    assert steady_error_percent(time_s, late) == pytest.approx(0.0, abs=1e-9)
    assert steady_error_percent(time_s, 1.02 * late) == pytest.approx(2.0)


def test_the_yaw_rate_has_settled_when_it_stays_within_a_tenth() -> None:
    car_run = both_sides(UNICAMP_PLANT, OurDriver(None))[1]
    time_s = car_run.time_s - car_run.time_s[0]
    rate = np.where(time_s < 1.0, 0.2, -0.2)
    made = replace(car_run, time_s=time_s, yaw_rate_radps=rate)
    assert settling_s(made, 0.0, -0.2) == pytest.approx(1.2, abs=0.03)  # 0.2 s of mean
    assert settling_s(made, 0.0, -0.5) == pytest.approx(time_s[-1])


def test_ours_keeps_the_circle_where_feed_forward_alone_does_not() -> None:
    blind = both_sides(UNICAMP_PLANT, OurDriver(None))
    seeing = both_sides(UNICAMP_PLANT, ours())
    for side, without, with_imu in zip((1.0, -1.0), blind, seeing, strict=True):
        late = with_imu.between(with_imu.time_s[-1] - 1.5, math.inf)
        radius_m = side * late.speed_mps.mean() / late.yaw_rate_radps.mean()
        assert radius_m == pytest.approx(2.0, rel=0.02)
        late = without.between(without.time_s[-1] - 1.5, math.inf)
        assert side * late.speed_mps.mean() / late.yaw_rate_radps.mean() > 2.0 * 1.08
    assert curvature_error(seeing) < 0.8 * curvature_error(blind)
    assert settling_s(seeing[1], seeing[1].time_s[0], -0.2) < 2.0


def test_the_drives_obey_over_the_bus_and_a_silent_one_is_noticed() -> None:
    driver = OurDriver(None)
    bench = ThreeDrives(UNICAMP_PLANT, driver, 0)
    driver.speed_mps, driver.curvature_per_m = 0.4, 0.5
    bench.run_for(1.5)
    units = bench.clients[STEER].position
    assert units == pytest.approx(math.atan(0.5 * 0.570) * 3.0 * 20.0 * 4096 / math.tau, abs=10)
    assert bench.clients[LEFT].velocity_rpm == pytest.approx(0.36 * RPM_PER_MPS, rel=0.01)
    assert all(client.trouble is None for client in bench.clients.values())
    bench.wire.filters.append(lambda _ns, sender, _frame, _receiver: sender != "drive 0x12")
    bench.run_for(0.2)
    assert bench.clients[LEFT].trouble is DriveTrouble.SILENT


def test_the_corners_change_one_thing_each_and_can_follow_the_circle_of_2_m() -> None:
    found = corners(UNICAMP_PLANT)
    assert len({corner.name for corner in found}) == len(found)
    assert [corner.plant == UNICAMP_PLANT for corner in found] == [True] + [False] * (
        len(found) - 1
    )
    assert all(radius_m_min(corner.plant) < 2.0 for corner in found)
    assert radius_m_min(UNICAMP_PLANT) < 1.6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("driver", "grid", "tuned"), [(ours, GRID, TUNED), (papers, PAPER_GRID, TUNED_PAPER)]
)
def test_no_neighbour_in_the_grid_is_better_than_the_tuned_gains_by_more_than_a_fiftieth(
    driver: Callable[[Gains], Driver], grid: Grid, tuned: Gains
) -> None:
    _, found = best(driver, candidates(grid, tuned))
    assert found[0]["error"] < 1.02 * min(one["error"] for one in found)
    assert found[0]["error"] < 0.98 * max(one["error"] for one in found)
