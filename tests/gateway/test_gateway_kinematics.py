"""Ackermann kinematics (UAH Eq. 9-14) against values worked by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gateway.kinematics import Kinematics
from vehicles import load_vehicle

TABBY = load_vehicle("tabby_evo")
KIN = Kinematics.of(TABBY.geometry, TABBY.steering)
RIGHT_ANGLE = Kinematics(wheelbase_m=1.0, track_m=1.0, wheel_radius_m=0.5, steering_ratio=2.0)


def test_straight_on_turns_nothing_and_the_wheel_rolls_at_the_cars_speed() -> None:
    assert KIN.steering_wheel_angle_rad(0.0) == 0.0
    assert KIN.wheel_angles_rad(0.0).left_rad == 0.0
    assert KIN.wheel_angles_rad(0.0).right_rad == 0.0
    assert KIN.wheel_speed_radps(2.87, 0.0) == pytest.approx(10.0)
    assert KIN.yaw_rate_radps(5.0, 0.0) == 0.0


def test_ten_metres_of_radius_is_the_whole_steering_wheel() -> None:
    # tan(9.25 rad / 40) = 0.235462; S = 2.360 m; R = 2.360 / 0.235462 = 10.023 m
    assert KIN.steering_wheel_angle_rad(1 / 10.0228) == pytest.approx(9.25, abs=1e-4)
    assert KIN.steering_wheel_angle_rad(0.1) == pytest.approx(40 * math.atan(0.236))


def test_road_wheel_at_45_degrees_when_the_radius_is_the_wheelbase() -> None:
    assert RIGHT_ANGLE.road_wheel_angle_rad(1.0) == pytest.approx(math.pi / 4)
    assert RIGHT_ANGLE.steering_wheel_angle_rad(1.0) == pytest.approx(math.pi / 2)
    # the front wheel runs on a circle of radius sqrt(2) m around the same centre
    assert RIGHT_ANGLE.wheel_speed_radps(1.0, 1.0) == pytest.approx(math.sqrt(2.0) / 0.5)


def test_left_turn_has_the_larger_angle_on_the_left() -> None:
    # R = 12 m: tan = 2.360 / (12 -+ 0.6575) = 0.208062 and 0.186448
    angles = KIN.wheel_angles_rad(1 / 12)
    assert angles.left_rad == pytest.approx(0.205138, abs=1e-5)
    assert angles.right_rad == pytest.approx(0.184333, abs=1e-5)
    assert angles.right_rad < KIN.road_wheel_angle_rad(1 / 12) < angles.left_rad


def test_right_turn_is_the_left_turns_mirror_image() -> None:
    left, right = KIN.wheel_angles_rad(1 / 12), KIN.wheel_angles_rad(-1 / 12)
    assert (right.left_rad, right.right_rad) == (-left.right_rad, -left.left_rad)
    assert KIN.steering_wheel_angle_rad(-0.1) == -KIN.steering_wheel_angle_rad(0.1)
    assert KIN.steering_wheel_angle_rad(-0.1) < 0
    assert KIN.wheel_speed_radps(3.0, -0.1) == KIN.wheel_speed_radps(3.0, 0.1)
    assert KIN.yaw_rate_radps(5.0, -0.1) == pytest.approx(-0.5)


def test_turn_about_a_point_under_the_axle_stays_finite() -> None:
    angles = RIGHT_ANGLE.wheel_angles_rad(2.0)  # centre of rotation behind the left wheel
    assert angles.left_rad == pytest.approx(math.pi / 2)
    assert angles.right_rad == pytest.approx(math.atan(2.0 / 2.0))


@pytest.mark.parametrize("curvature_per_m", [-0.0997, -0.05, 0.0, 0.01, 0.0997])
@pytest.mark.parametrize("speed_mps", [0.0, 0.3, 6.94])
def test_reported_state_is_the_inverse_of_the_command(
    speed_mps: float, curvature_per_m: float
) -> None:
    wheel_rad = KIN.steering_wheel_angle_rad(curvature_per_m)
    wheel_radps = KIN.wheel_speed_radps(speed_mps, curvature_per_m)
    assert KIN.curvature_per_m(wheel_rad) == pytest.approx(curvature_per_m)
    assert KIN.speed_mps(wheel_rad, wheel_radps) == pytest.approx(speed_mps)


def test_missing_reading_stays_missing() -> None:
    assert math.isnan(KIN.curvature_per_m(math.nan))
    assert math.isnan(KIN.speed_mps(math.nan, 1.0))
    assert math.isnan(KIN.speed_mps(0.0, math.nan))


def test_dimensions_come_from_the_vehicle_file_alone() -> None:
    small = Kinematics.of(
        replace(TABBY.geometry, wheelbase_m=0.5, track_m=0.4, wheel_radius_m=0.1),
        replace(TABBY.steering, ratio=1.0),
    )
    assert small.steering_wheel_angle_rad(2.0) == pytest.approx(math.pi / 4)
    assert small.wheel_speed_radps(1.0, 0.0) == pytest.approx(10.0)
