"""The best line in a road's width: a sequence of quadratic programmes over lateral offsets.

Least curvature, least curvature rate and least distance from the middle, subject to the road's
edges and to bounds on curvature and its rate: the minimum-curvature line of Heilmeier et al.,
Vehicle System Dynamics 58(10), 2020, with the curvature bound added and, since this vehicle does
not race, with a pull to the middle. Each programme linearises curvature about the last line.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from planner.quadratic_programme import solve_quadratic_programme
from planner.road import FloatArray, Road, RoadError

KNOTS_MAX = 4000
NORMAL_SMOOTHING_M = 5.0
RELINEARISATIONS_MAX = 12
CONVERGED_M = 0.02
TRUST_M = 2.0  # largest change of an offset per linearisation
# Price of breaking a bound by its whole value, against a least-squares cost of order 1. The linear
# part makes the bound exact where it can be held, the square spreads what cannot over the bend, so
# that a refusal names about the widest radius the road has.
VIOLATION_PRICE = 30.0
VIOLATION_PRICE_SQUARED = 3e3
RATE_PRICE_SHARE = 0.1  # the curvature rate gives way before the curvature does
MIDDLE_WEIGHT = 0.02  # of standing at the edge, against turning at the bound
NEAR_BOUND = 0.3  # share of a bound from which on it is watched
INTERIOR_M = 1e-4  # room for the solver where the road is exactly as wide as needed
SIDEWAYS_SHARE_MAX = 0.7  # of the local radius: keeps neighbouring normals from crossing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corridor:
    """Where the vehicle's reference point may be: knots, directions and offsets to the left."""

    xy_m: FloatArray
    normal: FloatArray
    offset_m_min: FloatArray
    offset_m_max: FloatArray


def corridor_of(road: Road, half_m: float, knot_step_m: float) -> Corridor:
    """Return the corridor of a vehicle that needs `half_m` to either side of its reference point.

    Raises:
        RoadError: If the road is too narrow for it; names the place.
    """
    closed = np.vstack([road.center_xy_m, road.center_xy_m[:1]])
    chord_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    count = min(KNOTS_MAX, max(24, round(chord_m[-1] / knot_step_m)))
    step_m = chord_m[-1] / count
    at = np.arange(count) * step_m
    xy_m = CubicSpline(chord_m, closed, bc_type="periodic")(at)
    smooth = gaussian_filter1d(xy_m, NORMAL_SMOOTHING_M / step_m, axis=0, mode="wrap")
    tangent = np.roll(smooth, -1, axis=0) - np.roll(smooth, 1, axis=0)
    spacing_m = np.hypot(*tangent.T)
    tangent /= spacing_m[:, None]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    angle = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    turn = np.roll(angle, -1) - np.roll(angle, 1)
    bend = (np.mod(turn + np.pi, 2 * np.pi) - np.pi) / spacing_m
    inside_m = SIDEWAYS_SHARE_MAX / np.maximum(np.abs(bend), 1e-6)
    left_m = np.interp(at, chord_m, np.append(road.width_left_m, road.width_left_m[0]))
    right_m = np.interp(at, chord_m, np.append(road.width_right_m, road.width_right_m[0]))
    narrowest = int((left_m + right_m).argmin())
    if left_m[narrowest] + right_m[narrowest] < 2.0 * half_m:
        x_m, y_m = xy_m[narrowest]
        raise RoadError(
            f"road {road.name!r} is too narrow: {left_m[narrowest] + right_m[narrowest]:.2f} m at "
            f"s = {at[narrowest]:.0f} m (x = {x_m:.1f}, y = {y_m:.1f}), "
            f"vehicle and margins need {2.0 * half_m:.2f} m"
        )
    # Inside a bend the offset ends before the normals of neighbouring knots cross.
    upper_m, lower_m = left_m - half_m, half_m - right_m
    inside_of_left_m = np.minimum(upper_m, np.maximum(inside_m, lower_m))
    inside_of_right_m = np.maximum(lower_m, np.minimum(-inside_m, upper_m))
    return Corridor(
        xy_m=xy_m,
        normal=normal,
        offset_m_min=np.where(bend < 0.0, inside_of_right_m, lower_m),
        offset_m_max=np.where(bend > 0.0, inside_of_left_m, upper_m),
    )


