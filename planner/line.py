"""The line to drive: smooth, inside the road, and never tighter than the vehicle can steer.

The centre line is kept where a road's centre is drivable as it stands (UAH puts its waypoints in
the middle of the lanes). Otherwise the line is looked for in the road's width (`corridor`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from planner.corridor import corridor_of, knots_of_best_line
from planner.pose import Pose
from planner.road import FloatArray, Road, RoadError

STEP_M = 0.5
# Distance of the knots, and relief of the curvature rate. The spline between knots is tighter than
# the knots, by half a percent as a rule and by 4 % at 2.5 m where a clothoid ends in a bend as wide
# as the road. Twice the rate, 0.016 /m2, is still steerable at the 4.9 m/s of a 12 m bend.
TRIES = ((2.5, 1.0), (1.25, 2.0))
RADIUS_RESERVE = 1.02
CLOSE_SHARE = 0.9  # of the radius asked for: below it no finer try will find it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """A closed line at equal steps; arrays of shape (N,), the first point not repeated.

    Attributes:
        s_m: Distance from the start along the line.
        x_m: Position.
        y_m: Position.
        heading_rad: Direction of travel, continuous (no jump by a turn) from the start on.
        curvature_per_m: Left positive.
        length_m: Whole loop.
        closed: Always true.
    """

    s_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    curvature_per_m: FloatArray
    length_m: float
    closed: bool = True

    @property
    def step_m(self) -> float:
        """Distance between neighbouring points."""
        return self.length_m / len(self.s_m)

    @property
    def start(self) -> Pose:
        """The pose at s = 0."""
        return Pose(
            x_m=float(self.x_m[0]),
            y_m=float(self.y_m[0]),
            heading_rad=float(self.heading_rad[0]),
        )

    @property
    def radius_m_min(self) -> float:
        """Smallest radius anywhere on the line."""
        return float(1.0 / np.abs(self.curvature_per_m).max())

    @property
    def curvature_rate_per_m2_max(self) -> float:
        """Largest change of curvature per metre driven."""
        steps = np.diff(self.curvature_per_m, append=self.curvature_per_m[:1])
        return float(np.abs(steps).max() / self.step_m)


def drivable_line(
    road: Road,
    radius_m_min: float = 12.0,
    margin_m: float = 0.5,
    vehicle_width_m: float = 1.488,
    curvature_rate_per_m2_max: float = 0.008,
) -> Line:
    """Return a smooth closed line on the road that the vehicle can steer.

    Args:
        road: The road.
        radius_m_min: The line is never tighter. TABBY EVO steers 10.0 m; 12 m leaves reserve.
        margin_m: Kept free between the vehicle's side at the rear axle and the road's edge. The
            front corners swing out by about 0.3 m at 12 m radius; the rest is for tracking.
        vehicle_width_m: Width of the body.
        curvature_rate_per_m2_max: Aimed at, and given up where the radius cannot be had with it.
            At 25 km/h 0.008 /m2 turns TABBY EVO's road wheels at 0.13 rad/s, 60 % of what its
            steering motor can do.

    Raises:
        RoadError: If the road is too narrow or holds no such line; one line with the place
            (s in m along the centre line or the line, x, y) and the radius reached.
        ValueError: If a number is not positive and finite.
    """
    for name, value in (
        ("radius_m_min", radius_m_min),
        ("vehicle_width_m", vehicle_width_m),
        ("curvature_rate_per_m2_max", curvature_rate_per_m2_max),
    ):
        if not 0.0 < value < float("inf"):
            raise ValueError(f"{name} is {value}, a positive finite number is needed")
    if not 0.0 <= margin_m < float("inf"):
        raise ValueError(f"margin_m is {margin_m}, zero or more is needed")
    half_m = 0.5 * vehicle_width_m + margin_m
    centre = _line_through(road.center_xy_m)
    free_m = np.minimum(road.width_left_m, road.width_right_m) - half_m
    if (
        free_m.min() >= 0.0
        and centre.radius_m_min >= radius_m_min
        and centre.curvature_rate_per_m2_max <= curvature_rate_per_m2_max
    ):
        return centre
    best = None
    for knot_step_m, relief in TRIES:
        knots_xy_m = knots_of_best_line(
            corridor_of(road, half_m, knot_step_m),
            1.0 / (RADIUS_RESERVE * radius_m_min),
            relief * curvature_rate_per_m2_max,
        )
        line = _line_through(knots_xy_m)
        if line.radius_m_min >= radius_m_min:
            return line
        if best is None or line.radius_m_min > best.radius_m_min:
            best = line
        if best.radius_m_min < CLOSE_SHARE * radius_m_min:
            break
    assert best is not None
    worst = int(np.abs(best.curvature_per_m).argmax())
    raise RoadError(
        f"road {road.name!r} holds no line of radius {radius_m_min:g} m with {margin_m:g} m "
        f"margin: at s = {best.s_m[worst]:.0f} m (x = {best.x_m[worst]:.1f}, "
        f"y = {best.y_m[worst]:.1f}) the best line found has {best.radius_m_min:.2f} m"
    )


def _line_through(xy_m: FloatArray) -> Line:
    """Return the periodic cubic spline through the points, at equal steps of about 0.5 m."""
    closed = np.vstack([xy_m, xy_m[:1]])
    chord_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    spline = CubicSpline(chord_m, closed, bc_type="periodic")
    fine = np.linspace(0.0, chord_m[-1], 8 * max(len(xy_m), int(chord_m[-1] / STEP_M)) + 1)
    lengths_m = np.hypot(*np.diff(spline(fine), axis=0).T)
    s_fine_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    length_m = float(s_fine_m[-1])
    count = max(4, round(length_m / STEP_M))
    s_m: FloatArray = np.arange(count, dtype=np.float64) * (length_m / count)
    at = np.interp(s_m, s_fine_m, fine)
    x_m, y_m = spline(at).T
    dx, dy = spline(at, 1).T
    ddx, ddy = spline(at, 2).T
    return Line(
        s_m=s_m,
        x_m=x_m,
        y_m=y_m,
        heading_rad=np.unwrap(np.arctan2(dy, dx)),
        curvature_per_m=(dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3,
        length_m=length_m,
    )
