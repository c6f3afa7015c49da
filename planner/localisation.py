"""Pose estimate: late RTK fixes joined with odometry, as UAH's Localisation Module (section 3.4).

An extended Kalman filter. Odometry (measured speed and curvature) predicts; a fix corrects the
estimate of the time it was *taken*, and the odometry since is integrated again on top, so that its
age costs nothing but the drift of 100 ms. No fix carries a heading: the filter learns it from where
the positions move, starting from a known pose.

What measures the motion is biased on every car: a loaded tyre rolls on a smaller radius, driven
wheels slip, the steering sensor's zero is off, tyres understeer. A filter that does not know lags
behind by the drift that its fixes have to make up for, always to the same side. So the states are
the pose and four slow corrections of the odometry:

    distance = speed_scale * measured
    curvature(t) = curvature_scale * measured(t - curvature_lag) + curvature_offset

each a first-order Gauss-Markov process over distance, which keeps it bounded where the road does
not show it (a straight says nothing of the curvature's scale). The heading is the rear axle's
course: tyre slip makes it differ from where the body points, and the course is what moves the car.
The lag is the tyres' too, less that of the measurement: side slip takes some 10 ms per m/s to build
up, and without it a bend's entry turns the estimate by half a degree.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from gateway.odometry import moved
from planner.gnss import SIGMA_M, GnssFix, GnssReceiver
from planner.pose import Pose
from planner.road import FloatArray

__all__ = ["GnssFix", "GnssReceiver", "Localiser", "OdometryCorrection"]

HISTORY_NS: Final = 1_000_000_000  # a fix older than this is of no use
ODOMETRY_GAP_NS_MAX: Final = 500_000_000  # silence after which the odometry is no odometry any more
START_SIGMA_M: Final = 0.02
START_SIGMA_RAD: Final = math.radians(0.5)
# What the corrections leave, as random walks over distance: 2 mm in the first metre for wheel slip
# that comes and goes, 0.02 degrees for what the tyres do beside the lag and the scale.
POSITION_WALK_M2_PER_M: Final = 0.002**2
HEADING_WALK_RAD2_PER_M: Final = math.radians(0.02) ** 2
# Spread of the corrections, and the distance over which they are constant.
SPEED_SCALE_SIGMA: Final = 0.02  # 1 % tyre radius, 1 % driving and braking slip
SPEED_SCALE_LENGTH_M: Final = 500.0
CURVATURE_SCALE_SIGMA: Final = 0.03  # understeer that changes with speed
CURVATURE_SCALE_LENGTH_M: Final = 500.0
CURVATURE_OFFSET_SIGMA_PER_M: Final = 0.0005  # 0.05 rad at a steering wheel of 40:1
CURVATURE_OFFSET_LENGTH_M: Final = 3000.0
CURVATURE_LAG_SIGMA_S: Final = 0.05
CURVATURE_LAG_LENGTH_M: Final = 1000.0
GATE_SIGMAS2: Final = 36.0  # a fix farther off than 6 sigma is an outlier ...
REJECTIONS_MAX: Final = 5  # ... unless the next ones agree with it

_X, _Y, _HEADING, _SPEED_SCALE = range(4)
_CORRECTION: Final = slice(3, 7)  # speed scale, curvature scale, offset and lag
_NOMINAL: Final = np.array([1.0, 1.0, 0.0, 0.0])
_IDENTITY: Final = np.eye(7)
_POSITION: Final = slice(0, 2)
# Per metre: loss of the corrections' deviation from nominal, and noise that keeps their spread.
_DECAY_PER_M: Final = np.array(
    [
        0.0,
        0.0,
        0.0,
        1.0 / SPEED_SCALE_LENGTH_M,
        1.0 / CURVATURE_SCALE_LENGTH_M,
        1.0 / CURVATURE_OFFSET_LENGTH_M,
        1.0 / CURVATURE_LAG_LENGTH_M,
    ]
)
_START_VARIANCE: Final = np.array(
    [
        START_SIGMA_M**2,
        START_SIGMA_M**2,
        START_SIGMA_RAD**2,
        SPEED_SCALE_SIGMA**2,
        CURVATURE_SCALE_SIGMA**2,
        CURVATURE_OFFSET_SIGMA_PER_M**2,
        CURVATURE_LAG_SIGMA_S**2,
    ]
)
_WALK_PER_M: Final = np.diag(
    [POSITION_WALK_M2_PER_M, POSITION_WALK_M2_PER_M, HEADING_WALK_RAD2_PER_M, *4 * [0.0]]
) + np.diag(2.0 * _DECAY_PER_M * _START_VARIANCE)


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class OdometryCorrection:
    """What the fixes have taught about the odometry.

    Attributes:
        speed_scale: True speed per measured speed.
        curvature_scale: True curvature per measured curvature.
        curvature_offset_per_m: True curvature where none is measured.
        curvature_lag_s: How much later the true curvature comes.
    """

    speed_scale: Final[float]
    curvature_scale: Final[float]
    curvature_offset_per_m: Final[float]
    curvature_lag_s: Final[float]

    def __init__(
        self,
        *,
        speed_scale: float,
        curvature_scale: float,
        curvature_offset_per_m: float,
        curvature_lag_s: float,
    ) -> None:
        self.speed_scale = speed_scale
        self.curvature_scale = curvature_scale
        self.curvature_offset_per_m = curvature_offset_per_m
        self.curvature_lag_s = curvature_lag_s


@dataclass(slots=True, init=False, unsafe_hash=True)
class _Motion:
    """A measurement of the odometry."""

    time_ns: Final[int]
    speed_mps: Final[float]
    curvature_per_m: Final[float]

    def __init__(self, time_ns: int, speed_mps: float, curvature_per_m: float) -> None:
        self.time_ns = time_ns
        self.speed_mps = speed_mps
        self.curvature_per_m = curvature_per_m

    def until(self, time_ns: int, later: "_Motion") -> "_Motion":
        """Return the motion at a time between this measurement and a later one."""
        share = (time_ns - self.time_ns) / (later.time_ns - self.time_ns)
        return _Motion(
            time_ns,
            self.speed_mps + share * (later.speed_mps - self.speed_mps),
            self.curvature_per_m + share * (later.curvature_per_m - self.curvature_per_m),
        )

    def at(self, time_ns: int) -> "_Motion":
        """Return the same motion, held until a later time."""
        return _Motion(time_ns, self.speed_mps, self.curvature_per_m)


@dataclass(slots=True, init=False, unsafe_hash=True)
class _Step:
    """Motion between two measurements, taken as their mean and corrected."""

    distance_m: Final[float]
    measured_curvature_per_m: Final[float]
    swing_radps: Final[float]  # speed times the change of curvature: turn per second of lag
    turn_rad: Final[float]

    def __init__(
        self,
        distance_m: float,
        measured_curvature_per_m: float,
        swing_radps: float,
        turn_rad: float,
    ) -> None:
        self.distance_m = distance_m
        self.measured_curvature_per_m = measured_curvature_per_m
        self.swing_radps = swing_radps
        self.turn_rad = turn_rad

    @classmethod
    def between(cls, before: _Motion, after: _Motion, correction: OdometryCorrection) -> "_Step":
        duration_s = (after.time_ns - before.time_ns) * 1e-9
        speed_mps = correction.speed_scale * 0.5 * (before.speed_mps + after.speed_mps)
        measured = 0.5 * (before.curvature_per_m + after.curvature_per_m)
        swing_radps = speed_mps * (before.curvature_per_m - after.curvature_per_m)
        curvature = correction.curvature_scale * measured + correction.curvature_offset_per_m
        distance_m = speed_mps * duration_s
        turn_rad = distance_m * curvature + correction.curvature_lag_s * swing_radps
        return cls(distance_m, measured, swing_radps, turn_rad)

    def moved(self, pose: Pose) -> Pose:
        """Return the pose at its end."""
        x_m, y_m, heading_rad = moved(
            pose.x_m, pose.y_m, pose.heading_rad, self.distance_m, self.turn_rad
        )
        return Pose(x_m=x_m, y_m=y_m, heading_rad=heading_rad)


class _Filter:
    """Mean and covariance of the seven states at the time of the last fix or of the start."""

    __slots__ = ("_correction", "covariance", "mean", "motion")

    def __init__(self, mean: FloatArray, covariance: FloatArray, motion: _Motion) -> None:
        self.mean = mean
        self.covariance = covariance
        self.motion = motion
        self._correction: OdometryCorrection | None = None

    def copy(self) -> "_Filter":
        return _Filter(self.mean.copy(), self.covariance.copy(), self.motion)

    @property
    def pose(self) -> Pose:
        x_m, y_m, heading_rad = self.mean[:3].tolist()
        return Pose(x_m=x_m, y_m=y_m, heading_rad=heading_rad)

    @property
    def correction(self) -> OdometryCorrection:
        if self._correction is None:
            speed_scale, curvature_scale, offset_per_m, lag_s = self.mean[_CORRECTION].tolist()
            self._correction = OdometryCorrection(
                speed_scale=speed_scale,
                curvature_scale=curvature_scale,
                curvature_offset_per_m=offset_per_m,
                curvature_lag_s=lag_s,
            )
        return self._correction

    def predict(self, motion: _Motion) -> None:
        """Go on to a later measurement."""
        correction = self.correction
        step = _Step.between(self.motion, motion, correction)
        pose = self.pose
        moved = step.moved(pose)
        dx, dy = moved.x_m - pose.x_m, moved.y_m - pose.y_m
        # Turning by t more at the start moves the end by t across; turning it in the course of
        # the step, by half of that.
        turn_by = np.array(
            [
                step.turn_rad / correction.speed_scale,
                step.distance_m * step.measured_curvature_per_m,
                step.distance_m,
                step.swing_radps,
            ]
        )
        jacobian = _IDENTITY.copy()
        jacobian[_X, _HEADING] = -dy
        jacobian[_Y, _HEADING] = dx
        jacobian[_HEADING, _CORRECTION] = turn_by
        jacobian[_X, _CORRECTION] = -0.5 * dy * turn_by
        jacobian[_Y, _CORRECTION] = 0.5 * dx * turn_by
        jacobian[_X, _SPEED_SCALE] += dx / correction.speed_scale
        jacobian[_Y, _SPEED_SCALE] += dy / correction.speed_scale
        way_m = abs(step.distance_m)
        kept = 1.0 - way_m * _DECAY_PER_M
        jacobian *= kept[:, None]
        self.covariance = jacobian @ self.covariance @ jacobian.T + way_m * _WALK_PER_M
        self.mean[:3] = (moved.x_m, moved.y_m, moved.heading_rad)
        strayed = self.mean[_CORRECTION] - _NOMINAL
        self.mean[_CORRECTION] = _NOMINAL + kept[_CORRECTION] * strayed
        self._correction = None
        self.motion = motion

    def correct(self, x_m: float, y_m: float, variance_m2: float, gated: bool) -> bool:
        """Take in a position; an outlier is refused if `gated`, else the position gives way."""
        innovation = np.array([x_m - self.mean[_X], y_m - self.mean[_Y]])
        spread = self.covariance[_POSITION, _POSITION] + variance_m2 * np.eye(2)
        if innovation @ np.linalg.solve(spread, innovation) > GATE_SIGMAS2:
            if gated:
                return False
            given_way = float(innovation @ innovation) * np.eye(2)
            self.covariance[_POSITION, _POSITION] += given_way
            spread = spread + given_way
        gain = np.linalg.solve(spread, self.covariance[_POSITION]).T
        self.mean = self.mean + gain @ innovation
        self._correction = None
        # Joseph's form: stays symmetric and positive over any number of fixes.
        kept = _IDENTITY.copy()
        kept[:, _POSITION] -= gain
        self.covariance = kept @ self.covariance @ kept.T + variance_m2 * (gain @ gain.T)
        return True


class Localiser:
    """Estimates the pose of the rear-axle centre.

    Call `odometry` for each measurement of the vehicle's motion, `fix` for each fix when it
    arrives, and `pose` whenever the pose is needed. Pure: the same calls give the same poses.
    """

    def __init__(self, start: Pose, start_ns: int, fix_sigma_m: float = SIGMA_M) -> None:
        """Start at rest at a known pose (2 cm, 0.5 degrees)."""
        self._fix_variance_m2 = max(fix_sigma_m, 1e-3) ** 2
        mean = np.array([start.x_m, start.y_m, start.heading_rad, *_NOMINAL])
        motion = _Motion(start_ns, 0.0, 0.0)
        self._filter = _Filter(mean, np.diag(_START_VARIANCE), motion)
        self._since: deque[_Motion] = deque()  # measured after the filter's time
        self._last = motion
        self._pose = start  # at the last measurement
        self._rejected_in_a_row = 0
        self.fixes_used = 0
        self.fixes_rejected = 0

    def odometry(self, taken_ns: int, speed_mps: float, curvature_per_m: float) -> None:
        """Take in the vehicle's motion as measured at `taken_ns`.

        Between two measurements the motion is taken as their mean. A measurement that is not
        newer than the last one is ignored.

        Raises:
            ValueError: If speed or curvature is not finite.
        """
        if not (math.isfinite(speed_mps) and math.isfinite(curvature_per_m)):
            raise ValueError(
                f"speed_mps {speed_mps} and curvature_per_m {curvature_per_m} must be finite"
            )
        if taken_ns <= self._last.time_ns:
            return
        motion = _Motion(taken_ns, speed_mps, curvature_per_m)
        self._pose = _Step.between(self._last, motion, self._filter.correction).moved(self._pose)
        self._last = motion
        self._since.append(motion)
        while self._since[0].time_ns < taken_ns - HISTORY_NS:
            self._filter.predict(self._since.popleft())

    def fix(self, fix: GnssFix) -> bool:
        """Take in a fix; return False if it was too old or an outlier.

        Too old is one taken more than 1 s before the last odometry, or before the last fix used.
        An outlier lies more than 6 sigma off; the fifth in a row is believed.

        Raises:
            ValueError: If the position is not finite.
        """
        if not (math.isfinite(fix.x_m) and math.isfinite(fix.y_m)):
            raise ValueError(f"fix x_m {fix.x_m} and y_m {fix.y_m} must be finite")
        accepted = False
        if fix.taken_ns >= self._filter.motion.time_ns:
            corrected, later = self._at(fix.taken_ns)
            gated = self._rejected_in_a_row < REJECTIONS_MAX - 1
            accepted = corrected.correct(fix.x_m, fix.y_m, self._fix_variance_m2, gated)
        if not accepted:
            self._rejected_in_a_row += 1
            self.fixes_rejected += 1
            return False
        self._rejected_in_a_row = 0
        self.fixes_used += 1
        self._filter = corrected
        self._since = later
        self._replay()
        return True

    def _at(self, time_ns: int) -> tuple[_Filter, deque[_Motion]]:
        """Return the filter at a time not before its own, and the measurements after it."""
        result, later = self._filter.copy(), deque(self._since)
        while later and later[0].time_ns <= time_ns:
            result.predict(later.popleft())
        if result.motion.time_ns < time_ns:
            motion = result.motion
            result.predict(motion.until(time_ns, later[0]) if later else motion.at(time_ns))
        return result, later

    def _replay(self) -> None:
        """Integrate the odometry since the filter's time again."""
        correction = self._filter.correction
        self._last, self._pose = self._filter.motion, self._filter.pose
        for motion in self._since:
            self._pose = _Step.between(self._last, motion, correction).moved(self._pose)
            self._last = motion

    def pose(self, now_ns: int) -> Pose:
        """Return the estimate for now: the last motion measured is held, for 0.5 s at most."""
        last = self._last
        until_ns = min(max(now_ns, last.time_ns), last.time_ns + ODOMETRY_GAP_NS_MAX)
        return _Step.between(last, last.at(until_ns), self._filter.correction).moved(self._pose)

    @property
    def odometry_correction(self) -> OdometryCorrection:
        """What is believed of the odometry now; nominal (1, 1, 0) at the start."""
        return self._filter.correction

    @property
    def position_sigma_m(self) -> float:
        """Standard deviation the filter gives its position (the worse axis)."""
        covariance = self._at(self._last.time_ns)[0].covariance
        return math.sqrt(max(covariance[_X, _X], covariance[_Y, _Y]))

    @property
    def heading_sigma_rad(self) -> float:
        """Standard deviation the filter gives its heading."""
        return math.sqrt(self._at(self._last.time_ns)[0].covariance[_HEADING, _HEADING])
