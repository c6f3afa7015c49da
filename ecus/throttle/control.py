"""The speed loop: a profiled reference, feed-forward, PI with conditional integration.

UAH's loop is a 10 Hz PI (Eq. 4-8). What feedback compares the speed with is what the drive can have
made of the reference by now, so that a slow drive's lag is no error to integrate. Drive torque and
regeneration are one axis here; the servo's braking is another hand on the same speed, so the
integrator freezes while it brakes.
"""

from __future__ import annotations

import math
from typing import Final

from ecus.common.limits import clamp, towards
from ecus.throttle.params import ThrottleParams
from ecus.throttle.ports import IDLE, ThrottleActuator, dac_code

INTEGRAL_MPS2_MAX: Final = 1.5
"""Bound on the integrator: a slope of 15 %."""

STANDSTILL_MPS: Final = 0.1
"""Below this with a zero setpoint nothing is asked of the motor; the servo holds the car."""


def actuator_of(acceleration_mps2: float, params: ThrottleParams) -> ThrottleActuator:
    """The two DAC codes for a wanted acceleration; negative regenerates."""
    drive = acceleration_mps2 / params.drive_acceleration_mps2_full
    full_regen = params.regen_deceleration_mps2_full
    regen = -acceleration_mps2 / full_regen if full_regen > 0.0 else 0.0
    return ThrottleActuator(throttle_dac_code=dac_code(drive), regen_dac_code=dac_code(regen))


class SpeedLoop:
    """Speed control at the driven wheels; one object, changed by `update` alone."""

    __slots__ = ("_expected_mps", "_integral_mps2", "reference_mps")

    def __init__(self) -> None:
        self.reference_mps = 0.0
        self._expected_mps = 0.0
        self._integral_mps2 = 0.0

    def start(self, speed_mps: float) -> None:
        """Begins at the measured speed: taking over must not jerk."""
        self.reference_mps = self._expected_mps = max(speed_mps, 0.0)
        self._integral_mps2 = 0.0

    def push(
        self, acceleration_mps2: float, hill_mps2: float, params: ThrottleParams
    ) -> ThrottleActuator:
        """Pushes against the brake; `hill_mps2` is what the hill takes if the car moves now, and
        the loop goes on from there."""
        self.reference_mps = self._expected_mps = 0.0
        self.set_off(hill_mps2)
        return actuator_of(acceleration_mps2, params)

    def set_off(self, hill_mps2: float) -> None:
        """The car moves, and the hill takes this."""
        self._integral_mps2 = clamp(hill_mps2, -INTEGRAL_MPS2_MAX, INTEGRAL_MPS2_MAX)

    def update(
        self,
        target_mps: float,
        speed_mps: float,
        dt_s: float,
        params: ThrottleParams,
        *,
        is_servo_braking: bool,
        brake_mps2: float = 0.0,
    ) -> ThrottleActuator:
        """DAC codes that bring the car to the target speed within the limits.

        Args:
            target_mps: Within the limits of `params`, or cut to them.
            speed_mps: Measured.
            dt_s: Since the last update.
            params: Gains and limits.
            is_servo_braking: No drive torque, and a frozen integrator.
            brake_mps2: What a brake takes that is let go in favour of the drive (hill start).
        """
        before_mps = self.reference_mps
        target_mps = clamp(target_mps, 0.0, params.speed_mps_max)
        rising = target_mps > before_mps
        rate = params.acceleration_mps2_max if rising else params.deceleration_mps2_max
        self.reference_mps = towards(before_mps, target_mps, rate * dt_s)
        if self.reference_mps == 0.0 and abs(speed_mps) < STANDSTILL_MPS:
            self._expected_mps = self._integral_mps2 = 0.0
            return IDLE
        if params.drive_lag_s > 0.0:
            share = dt_s / (dt_s + params.drive_lag_s)
            self._expected_mps += share * (self.reference_mps - self._expected_mps)
        else:
            self._expected_mps = self.reference_mps
        error_mps = self._expected_mps - speed_mps
        feed_forward = params.feed_forward_gain * (self.reference_mps - before_mps) / dt_s
        resistance = math.copysign(params.rolling_resistance_mps2, self.reference_mps)
        wanted = feed_forward + resistance + params.speed_gain * error_mps + self._integral_mps2
        wanted += brake_mps2
        low, high = -params.regen_deceleration_mps2_full, params.drive_acceleration_mps2_full
        if is_servo_braking or self.reference_mps == 0.0:  # who is to stand is not pushed
            return actuator_of(min(wanted, 0.0), params)
        step = params.integral_gain_per_s * error_mps * dt_s
        if low < wanted < high or step * wanted < 0.0:  # no wind-up at saturation
            self._integral_mps2 = clamp(
                self._integral_mps2 + step, -INTEGRAL_MPS2_MAX, INTEGRAL_MPS2_MAX
            )
        return actuator_of(wanted, params)
