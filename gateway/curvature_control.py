"""Curvature held by an IMU's yaw rate, for steering whose linkage has play (UNICAMP Section 4.1).

Feed-forward is the wanted curvature itself: the steering node turns it into an angle by the bicycle
model. A PID on the measured curvature, yaw rate over measured speed, adds what linkage and tyres
take away. Sans-I/O: a planner puts it between its decision and `Car.command`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from gateway.commands import NS_PER_S, Decision
from gateway.kinematics import Kinematics
from vehicles.vehicle import Vehicle

SPEED_MPS_MIN: Final = 0.1
"""Below, curvature is a small yaw rate over a small speed: undefined at standstill."""
STANDING_MPS: Final = 0.02
YAW_AGE_NS_MAX: Final = 100_000_000
"""An older reading counts as none."""
PAUSE_NS_MAX: Final = 500_000_000
"""A longer time between two updates is a pause, in which nothing is learned."""
FADE_S: Final = 0.5
"""In which the correction goes when yaw rate or speed is lost, and comes back afterwards."""
SETTLED_S: Final = 0.3
"""So long must the car stand before its yaw rate is the IMU's bias."""
BIAS_SAMPLES_MAX: Final = 500
"""Readings that the bias is a mean of; afterwards the oldest count less and less."""
BIAS_RADPS_MAX: Final = 0.02
"""A standing car that turns faster is being carried (assumption: six times a MEMS gyro's bias)."""
assert STANDING_MPS < SPEED_MPS_MIN


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvatureTuning:
    """Gains and limits of the feedback; `experiments/unicamp/tuning.py` finds a car's.

    Raises:
        ValueError: A number that is negative, infinite or NaN.
    """

    proportional_ratio: float
    """Correction for a curvature error, both in 1/m."""
    integral_per_s: float
    derivative_s: float
    filter_s: float
    """Time constant of the measured curvature's filter."""
    lag_s: float
    """From a setpoint to the yaw rate, besides the steering's rate limit: no error meanwhile."""
    correction_per_m_max: float
    """Of the whole correction, either side: as far as a wrong IMU can bend the path."""

    def __post_init__(self) -> None:
        for name in ("proportional_ratio", "integral_per_s", "derivative_s", "filter_s", "lag_s",
                     "correction_per_m_max"):  # fmt: skip
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} = {value!r}: allowed 0 and more, finite")


@dataclass(frozen=True, slots=True, kw_only=True)
class YawReading:
    """One reading of an IMU."""

    time_ns: int
    """When it was measured, by the clock of `update`."""
    yaw_rate_radps: float
    """Positive left; NaN for none."""


class Feedback(Enum):
    """What the last update knew of the car's curvature."""

    MEASURED = auto()
    STANDING = auto()  # slower than SPEED_MPS_MIN: the correction is held
    LOST = auto()  # yaw rate or speed is missing, stale, or no number: the correction fades