def knots_of_best_line(corridor: Corridor, curvature_max: float, rate_max: float) -> FloatArray:
    """Return knots of the best line in the corridor; bounds are broken only where they must be."""
    lower, upper = corridor.offset_m_min, corridor.offset_m_max
    middle = 0.5 * (lower + upper)
    half = np.maximum(0.5 * (upper - lower), 0.05)
    offset = np.clip(0.0, lower, upper)
    for _ in range(RELINEARISATIONS_MAX):
        xy_m = corridor.xy_m + offset[:, None] * corridor.normal
        curvature, jacobian, spacing_m = _curvature(xy_m, corridor.normal)
        difference = sparse.diags(1.0 / spacing_m) @ _forward_difference(len(offset))
        change = _best_change(
            rows=sparse.vstack(
                [jacobian / curvature_max, difference @ jacobian / rate_max]
            ).tocsr(),
            values=np.concatenate([curvature / curvature_max, difference @ curvature / rate_max]),
            sideways=(offset - middle) / half,
            half_m=half,
            change_m_min=np.maximum(lower - offset, -TRUST_M),
            change_m_max=np.minimum(upper - offset, TRUST_M),
        )
        offset = np.clip(offset + change, lower, upper)
        if np.abs(change).max() < CONVERGED_M:
            break
    xy: FloatArray = corridor.xy_m + offset[:, None] * corridor.normal
    return xy


def _forward_difference(count: int) -> sparse.csr_matrix:
    index = np.arange(count)
    rows = np.concatenate([index, index])
    columns = np.concatenate([index, (index + 1) % count])
    values = np.concatenate([-np.ones(count), np.ones(count)])
    return sparse.csr_matrix((values, (rows, columns)), shape=(count, count))


def _curvature(
    xy_m: FloatArray, normal: FloatArray
) -> tuple[FloatArray, sparse.csr_matrix, FloatArray]:
    """Return curvature at the knots, its derivative by the offsets, and the knots' spacing.

    Curvature is the turn from edge to edge over the mean length of the two edges.
    """
    count = len(xy_m)
    edge = np.roll(xy_m, -1, axis=0) - xy_m  # edge i leads from knot i to knot i + 1
    length = np.hypot(*edge.T)
    angle = np.arctan2(edge[:, 1], edge[:, 0])
    turn = np.mod(angle - np.roll(angle, 1) + np.pi, 2.0 * np.pi) - np.pi
    mean = 0.5 * (length + np.roll(length, 1))
    curvature = turn / mean
    following = np.roll(normal, -1, axis=0)

    def across(vector: FloatArray) -> FloatArray:
        result: FloatArray = (edge[:, 0] * vector[:, 1] - edge[:, 1] * vector[:, 0]) / length**2
        return result

    def along(vector: FloatArray) -> FloatArray:
        result: FloatArray = (edge * vector).sum(axis=1) / length
        return result

    # Each edge's angle and length by its own knot's offset and by the next knot's.
    angle_own, angle_next = -across(normal), across(following)
    length_own, length_next = -along(normal), along(following)
    half_curvature = 0.5 * curvature
    by_previous = (-np.roll(angle_own, 1) - half_curvature * np.roll(length_own, 1)) / mean
    by_own = (
        angle_own - np.roll(angle_next, 1) - half_curvature * (length_own + np.roll(length_next, 1))
    ) / mean
    by_following = (angle_next - half_curvature * length_next) / mean
    index = np.arange(count)
    rows = np.concatenate([index, index, index])
    columns = np.concatenate([(index - 1) % count, index, (index + 1) % count])
    data = np.concatenate([by_previous, by_own, by_following])
    return curvature, sparse.csr_matrix((data, (rows, columns)), shape=(count, count)), length


def _best_change(
    *,
    rows: sparse.csr_matrix,
    values: FloatArray,
    sideways: FloatArray,
    half_m: FloatArray,
    change_m_min: FloatArray,
    change_m_max: FloatArray,
) -> FloatArray:
    """Solve one linearisation: `values + rows @ change` small and, at a price, within +-1.

    Rows far from their bound are left out; a later linearisation takes them in when they near it.
    """
    count = len(half_m)
    near = np.flatnonzero(np.abs(values) > NEAR_BOUND)
    excess = sparse.identity(len(near), format="csr")
    close = rows[near]
    none = sparse.csr_matrix((count, len(near)))
    unit = sparse.identity(count, format="csr")
    constraints = sparse.bmat(
        [
            [unit, none],
            [-unit, none],
            [close, -excess],
            [-close, -excess],
            [None, -excess],
        ],
        format="csc",
    )
    bounds = np.concatenate(
        [
            change_m_max + INTERIOR_M,
            INTERIOR_M - change_m_min,
            1.0 - values[near],
            1.0 + values[near],
            np.zeros(len(near)),
        ]
    )
    pull = MIDDLE_WEIGHT / half_m
    price = np.where(near < count, 1.0, RATE_PRICE_SHARE)  # curvature rows stand first
    hessian = sparse.block_diag(
        [
            rows.T @ rows + sparse.diags(pull / half_m),
            sparse.diags(VIOLATION_PRICE_SQUARED * price),
        ],
        format="csc",
    )
    gradient = np.concatenate([rows.T @ values + pull * sideways, VIOLATION_PRICE * price])
    return solve_quadratic_programme(hessian, gradient, constraints, bounds)[:count]
