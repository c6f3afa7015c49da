"""The campus road: a closed drive of 800 m with two roundabouts, after UAH section 5.2, Fig. 27.

UAH publishes no coordinates: about 800 m, two roundabouts, up to 25 km/h, back to the start. This
road is a street with an S-bend and a median, right-hand traffic, and a roundabout at either end,
driven anticlockwise by well over half a turn, so that entry and exit bend the other way. Every
curvature is joined to the next by a clothoid, and the entry angle and the street's length are
solved for, so that the loop closes and measures 800 m.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from planner.road import CAMPUS, FloatArray, Road

LENGTH_M = 800.0
LANE_OFFSET_M = 2.75  # lane centre from the street's axis: 3.5 m lanes, 2 m median
LANE_WIDTH_M = 3.5
CIRCLE_WIDTH_M = 5.0
ENTRY_RADIUS_M = 30.0  # entry and exit bends
RADIUS_WEST_M = 13.0
RADIUS_EAST_M = 16.0
CLOTHOID_ENTRY_M = 12.0  # from the straight into the entry bend
CLOTHOID_CIRCLE_M = 16.0  # from the entry bend (right) through zero into the circle (left)
S_BEND_RADIUS_M = 60.0
S_BEND_CLOTHOID_M = 20.0
S_BEND_ANGLE_RAD = math.radians(32.0)  # turned one way, then back
STRAIGHT_EAST_M = 35.0
START_OFFSET_M = 20.0  # from the west roundabout's exit to the start
STEP_M = 1.0

# The part of the entry clothoid that has the circle's sign has to be 8 m at least (design), and
# TABBY EVO must be able to steer the tighter circle.
_CIRCLE_SHARE = (1 / RADIUS_WEST_M) / (1 / RADIUS_WEST_M + 1 / ENTRY_RADIUS_M)
assert CLOTHOID_CIRCLE_M * _CIRCLE_SHARE >= 8.0
assert min(RADIUS_WEST_M, RADIUS_EAST_M) >= 12.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Piece:
    """A stretch whose curvature runs linearly: straight, arc or clothoid."""

    length_m: float
    curvature_start_per_m: float
    curvature_end_per_m: float

    @property
    def turn_rad(self) -> float:
        return 0.5 * self.length_m * (self.curvature_start_per_m + self.curvature_end_per_m)


def build_campus() -> Road:
    """Return the campus road; the same points every time.

    Lanes are 3.5 m wide and the roundabouts' carriageway 5 m. The road starts on the street's
    straight, heading east.
    """
    circle_west = _roundabout(RADIUS_WEST_M)
    circle_east = _roundabout(RADIUS_EAST_M)
    circles_m = sum(piece.length_m for piece in (*circle_west, *circle_east))

    def missing_length_m(straight_m: float) -> float:
        return 2.0 * _axis_length_m(straight_m) + circles_m - LENGTH_M

    # The S-bend turns as much one way as the other: either lane is as long as the axis.
    straight_west_m = float(brentq(missing_length_m, 1.0, LENGTH_M, xtol=1e-12))
    axis_xy_m, axis_heading_rad = _trace(_street_axis(straight_west_m))
    normal = np.column_stack([-np.sin(axis_heading_rad), np.cos(axis_heading_rad)])
    outward = axis_xy_m - LANE_OFFSET_M * normal
    homeward = (axis_xy_m + LANE_OFFSET_M * normal)[::-1]
    east, east_end = _placed(circle_east, outward[-1], float(axis_heading_rad[-1]))
    west, west_end = _placed(circle_west, homeward[-1], float(axis_heading_rad[0]) + math.pi)
    assert np.hypot(*(east_end - homeward[0])) < 1e-9, "east roundabout does not close"
    assert np.hypot(*(west_end - outward[0])) < 1e-9, "west roundabout does not close"
    parts = [outward[:-1], east[:-1], homeward[:-1], west[:-1]]
    is_circle = np.concatenate(
        [np.full(len(part), index % 2 == 1) for index, part in enumerate(parts)]
    )
    start = -round(START_OFFSET_M / STEP_M)
    width_m = _blended_width_m(is_circle)
    half_m = np.roll(0.5 * width_m, start)
    return Road(
        center_xy_m=np.roll(np.concatenate(parts), start, axis=0),
        width_right_m=half_m,
        width_left_m=half_m.copy(),
        name=CAMPUS,
    )


def _street_axis(straight_west_m: float) -> list[_Piece]:
    bend = 1.0 / S_BEND_RADIUS_M
    arc_m = S_BEND_ANGLE_RAD / bend - S_BEND_CLOTHOID_M
    left = _bend(bend, S_BEND_CLOTHOID_M, arc_m)
    right = _bend(-bend, S_BEND_CLOTHOID_M, arc_m)
    return [_straight(straight_west_m), *left, *right, _straight(STRAIGHT_EAST_M)]


def _axis_length_m(straight_west_m: float) -> float:
    return sum(piece.length_m for piece in _street_axis(straight_west_m))


def _straight(length_m: float) -> _Piece:
    return _Piece(length_m=length_m, curvature_start_per_m=0.0, curvature_end_per_m=0.0)


def _ramp(length_m: float, start_per_m: float, end_per_m: float) -> _Piece:
    return _Piece(
        length_m=length_m, curvature_start_per_m=start_per_m, curvature_end_per_m=end_per_m
    )


def _bend(curvature_per_m: float, clothoid_m: float, arc_m: float) -> list[_Piece]:
    assert arc_m >= 0.0
    return [
        _ramp(clothoid_m, 0.0, curvature_per_m),
        _ramp(arc_m, curvature_per_m, curvature_per_m),
        _ramp(clothoid_m, curvature_per_m, 0.0),
    ]


def _roundabout(radius_m: float) -> list[_Piece]:
    """Return entry, circle and exit that lead from one lane into the opposite one."""

    def lateral_miss_m(entry_arc_m: float) -> float:
        xy_m, _ = _trace(_roundabout_pieces(radius_m, entry_arc_m))
        return float(xy_m[-1, 1]) - 2.0 * LANE_OFFSET_M

    entry_arc_m = float(brentq(lateral_miss_m, 1.0, ENTRY_RADIUS_M, xtol=1e-13))
    return _roundabout_pieces(radius_m, entry_arc_m)


def _roundabout_pieces(radius_m: float, entry_arc_m: float) -> list[_Piece]:
    circle, entry = 1.0 / radius_m, -1.0 / ENTRY_RADIUS_M
    approach = [
        _ramp(CLOTHOID_ENTRY_M, 0.0, entry),
        _ramp(entry_arc_m, entry, entry),
        _ramp(CLOTHOID_CIRCLE_M, entry, circle),
    ]
    rest_rad = math.pi - 2.0 * sum(piece.turn_rad for piece in approach)
    departure = [
        _ramp(piece.length_m, piece.curvature_end_per_m, piece.curvature_start_per_m)
        for piece in reversed(approach)
    ]
    return [*approach, _ramp(rest_rad / circle, circle, circle), *departure]


def _trace(pieces: list[_Piece]) -> tuple[FloatArray, FloatArray]:
    """Integrate pieces from the origin along x: points about STEP_M apart and their headings."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    position, heading_rad = 0.0 + 0.0j, 0.0
    positions, headings = [position], [heading_rad]
    for piece in pieces:
        count = max(1, round(piece.length_m / STEP_M))
        step_m = piece.length_m / count
        slope = (piece.curvature_end_per_m - piece.curvature_start_per_m) / piece.length_m
        for index in range(count):
            start_per_m = piece.curvature_start_per_m + slope * index * step_m
            s_m = 0.5 * step_m * (nodes + 1.0)
            angles = heading_rad + start_per_m * s_m + 0.5 * slope * s_m**2
            position += 0.5 * step_m * complex(np.sum(weights * np.exp(1j * angles)))
            heading_rad += start_per_m * step_m + 0.5 * slope * step_m**2
            positions.append(position)
            headings.append(heading_rad)
    points = np.array(positions)
    return np.column_stack([points.real, points.imag]), np.array(headings)


def _placed(
    pieces: list[_Piece], start_xy_m: FloatArray, heading_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Return the pieces' points from the given start, and their end."""
    xy_m, _ = _trace(pieces)
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    placed = start_xy_m + xy_m @ np.array([[cos, sin], [-sin, cos]])
    return placed, placed[-1]


def _blended_width_m(is_circle: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> FloatArray:
    """Return the width along the loop, running from lane to circle over the entry bend."""
    blend_points = round((CLOTHOID_ENTRY_M + CLOTHOID_CIRCLE_M) / STEP_M)
    count = len(is_circle)
    lane_index = np.flatnonzero(~is_circle)
    gaps = np.abs(np.arange(count)[:, None] - lane_index[None, :])
    distance = np.minimum(gaps, count - gaps).min(axis=1)
    share = np.clip(distance / blend_points, 0.0, 1.0)
    width: FloatArray = LANE_WIDTH_M + (CIRCLE_WIDTH_M - LANE_WIDTH_M) * share
    return width