class CurvatureControl:
    """Holds a curvature; one object for a car, changed by `update` and `start` alone.

    What it has learned in left turns is kept apart from that of right turns, since play and dead
    zone take away from either. At standstill it learns the IMU's bias.

    Args:
        vehicle: Whose limits hold: range of the curvature, and the steering's rate.
        tuning: Of this car.

    Attributes:
        feedback: What the last update knew.
        bias_radps: Learned at standstill, taken off every reading.
        correction_per_m: In the last answer, before range and rate limit.
    """

    def __init__(self, vehicle: Vehicle, tuning: CurvatureTuning) -> None:
        self._tuning = tuning
        self._curvature_max = vehicle.curvature_per_m_max
        # the curvature's rate with the wheels straight, where it is slowest
        kinematics = Kinematics.of(vehicle.geometry, vehicle.steering)
        self._rate_max = vehicle.steering.wheel_rate_radps_max / (
            kinematics.steering_ratio * kinematics.wheelbase_m
        )
        self.bias_radps = 0.0
        self._bias_samples = 0
        self.start(0.0)

    def start(self, curvature_per_m: float) -> None:
        """Begins at a curvature, such as the steering's own, having learned the bias alone."""
        self.feedback = Feedback.LOST
        self.correction_per_m = 0.0
        self._output = self._reference = self._expected = curvature_per_m
        self._side = 0
        self._learned = [0.0, 0.0]  # 1/m, in turns to the left and to the right
        self._trust = 0.0
        self._measured = math.nan
        self._rate = 0.0
        self._standing_s = 0.0
        self._bias_ns: int | None = None
        self._now_ns: int | None = None

    def update(
        self, now_ns: int, wanted: Decision, speed_mps: float, yaw: YawReading | None
    ) -> Decision:
        """The decision to send in place of the wanted one: same speed, corrected curvature.

        Args:
            now_ns: Rises from call to call.
            wanted: What the planner decided.
            speed_mps: Measured; NaN for unknown.
            yaw: Newest reading of the IMU; None for none. One that is NaN, infinite, older than
                100 ms or from the future counts as none.
        """
        dt_s = self._pass(now_ns)
        self._expect(wanted.curvature_per_m, dt_s)
        rate = _fresh(now_ns, yaw)
        self.feedback = _feedback(speed_mps, rate)
        if yaw is not None and not math.isnan(rate):
            self._learn_bias(yaw, wanted.speed_mps, speed_mps, dt_s)
        self._measure(rate - self.bias_radps, speed_mps, dt_s)
        if wanted.curvature_per_m != 0.0:
            self._side = 0 if wanted.curvature_per_m > 0.0 else 1
        error = 0.0 if math.isnan(self._measured) else self._expected - self._measured
        self._fade(dt_s)
        quick = self._tuning.proportional_ratio * error - self._tuning.derivative_s * self._rate
        step = self._trust * self._tuning.integral_per_s * error * dt_s
        self._answer(wanted.curvature_per_m, quick, step, dt_s)
        return Decision(speed_mps=wanted.speed_mps, curvature_per_m=self._output)

    def _pass(self, now_ns: int) -> float:
        """Time since the last update; none after a pause, and then nothing is known any more."""
        before_ns, self._now_ns = self._now_ns, now_ns
        if before_ns is None:
            return 0.0
        assert now_ns >= before_ns, "time goes on"
        if now_ns - before_ns > PAUSE_NS_MAX:
            self._measured, self._standing_s = math.nan, 0.0
            return 0.0
        return (now_ns - before_ns) / NS_PER_S

    def _expect(self, wanted: float, dt_s: float) -> None:
        """The curvature that a good car has by now: the setpoint, rate limited, and its lag."""
        self._reference = _towards(self._reference, wanted, self._rate_max * dt_s)
        self._expected += _share(dt_s, self._tuning.lag_s) * (self._reference - self._expected)

    def _learn_bias(
        self, yaw: YawReading, wanted_mps: float, speed_mps: float, dt_s: float
    ) -> None:
        """Yaw rate of a car that stands and is to stand; a reading counts once."""
        is_standing = wanted_mps == 0.0 and abs(speed_mps) < STANDING_MPS
        self._standing_s = self._standing_s + dt_s if is_standing else 0.0
        rate = yaw.yaw_rate_radps
        if self._standing_s < SETTLED_S or yaw.time_ns == self._bias_ns:
            return
        self._bias_ns = yaw.time_ns
        if abs(rate) <= BIAS_RADPS_MAX:
            self._bias_samples = min(self._bias_samples + 1, BIAS_SAMPLES_MAX)
            self.bias_radps += (rate - self.bias_radps) / self._bias_samples

    def _measure(self, rate_radps: float, speed_mps: float, dt_s: float) -> None:
        """Curvature through its filter, and how fast it changes."""
        before = self._measured
        if self.feedback is not Feedback.MEASURED:
            self._measured, self._rate = math.nan, 0.0
            return
        limit = 2.0 * self._curvature_max  # wheels that begin to roll tell anything
        new = min(max(rate_radps / speed_mps, -limit), limit)
        if math.isnan(before):
            self._measured, self._rate = new, 0.0
        elif dt_s > 0.0:
            self._measured += _share(dt_s, self._tuning.filter_s) * (new - before)
            self._rate = (self._measured - before) / dt_s

    def _fade(self, dt_s: float) -> None:
        """How much of the correction is used: all that is measured, nothing that is lost."""
        step = dt_s / FADE_S
        if self.feedback is Feedback.MEASURED:
            self._trust = min(1.0, self._trust + step)
        elif self.feedback is Feedback.LOST:
            self._trust = max(0.0, self._trust - step)

    def _answer(self, wanted: float, quick: float, step: float, dt_s: float) -> None:
        """Sums up, limits, and learns unless that went on against a limit."""
        bound, side = self._tuning.correction_per_m_max, self._side
        total = quick + self._learned[side] + step
        within = min(max(total, -bound), bound)
        self.correction_per_m = self._trust * within
        asked = wanted + self.correction_per_m
        reached = min(max(asked, -self._curvature_max), self._curvature_max)
        self._output = _towards(self._output, reached, self._rate_max * dt_s)
        cut_off = total - within + asked - self._output
        if step * cut_off <= 0.0:
            self._learned[side] += step


def _fresh(now_ns: int, yaw: YawReading | None) -> float:
    """The yaw rate, or NaN."""
    if yaw is None or not 0 <= now_ns - yaw.time_ns <= YAW_AGE_NS_MAX:
        return math.nan
    return yaw.yaw_rate_radps if math.isfinite(yaw.yaw_rate_radps) else math.nan


def _feedback(speed_mps: float, rate_radps: float) -> Feedback:
    if math.isnan(rate_radps) or not math.isfinite(speed_mps):
        return Feedback.LOST
    return Feedback.STANDING if abs(speed_mps) < SPEED_MPS_MIN else Feedback.MEASURED


def _share(dt_s: float, constant_s: float) -> float:
    """Of the way that a first-order lag goes in this time."""
    return dt_s / (dt_s + constant_s) if dt_s > 0.0 else 0.0


def _towards(value: float, target: float, step: float) -> float:
    return min(max(target, value - step), value + step)
