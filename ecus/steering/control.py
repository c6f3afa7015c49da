"""The steering loop: a profiled reference, feed-forward of its rate, position and rate feedback.

Unlike UAH's 10 Hz PI (Eq. 4-8) the reference itself obeys the rate and acceleration limits, so the
loop never saturates on a step and the integrator has nothing to wind up on.
"""

from __future__ import annotations

import math
from typing import Final

from ecus.common.limits import clamp
from ecus.steering.params import SteeringParams

INTEGRAL_DUTY_MAX: Final = 0.25
"""Bound on the integrator: enough for aligning torque and friction, too little to run away."""

FRICTION_RATE_RADPS: Final = 0.3
"""Reference rate at which friction is fully compensated; below it, in proportion (no chatter)."""

RATE_FILTER_S: Final = 0.02
"""Time constant of the measured rate's filter."""


class SteeringLoop:
    """Steering-wheel angle control; one object, changed by `update` alone."""

    __slots__ = ("_angle_rad", "_integral", "rate_radps", "reference_rad", "reference_rate_radps")

    def __init__(self) -> None:
        self.reference_rad = 0.0
        self.reference_rate_radps = 0.0
        self.rate_radps = 0.0
        self._integral = 0.0
        self._angle_rad = math.nan

    def start(self, angle_rad: float) -> None:
        """Begins at the measured angle: taking over must not move the wheel."""
        self.reference_rad = angle_rad
        self.reference_rate_radps = 0.0
        self._integral = 0.0

    def measure(self, angle_rad: float, dt_s: float) -> None:
        """Takes the reading in, driving or not, so that the rate is known when driving begins."""
        if math.isnan(self._angle_rad) or math.isnan(angle_rad):
            self.rate_radps = 0.0
        else:
            share = dt_s / (dt_s + RATE_FILTER_S)
            self.rate_radps += share * ((angle_rad - self._angle_rad) / dt_s - self.rate_radps)
        self._angle_rad = angle_rad

    def update(self, target_rad: float, dt_s: float, params: SteeringParams) -> float:
        """Motor duty, -1 to 1, that brings the wheel to the target within the limits."""
        rate_before = self.reference_rate_radps
        self._profile(target_rad, dt_s, params)
        reference_rate = self.reference_rate_radps
        acceleration = (reference_rate - rate_before) / dt_s
        error_rad = self.reference_rad - self._angle_rad
        # Inverse of the motor's first-order model, then feedback on what it leaves.
        wanted = reference_rate + params.motor_time_constant_s * acceleration
        correction = params.position_gain_per_s * error_rad
        wanted += correction + params.rate_gain * (reference_rate - self.rate_radps)
        friction = params.motor_friction_duty_ratio * clamp(
            (reference_rate + correction) / FRICTION_RATE_RADPS, -1.0, 1.0
        )
        duty = wanted / params.motor_free_speed_radps + friction
        step = params.integral_gain_per_s2 * error_rad * dt_s / params.motor_free_speed_radps
        if abs(duty + self._integral) < 1.0 or step * duty < 0.0:  # no wind-up at saturation
            self._integral = clamp(self._integral + step, -INTEGRAL_DUTY_MAX, INTEGRAL_DUTY_MAX)
        return clamp(duty + self._integral, -1.0, 1.0)

    def _profile(self, target_rad: float, dt_s: float, params: SteeringParams) -> None:
        """Moves the reference: never faster, nor braking later, than the column can."""
        limit_rad = params.wheel_angle_rad_max
        distance_rad = clamp(target_rad, -limit_rad, limit_rad) - self.reference_rad
        acceleration = params.wheel_acceleration_radps2_max
        # Fastest rate from which the target can still be met in whole steps of dt.
        step_rad = acceleration * dt_s * dt_s
        stop_rate = acceleration * dt_s * (
            math.sqrt(0.25 + 2.0 * abs(distance_rad) / step_rad) - 0.5
        )
        rate_max = min(params.wheel_rate_radps_max, stop_rate, abs(distance_rad) / dt_s)
        wanted = math.copysign(rate_max, distance_rad)
        change = acceleration * dt_s
        self.reference_rate_radps = clamp(
            wanted, self.reference_rate_radps - change, self.reference_rate_radps + change
        )
        self.reference_rad += self.reference_rate_radps * dt_s
