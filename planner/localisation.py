"""Pose estimate: late RTK fixes joined with odometry, as UAH's Localisation Module (section 3.4).

An extended Kalman filter with the states x, y, heading. Odometry (measured speed and curvature)
predicts; a fix corrects the state of the time it was *taken*, and the odometry since is integrated
again on top, so that its age costs nothing but the drift of 100 ms. No fix carries a heading: the
filter learns it from where the positions move (cross-covariance of position and heading), starting
from a known pose.
"""

import math
from collections import deque
from dataclasses import dataclass

from planner.gnss import SIGMA_M, GnssFix, GnssReceiver
from planner.pose import Pose

__all__ = ["GnssFix", "GnssReceiver", "Localiser"]

HISTORY_NS = 1_000_000_000  # a fix older than this is of no use
ODOMETRY_GAP_NS_MAX = 500_000_000  # silence after which the odometry is no odometry any more
START_SIGMA_M = 0.02
START_SIGMA_RAD = math.radians(0.5)
# Drift of the odometry, as random walks over distance: 3 mm in the first metre for wheel radius and
# slip; in heading what the steering angle does not show (offset, tyre slip), taken as constant over
# the correlation length. Larger values follow a wrong curvature faster and turn the wheel more at
# each fix; these hold 5 % of understeer within 13 cm on a campus lap.
POSITION_WALK_M2_PER_M = 0.003**2
CURVATURE_SIGMA_PER_M = 0.001
CURVATURE_SIGMA_SHARE = 0.03
CORRELATION_M = 2.0
GATE_SIGMAS2 = 36.0  # a fix farther off than 6 sigma is an outlier ...
REJECTIONS_MAX = 5  # ... unless the next ones agree with it


@dataclass(slots=True)
class _State:
    """Estimate at one time, and the motion measured then (held until the next)."""

    time_ns: int
    x: float
    y: float
    heading: float
    pxx: float
    pxy: float
    pyy: float
    pxh: float
    pyh: float
    phh: float
    speed: float
    curvature: float

    def predicted(self, time_ns: int, speed: float, curvature: float) -> "_State":
        """Return the estimate at a later time, with the motion measured there."""
        mean_speed = 0.5 * (self.speed + speed)
        mean_curvature = 0.5 * (self.curvature + curvature)
        distance = mean_speed * (time_ns - self.time_ns) * 1e-9
        turn = distance * mean_curvature
        chord = self.heading + 0.5 * turn
        dx = distance * math.cos(chord)
        dy = distance * math.sin(chord)
        walk = POSITION_WALK_M2_PER_M * abs(distance)
        sigma = CURVATURE_SIGMA_PER_M + CURVATURE_SIGMA_SHARE * abs(mean_curvature)
        pxh, pyh, phh = self.pxh, self.pyh, self.phh
        # Jacobian of the motion: dx/dheading = -dy, dy/dheading = dx.
        return _State(
            time_ns=time_ns,
            x=self.x + dx,
            y=self.y + dy,
            heading=self.heading + turn,
            pxx=self.pxx - 2.0 * dy * pxh + dy * dy * phh + walk,
            pxy=self.pxy + dx * pxh - dy * pyh - dx * dy * phh,
            pyy=self.pyy + 2.0 * dx * pyh + dx * dx * phh + walk,
            pxh=pxh - dy * phh,
            pyh=pyh + dx * phh,
            phh=phh + sigma * sigma * CORRELATION_M * abs(distance),
            speed=speed,
            curvature=curvature,
        )

    def correct(self, x_m: float, y_m: float, variance_m2: float, gated: bool) -> bool:
        """Take in a position; False if it is an outlier and `gated` asks to refuse it."""
        dx, dy = x_m - self.x, y_m - self.y
        sxx, sxy, syy = self.pxx + variance_m2, self.pxy, self.pyy + variance_m2
        determinant = sxx * syy - sxy * sxy
        distance2 = (syy * dx * dx - 2.0 * sxy * dx * dy + sxx * dy * dy) / determinant
        if gated and distance2 > GATE_SIGMAS2:
            return False
        ixx, ixy, iyy = syy / determinant, -sxy / determinant, sxx / determinant
        pxx, pxy, pyy, pxh, pyh = self.pxx, self.pxy, self.pyy, self.pxh, self.pyh
        kxx, kxy = pxx * ixx + pxy * ixy, pxx * ixy + pxy * iyy
        kyx, kyy = pxy * ixx + pyy * ixy, pxy * ixy + pyy * iyy
        khx, khy = pxh * ixx + pyh * ixy, pxh * ixy + pyh * iyy
        self.x += kxx * dx + kxy * dy
        self.y += kyx * dx + kyy * dy
        self.heading += khx * dx + khy * dy
        self.phh -= khx * pxh + khy * pyh
        self.pxh = pxh - kxx * pxh - kxy * pyh
        self.pyh = pyh - kyx * pxh - kyy * pyh
        self.pxx = pxx - kxx * pxx - kxy * pxy
        self.pxy = pxy - kxx * pxy - kxy * pyy
        self.pyy = pyy - kyx * pxy - kyy * pyy
        return True


