"""Odometry (UAH 3.4): the pose that the wheels tell since it was last given, and how far it is off.

The way is that of the rear wheel in BRAKE_STATUS, which rolls freely; the turn comes from the
steering wheel (UAH Eq. 13). UAH has an encoder on either rear wheel; on this bus one is heard, and
the steering tells what the other would do. All is of the rear axle's centre.

The error is propagated to first order, after Kelly, "Linearized Error Propagation in Odometry",
Int. J. Robotics Research 23(2), 2004. What is off for a whole drive is a constant of unknown size:
the pose's derivatives by these are carried along, so that their errors add up over the way and not
by its root, and may even out on the way back. What comes and goes is a random walk over the way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dbc.endpoint import SPEC_OF_NAME
from gateway.kinematics import Kinematics
from gateway.poses import GivenPose, OdometryPose
from vehicles.vehicle import Vehicle

FloatArray = NDArray[np.float64]

NS_PER_S: Final = 1e9
ROLLED_NS_MAX: Final = SPEC_OF_NAME["BRAKE_STATUS"].timeout_ns
STEERED_NS_MAX: Final = SPEC_OF_NAME["STEER_STATUS"].timeout_ns
LEFT_WHEEL_TRACKS: Final = 0.5
"""Where the encoder is: so many widths of the track left of the middle."""
LEG_M: Final = 2.0
"""The error is brought forward once in so much way: a chord of it, even in the tightest bend."""
SPEED_STEP_RADPS: Final = 0.1
"""Resolution of the wheel's speed on the bus; a test compares it with the DBC."""
SECOND_ORDER: Final = 0.75
"""A way that is turned by a normal error lies on an arc: half the error's square times the way is
lost along it, whose mean square is this much of the variances' product."""
ROUNDED: Final = 1.0 / math.sqrt(12.0)
"""Standard deviation of what rounding takes, in steps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorSources:
    """Standard deviations: of what is constant over a drive, then of the walks after 1 m."""

    wheel_radius_ratio: float = 0.01
    """Of the radius: a loaded tyre rolls on about 1 % less; UAH rounds 0.287 m by 2 %."""
    rounded_speed_ratio: float = ROUNDED
    """Of the speed's step on the bus: a steady speed is always rounded to the same side."""
    speed_delay_s: float = 0.02
    """The encoder's window, and a cycle until the speed is sent."""
    curvature_ratio: float = 0.03
    """Understeer, which changes with speed (assumption, as in `planner.localisation`)."""
    steering_zero_ratio: float = 0.002
    """Of the steering's range, left after calibration (assumption): 1 deg of TABBY's wheel."""
    curvature_delay_s: float = 0.05
    """Side slip takes some 10 ms per m/s to build up (as in `planner.localisation`)."""
    position_walk_m: float = 0.005
    """Slip that comes and goes (assumption)."""
    heading_walk_rad: float = math.radians(0.1)
    """Side slip and bumps (assumption)."""


ORIGIN: Final = GivenPose(x_m=0.0, y_m=0.0, heading_rad=0.0)
NOWHERE: Final = OdometryPose(
    time_ns=0, speed_mps=math.nan, x_m=math.nan, y_m=math.nan, heading_rad=math.nan,
    way_m=math.nan, covariance=(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan),
)  # fmt: skip


def moved(
    x_m: float, y_m: float, heading_rad: float, way_m: float, turn_rad: float
) -> tuple[float, float, float]:
    """The pose after a short arc: its length, in the direction of its chord."""
    chord_rad = heading_rad + 0.5 * turn_rad
    return (
        x_m + way_m * math.cos(chord_rad),
        y_m + way_m * math.sin(chord_rad),
        heading_rad + turn_rad,
    )


@dataclass(slots=True)
class _Leg:
    """A short way whose error is still to be brought forward."""

    start_x_m: float
    start_y_m: float
    start_mps: float
    way_m: float = 0.0
    turn_rad: float = 0.0
    duration_s: float = 0.0
    swing_radps: float = 0.0
    """Speed times the change of curvature: the turn that a second of delay leaves out."""


@dataclass(slots=True)
class _Motion:
    """Of the rear axle's centre, when it was last measured."""

    time_ns: int
    speed_mps: float
    curvature_per_m: float


