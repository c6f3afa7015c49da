"""Pure Pursuit (Coulter 1992) with curvature preview: what UAH's Control Module does, without lag.

Coulter's arc leads from the vehicle to a point of the line one look-ahead away. On a line that is
followed exactly, that arc is a blurred, early picture of the line's own curvature; its use lies in
how it *changes* when the vehicle is off the line. So the command is

    curvature of the line where the vehicle will be once the steering has followed
    + (arc from the vehicle to the goal point - arc from its place on the line to the goal point)

The difference vanishes on the line, and for a small lateral error e and heading error p it is
-2 e / l^2 - 2 p / l with look-ahead l: a damping ratio of 0.707 at any speed, a natural frequency
of sqrt(2) v / l. The look-ahead grows with speed to keep that frequency well under the steering's.

The feed-forward does the driving and the feedback only what is left, so the look-ahead is long: 2 s
turn 1 cm of noise in the estimate into 0.6 degrees of a steering wheel of 40:1 at 7 m/s, where
0.8 s make it 3.4. The price is that a curvature fed forward wrong by d ends
d l^2 / 2 beside the line; so the biases the localiser has learned are taken out of the command.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from planner.line import Line
from planner.localisation import OdometryCorrection
from planner.pose import Pose, wrap_angle
from planner.road import FloatArray
from planner.tracker import LineTracker

# TABBY EVO: steering stop, ratio, wheelbase
CURVATURE_PER_M_MAX: Final = math.tan(9.25 / 40.0) / 2.360
# Least speed asked for before the end, or a plan from standstill never starts.
CRAWL_MPS: Final = 0.8
STOP_SHORT_M: Final = 0.3  # rolled from crawling speed to rest
DONE_SPEED_MPS: Final = 0.1
LOST_M: Final = 3.0  # farther off the line, the planner stops instead of hunting for it
LOST_RAD: Final = math.radians(75.0)


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Decision:
    """What the planner asks of the vehicle.

    Attributes:
        speed_mps: Setpoint, never negative.
        curvature_per_m: Setpoint at the rear-axle centre, left positive, within the limit.
        done: The end of the line is reached and the vehicle stands.
        lost: The pose is too far off the line; the speed is zero.
        progress_m: Distance along the line.
        lateral_error_m: Of the pose given, left of the line positive.
    """

    speed_mps: Final[float]
    curvature_per_m: Final[float]
    done: Final[bool]
    lost: Final[bool]
    progress_m: Final[float]
    lateral_error_m: Final[float]

    def __init__(
        self,
        *,
        speed_mps: float,
        curvature_per_m: float,
        done: bool,
        lost: bool,
        progress_m: float,
        lateral_error_m: float,
    ) -> None:
        self.speed_mps = speed_mps
        self.curvature_per_m = curvature_per_m
        self.done = done
        self.lost = lost
        self.progress_m = progress_m
        self.lateral_error_m = lateral_error_m


@dataclass(frozen=True, slots=True, kw_only=True)
class PursuitParams:
    """Tuning.

    Attributes:
        steering_lag_s: From a curvature setpoint to the curvature driven: dead time plus time
            constant of the steering; the line's curvature is previewed by it.
        speed_lag_s: How far ahead a falling speed plan is obeyed.
        lookahead_s: Look-ahead per speed.
        lookahead_m_min: Least look-ahead.
        lookahead_m_max: Largest look-ahead.
        curvature_per_m_max: Largest command to either side.
    """

    steering_lag_s: float = 0.17
    speed_lag_s: float = 0.4
    lookahead_s: float = 2.0
    lookahead_m_min: float = 10.0
    lookahead_m_max: float = 14.0
    curvature_per_m_max: float = CURVATURE_PER_M_MAX

    def __post_init__(self) -> None:
        """Refuse numbers that cannot be meant; names the field."""
        for name in ("lookahead_s", "lookahead_m_min", "lookahead_m_max", "curvature_per_m_max"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must be positive and finite")
        for name in ("steering_lag_s", "speed_lag_s"):
            if not 0.0 <= getattr(self, name) <= 2.0:
                raise ValueError(f"{name} is {getattr(self, name)}, allowed is 0 to 2 s")
        if self.lookahead_m_max < self.lookahead_m_min:
            raise ValueError("lookahead_m_max is below lookahead_m_min")


class PurePursuit:
    """Follows a line once round, from its start to a stop at its end."""

    def __init__(
        self, line: Line, speeds_mps: FloatArray, params: PursuitParams | None = None
    ) -> None:
        """Take the line and the planned speed at each of its points.

        Raises:
            ValueError: If the speeds do not fit the line, or one is negative or not finite.
        """
        speeds = np.asarray(speeds_mps, dtype=np.float64)
        if speeds.shape != line.s_m.shape:
            raise ValueError(f"speeds_mps has shape {speeds.shape}, the line {line.s_m.shape}")
        if not (np.isfinite(speeds).all() and (speeds >= 0.0).all()):
            raise ValueError("speeds_mps must be finite and not negative")
        self._params = params or PursuitParams()
        self._tracker = LineTracker(line)
        self._speeds: list[float] = [*speeds.tolist(), 0.0]  # the end of the line is a stop
        self._step_m = line.step_m
        self._length_m = line.length_m
        self._is_stopping = False

    def decide(
        self, pose: Pose, speed_mps: float, odometry: OdometryCorrection | None = None
    ) -> Decision:
        """Return speed and curvature for the vehicle's pose and measured speed.

        Args:
            pose: Estimate for now.
            speed_mps: Measured.
            odometry: What the localiser has learned (`Localiser.odometry_correction`). The steering
                obeys in terms of what it measures, so the command is given in them. None: its
                measurements are taken as true.

        Raises:
            ValueError: If the pose or the speed is not finite; nothing is remembered of it.
        """
        if not math.isfinite(pose.x_m + pose.y_m + pose.heading_rad + speed_mps):
            raise ValueError(f"{pose} and speed_mps {speed_mps} must be finite")
        params, tracker = self._params, self._tracker
        tracker.advance(pose.x_m, pose.y_m)
        s_m = tracker.progress_m
        speed_mps = max(speed_mps, 0.0)
        lookahead_m = min(
            max(params.lookahead_s * speed_mps, params.lookahead_m_min), params.lookahead_m_max
        )
        on_line = tracker.pose_at(s_m)
        goal = tracker.pose_at(s_m + lookahead_m)
        correction = _arc_to(pose, goal) - _arc_to(on_line, goal)
        preview = tracker.curvature_at(s_m + params.steering_lag_s * speed_mps)
        limit = params.curvature_per_m_max
        wanted = preview + correction
        if odometry is not None:
            wanted = (wanted - odometry.curvature_offset_per_m) / odometry.curvature_scale
        curvature = min(max(wanted, -limit), limit)
        lost = (
            abs(tracker.lateral_m) > LOST_M
            or abs(wrap_angle(pose.heading_rad - on_line.heading_rad)) > LOST_RAD
        )
        if self._length_m - s_m <= STOP_SHORT_M:
            self._is_stopping = True
        return Decision(
            speed_mps=0.0 if lost else self._speed_setpoint(s_m, speed_mps),
            curvature_per_m=curvature,
            done=self._is_stopping and speed_mps < DONE_SPEED_MPS,
            lost=lost,
            progress_m=s_m,
            lateral_error_m=tracker.lateral_m,
        )

    def _speed_setpoint(self, s_m: float, speed_mps: float) -> float:
        if self._is_stopping:
            return 0.0
        ahead_m = s_m + self._params.speed_lag_s * speed_mps
        return max(min(self._planned(s_m), self._planned(ahead_m)), CRAWL_MPS)

    def _planned(self, s_m: float) -> float:
        place = min(max(s_m / self._step_m, 0.0), len(self._speeds) - 1.0)
        index = min(int(place), len(self._speeds) - 2)
        share = place - index
        return self._speeds[index] + share * (self._speeds[index + 1] - self._speeds[index])


def _arc_to(pose: Pose, goal: Pose) -> float:
    """Return the curvature of the arc from the pose, along its heading, to the goal's point."""
    dx, dy = goal.x_m - pose.x_m, goal.y_m - pose.y_m
    across_m = math.cos(pose.heading_rad) * dy - math.sin(pose.heading_rad) * dx
    return 2.0 * across_m / max(dx * dx + dy * dy, 1e-6)
