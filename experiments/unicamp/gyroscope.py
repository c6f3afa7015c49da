"""The IMU's gyroscope about the vertical axis: late, noisy, and a little off."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from numpy.random import Generator

from gateway.curvature_control import YawReading

STANDING_MPS: Final = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class Imu:
    """What its maker tells, and what the car does to it."""

    period_ns: int
    latency_ns: int
    bias_radps: float
    noise_radps: float
    """Of one reading, standing."""
    vibration_radps: float
    """Of one reading besides, in motion."""


class Gyroscope:
    """Takes a reading when told, and shows it after its latency.

    Args:
        imu: What it is.
        rng: Of its noise.
    """

    def __init__(self, imu: Imu, rng: Generator) -> None:
        self._imu = imu
        self._rng = rng
        self._readings: list[YawReading] = []

    def read(self, now_ns: int, yaw_rate_radps: float, speed_mps: float) -> None:
        """Measures the car's yaw rate; its speed tells whether it shakes."""
        imu = self._imu
        is_moving = abs(speed_mps) > STANDING_MPS
        spread = math.hypot(imu.noise_radps, imu.vibration_radps if is_moving else 0.0)
        rate = yaw_rate_radps + imu.bias_radps + spread * self._rng.standard_normal()
        self._readings.append(YawReading(time_ns=now_ns, yaw_rate_radps=rate))

    def shown(self, now_ns: int) -> YawReading | None:
        """The newest reading that has arrived; None before the first."""
        ready_ns = now_ns - self._imu.latency_ns
        while len(self._readings) > 1 and self._readings[1].time_ns <= ready_ns:
            self._readings.pop(0)
        if self._readings and self._readings[0].time_ns <= ready_ns:
            return self._readings[0]
        return None
