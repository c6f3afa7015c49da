"""A pose by the car's wheels as a planner reads it, and one as a planner gives it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gateway.commands import checked

PLACE_M_MAX = 1e7
"""UTM's largest northing."""
HEADING_RAD_MAX = 2000.0 * math.pi
"""A thousand turns: what a planner that does not wrap may have come to."""
POSITION_SIGMA_M_MAX = 1e4


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryPose:
    """The car's pose by its wheels; NaN while it is not known.

    That is before the first BRAKE_STATUS, while the frames are late or carry no value, and after
    that until a planner gives the pose again: nobody has measured the way between.
    """

    time_ns: int
    """Arrival of the newest measurement, on the link's clock."""
    speed_mps: float
    """Of the rear axle's centre, by the rear wheel; known again as soon as the frames are."""
    x_m: float
    """Rear axle's centre, in the frame of the pose given last; until then of the start."""
    y_m: float
    heading_rad: float
    """Course of the rear axle from x towards y, in [-pi, pi]."""
    way_m: float
    """Since the pose was given; backwards counts as well."""
    covariance: tuple[float, float, float, float, float, float]
    """xx, xy, yy in m2; x-heading, y-heading in m rad; heading-heading in rad2."""

    @property
    def position_sigma_m(self) -> float:
        """Standard deviation in the worst direction."""
        xx, xy, yy = self.covariance[:3]
        return math.sqrt(0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy))

    @property
    def heading_sigma_rad(self) -> float:
        """Standard deviation of the heading."""
        return math.sqrt(self.covariance[5])


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenPose:
    """A pose known from elsewhere, and its standard deviations."""

    x_m: float
    y_m: float
    heading_rad: float
    position_sigma_m: float = 0.0
    """Of x and of y."""
    heading_sigma_rad: float = 0.0


def given_pose(
    x_m: object,
    y_m: object,
    heading_rad: object,
    position_sigma_m: object,
    heading_sigma_rad: object,
) -> GivenPose:
    """A pose to go on from.

    Raises:
        TypeError: A value that is no number.
        CommandError: NaN, infinite or out of range.
    """
    return GivenPose(
        x_m=checked("x_m", x_m, -PLACE_M_MAX, PLACE_M_MAX, "m"),
        y_m=checked("y_m", y_m, -PLACE_M_MAX, PLACE_M_MAX, "m"),
        heading_rad=checked("heading_rad", heading_rad, -HEADING_RAD_MAX, HEADING_RAD_MAX, "rad"),
        position_sigma_m=checked(
            "position_sigma_m", position_sigma_m, 0.0, POSITION_SIGMA_M_MAX, "m"
        ),
        heading_sigma_rad=checked("heading_sigma_rad", heading_sigma_rad, 0.0, math.pi, "rad"),
    )