class Odometry:
    """Takes in what the bus tells of wheel and steering; answers the pose.

    Args:
        vehicle: Its dimensions, as believed.
        sources: What is off about them and about the measurements.
    """

    def __init__(self, vehicle: Vehicle, sources: ErrorSources | None = None) -> None:
        sources = sources or ErrorSources()
        self._kinematics = Kinematics.of(vehicle.geometry, vehicle.steering)
        self._offset_left_m = LEFT_WHEEL_TRACKS * vehicle.geometry.track_m
        zero_rad = sources.steering_zero_ratio * vehicle.steering.wheel_angle_rad_max
        radius_m = vehicle.geometry.wheel_radius_m
        self._sigmas = np.array([
            sources.wheel_radius_ratio,
            sources.rounded_speed_ratio * SPEED_STEP_RADPS * radius_m,
            sources.speed_delay_s,
            sources.curvature_ratio,
            self._kinematics.curvature_per_m(zero_rad),
            sources.curvature_delay_s,
        ])  # fmt: skip
        walk_m2, walk_rad2 = sources.position_walk_m**2, sources.heading_walk_rad**2
        self._walk_per_m = np.diag([walk_m2, walk_m2, walk_rad2])
        self._steered: tuple[int, float] | None = None
        self._motion: _Motion | None = None
        self.give(ORIGIN)

    def give(self, pose: GivenPose) -> None:
        """The car is here now; from here on its way is added up, and the error begins anew."""
        self._x_m, self._y_m, self._heading_rad = pose.x_m, pose.y_m, pose.heading_rad
        self._way_m = 0.0
        self._is_lost = False
        variance_m2 = pose.position_sigma_m**2
        self._pose_covariance = np.diag([variance_m2, variance_m2, pose.heading_sigma_rad**2])
        self._derivatives = np.zeros((3, len(self._sigmas)))
        self._leg = self._new_leg()

    def steered(self, arrival_ns: int, wheel_angle_rad: float) -> None:
        """STEER_STATUS: the steering wheel's angle, NaN when the ECU has none."""
        self._steered = (arrival_ns, self._kinematics.curvature_per_m(wheel_angle_rad))

    def rolled(self, arrival_ns: int, wheel_radps: float) -> None:
        """BRAKE_STATUS: the rear wheel's speed, NaN when the ECU has none."""
        before, self._motion = self._motion, self._measured(arrival_ns, wheel_radps)
        after = self._motion
        if before is None:
            self._leg = self._new_leg()
            return
        duration_s = (arrival_ns - before.time_ns) / NS_PER_S
        way_m = 0.5 * (before.speed_mps + after.speed_mps) * duration_s
        curvature_per_m = 0.5 * (before.curvature_per_m + after.curvature_per_m)
        if arrival_ns - before.time_ns > ROLLED_NS_MAX or math.isnan(way_m):
            self._is_lost = True
        if self._is_lost or way_m == 0.0:
            return
        turn_rad = way_m * curvature_per_m
        self._x_m, self._y_m, self._heading_rad = moved(
            self._x_m, self._y_m, self._heading_rad, way_m, turn_rad
        )
        self._way_m += abs(way_m)
        leg = self._leg
        leg.way_m += way_m
        leg.turn_rad += turn_rad
        leg.duration_s += duration_s
        leg.swing_radps += way_m / duration_s * (after.curvature_per_m - before.curvature_per_m)
        if abs(leg.way_m) >= LEG_M:
            self._pose_covariance, self._derivatives = self._error_after_leg()
            self._leg = self._new_leg()

    def pose(self, now_ns: int) -> OdometryPose:
        """The pose as last measured, and nothing of what is too long ago."""
        motion = self._motion
        if motion is None or now_ns - motion.time_ns > ROLLED_NS_MAX:
            return NOWHERE
        if self._is_lost:
            return replace(NOWHERE, time_ns=motion.time_ns, speed_mps=motion.speed_mps)
        walked, derivatives = self._error_after_leg()
        by_sources = derivatives * self._sigmas
        total = walked + by_sources @ by_sources.T
        xx, xy, xh, _, yy, yh, _, _, hh = total.ravel().tolist()
        bent_m2 = SECOND_ORDER * (0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)) * hh
        return OdometryPose(
            time_ns=motion.time_ns,
            speed_mps=motion.speed_mps,
            x_m=self._x_m,
            y_m=self._y_m,
            heading_rad=math.remainder(self._heading_rad, 2.0 * math.pi),
            way_m=self._way_m,
            covariance=(xx + bent_m2, xy, yy + bent_m2, xh, yh, hh),
        )

    def _measured(self, arrival_ns: int, wheel_radps: float) -> _Motion:
        curvature_per_m = math.nan
        if self._steered is not None and arrival_ns - self._steered[0] <= STEERED_NS_MAX:
            curvature_per_m = self._steered[1]
        wheel_mps = wheel_radps * self._kinematics.wheel_radius_m
        if wheel_mps == 0.0:  # standing, even without an angle
            return _Motion(arrival_ns, 0.0, 0.0 if math.isnan(curvature_per_m) else curvature_per_m)
        # a wheel left of the middle has the shorter way in a left turn
        speed_mps = wheel_mps / (1.0 - self._offset_left_m * curvature_per_m)
        return _Motion(arrival_ns, speed_mps, curvature_per_m)

    def _new_leg(self) -> _Leg:
        speed_mps = 0.0 if self._motion is None else self._motion.speed_mps
        return _Leg(self._x_m, self._y_m, speed_mps)

    def _error_after_leg(self) -> tuple[FloatArray, FloatArray]:
        """Covariance by start and walks, and the pose's derivatives by the constants, now."""
        leg, motion = self._leg, self._motion
        way_m = leg.way_m
        if way_m == 0.0 or motion is None:
            return self._pose_covariance, self._derivatives
        ahead_m, left_m = self._x_m - leg.start_x_m, self._y_m - leg.start_y_m
        # an error of the heading at the leg's start moves its end across; one that grows over the
        # leg, by half of that
        carried = np.array([[1.0, 0.0, -left_m], [0.0, 1.0, ahead_m], [0.0, 0.0, 1.0]])
        grown = np.array([-0.5 * left_m, 0.5 * ahead_m, 1.0])
        along = np.array([ahead_m / way_m, left_m / way_m, leg.turn_rad / way_m])
        along += leg.turn_rad / way_m * (grown - (0.0, 0.0, 1.0))
        # by each constant: how much farther, and how much more turned beside that, for a unit of it
        farther = np.array([way_m, leg.duration_s, leg.start_mps - motion.speed_mps, 0, 0, 0])
        turned = np.array([0, 0, 0, leg.turn_rad, way_m, -leg.swing_radps])
        derivatives = carried @ self._derivatives + np.outer(along, farther)
        derivatives += np.outer(grown, turned)
        spread = np.array([[1.0, 0.0, grown[0]], [0.0, 1.0, grown[1]], [0.0, 0.0, 1.0]])
        walk = abs(way_m) * (spread @ self._walk_per_m @ spread.T)
        return carried @ self._pose_covariance @ carried.T + walk, derivatives
