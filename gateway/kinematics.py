"""Ackermann kinematics of a car that steers and drives with its front wheels, and the way back.

Equations of UAH (Arango et al., Sensors 2020, Section 4.6). Speed and curvature belong to the
centre of the rear axle; positive curvature and angles turn left. NaN goes in and comes out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from vehicles.vehicle import Geometry, Steering


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelAngles:
    """Angles of the two steered wheels; the wheel inside the turn has the larger one."""

    left_rad: float
    right_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSpeeds:
    """Speeds of the two rear wheels over ground; the wheel outside the turn is the faster one."""

    left_mps: float
    right_mps: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Kinematics:
    """The dimensions that turn speed and curvature into wheel motion; no car is assumed."""

    wheelbase_m: float
    track_m: float
    wheel_radius_m: float
    steering_ratio: float

    @classmethod
    def of(cls, geometry: Geometry, steering: Steering) -> Self:
        """The kinematics of one vehicle file."""
        return cls(
            wheelbase_m=geometry.wheelbase_m,
            track_m=geometry.track_m,
            wheel_radius_m=geometry.wheel_radius_m,
            steering_ratio=steering.ratio,
        )

    def yaw_rate_radps(self, speed_mps: float, curvature_per_m: float) -> float:
        """Yaw rate (UAH Eq. 9)."""
        return speed_mps * curvature_per_m

    def road_wheel_angle_rad(self, curvature_per_m: float) -> float:
        """Angle of the imagined wheel in the middle of the front axle (UAH Eq. 10)."""
        return math.atan(curvature_per_m * self.wheelbase_m)

    def wheel_angles_rad(self, curvature_per_m: float) -> WheelAngles:
        """Angles of the real front wheels, which share one centre of rotation (UAH Eq. 11, 12).

        Written with the curvature in place of its inverse, so that straight on is no exception.
        """
        rise = curvature_per_m * self.wheelbase_m
        half = curvature_per_m * self.track_m / 2.0
        return WheelAngles(
            left_rad=math.atan2(rise, 1.0 - half), right_rad=math.atan2(rise, 1.0 + half)
        )

    def steering_wheel_angle_rad(self, curvature_per_m: float) -> float:
        """Angle of the steering wheel (UAH Eq. 13)."""
        return self.steering_ratio * self.road_wheel_angle_rad(curvature_per_m)

    def wheel_speed_radps(self, speed_mps: float, curvature_per_m: float) -> float:
        """Speed of the driven front wheels (UAH Eq. 14)."""
        road_wheel_rad = self.road_wheel_angle_rad(curvature_per_m)
        return speed_mps / (math.cos(road_wheel_rad) * self.wheel_radius_m)

    def rear_wheel_speeds_mps(self, speed_mps: float, curvature_per_m: float) -> WheelSpeeds:
        """Electronic differential: both rear wheels roll about the front ones' centre.

        A centre between the wheels makes the inner one's speed negative: it turns backwards.
        """
        half = curvature_per_m * self.track_m / 2.0
        return WheelSpeeds(left_mps=speed_mps * (1.0 - half), right_mps=speed_mps * (1.0 + half))

    def curvature_of_road_wheel_per_m(self, road_wheel_rad: float) -> float:
        """Curvature from the angle of the imagined front wheel: Eq. 10 solved for it."""
        return math.tan(road_wheel_rad) / self.wheelbase_m

    def curvature_per_m(self, steering_wheel_angle_rad: float) -> float:
        """Curvature from a steering-wheel angle: Eq. 13 solved for it."""
        return self.curvature_of_road_wheel_per_m(steering_wheel_angle_rad / self.steering_ratio)

    def speed_mps(self, steering_wheel_angle_rad: float, wheel_speed_radps: float) -> float:
        """Speed from a steering-wheel angle and a front wheel's speed: Eq. 14 solved for it."""
        road_wheel_rad = steering_wheel_angle_rad / self.steering_ratio
        return wheel_speed_radps * math.cos(road_wheel_rad) * self.wheel_radius_m
