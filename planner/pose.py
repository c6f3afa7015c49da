"""Pose of the rear-axle centre in the plane."""

import math
from dataclasses import dataclass
from typing import Final


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Pose:
    """Where the vehicle is.

    Attributes:
        x_m: Rear-axle centre, metres east of the road's origin.
        y_m: Rear-axle centre, metres north of the road's origin.
        heading_rad: Anticlockwise from the x axis; any multiple of a turn is allowed.
    """

    x_m: Final[float]
    y_m: Final[float]
    heading_rad: Final[float]

    def __init__(self, *, x_m: float, y_m: float, heading_rad: float) -> None:
        self.x_m = x_m
        self.y_m = y_m
        self.heading_rad = heading_rad


def wrap_angle(angle_rad: float) -> float:
    """Return the same angle in [-pi, pi]."""
    return math.remainder(angle_rad, 2.0 * math.pi)


def move_along_arc(pose: Pose, distance_m: float, curvature_per_m: float) -> Pose:
    """Return the pose after `distance_m` on a circle of the given curvature (left positive).

    The chord of the arc is exact up to the small-angle series of sin(x)/x (error below 1e-6 for
    turns under 0.3 rad), so that one call may cover a whole planner period.
    """
    turn_rad = distance_m * curvature_per_m
    chord_m = distance_m * (1.0 - turn_rad * turn_rad / 24.0)
    chord_heading_rad = pose.heading_rad + 0.5 * turn_rad
    return Pose(
        x_m=pose.x_m + chord_m * math.cos(chord_heading_rad),
        y_m=pose.y_m + chord_m * math.sin(chord_heading_rad),
        heading_rad=pose.heading_rad + turn_rad,
    )