class Localiser:
    """Estimates the pose of the rear-axle centre.

    Call `odometry` for each measurement of the vehicle's motion, `fix` for each fix when it
    arrives, and `pose` whenever the pose is needed. Pure: the same calls give the same poses.
    """

    def __init__(self, start: Pose, start_ns: int, fix_sigma_m: float = SIGMA_M) -> None:
        """Start at rest at a known pose (2 cm, 0.5 degrees)."""
        variance = START_SIGMA_M**2
        self._fix_variance_m2 = max(fix_sigma_m, 1e-3) ** 2
        self._history: deque[_State] = deque(
            [
                _State(
                    start_ns, start.x_m, start.y_m, start.heading_rad,
                    variance, 0.0, variance, 0.0, 0.0, START_SIGMA_RAD**2, 0.0, 0.0,
                )
            ]
        )  # fmt: skip
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
        last = self._history[-1]
        if taken_ns <= last.time_ns:
            return
        self._history.append(last.predicted(taken_ns, speed_mps, curvature_per_m))
        while len(self._history) > 1 and self._history[1].time_ns < taken_ns - HISTORY_NS:
            self._history.popleft()

    def fix(self, fix: GnssFix) -> bool:
        """Take in a fix; return False if it was too old or an outlier.

        An outlier lies more than 6 sigma off; the fifth in a row is believed.

        Raises:
            ValueError: If the position is not finite.
        """
        if not (math.isfinite(fix.x_m) and math.isfinite(fix.y_m)):
            raise ValueError(f"fix x_m {fix.x_m} and y_m {fix.y_m} must be finite")
        later: list[_State] = []
        while self._history and self._history[-1].time_ns > fix.taken_ns:
            later.append(self._history.pop())
        accepted = False
        if self._history:
            corrected = self._at(fix.taken_ns, later)
            gated = self._rejected_in_a_row < REJECTIONS_MAX - 1
            accepted = corrected.correct(fix.x_m, fix.y_m, self._fix_variance_m2, gated)
        if not accepted:
            self._history.extend(reversed(later))
            self._rejected_in_a_row += 1
            self.fixes_rejected += 1
            return False
        self._rejected_in_a_row = 0
        self.fixes_used += 1
        self._history.append(corrected)
        for state in reversed(later):
            self._history.append(
                self._history[-1].predicted(state.time_ns, state.speed, state.curvature)
            )
        return True

    def _at(self, time_ns: int, later: list[_State]) -> _State:
        """Return the estimate at a time between the last of the history and the first later."""
        before = self._history[-1]
        if not later:
            return before.predicted(time_ns, before.speed, before.curvature)
        after = later[-1]
        share = (time_ns - before.time_ns) / (after.time_ns - before.time_ns)
        return before.predicted(
            time_ns,
            before.speed + share * (after.speed - before.speed),
            before.curvature + share * (after.curvature - before.curvature),
        )

    def pose(self, now_ns: int) -> Pose:
        """Return the estimate for now: the last motion measured is held, for 0.5 s at most."""
        last = self._history[-1]
        until_ns = min(max(now_ns, last.time_ns), last.time_ns + ODOMETRY_GAP_NS_MAX)
        now = last.predicted(until_ns, last.speed, last.curvature)
        return Pose(x_m=now.x, y_m=now.y, heading_rad=now.heading)

    @property
    def position_sigma_m(self) -> float:
        """Standard deviation the filter gives its position (the worse axis)."""
        last = self._history[-1]
        return math.sqrt(max(last.pxx, last.pyy))

    @property
    def heading_sigma_rad(self) -> float:
        """Standard deviation the filter gives its heading."""
        return math.sqrt(self._history[-1].phh)
