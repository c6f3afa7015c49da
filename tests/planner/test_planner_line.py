"""The drivable line: inside the road, never tighter than asked, refused where there is none."""

import numpy as np
import pytest
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from planner.corridor import _curvature
from planner.line import Line, drivable_line
from planner.quadratic_programme import solve_quadratic_programme
from planner.road import FloatArray, Road, RoadError, open_road


def stadium(radius_m: float, straight_m: float = 120.0, half_width_m: float = 6.0) -> Road:
    """Two straights joined by half circles, without clothoids: curvature jumps on the centre."""
    along = np.arange(0.0, straight_m, 2.0)
    arc = np.arange(0.0, np.pi, 2.0 / radius_m)
    parts = [
        np.column_stack([along, np.full_like(along, -radius_m)]),
        np.column_stack([straight_m + radius_m * np.sin(arc), -radius_m * np.cos(arc)]),
        np.column_stack([straight_m - along, np.full_like(along, radius_m)]),
        np.column_stack([-radius_m * np.sin(arc), radius_m * np.cos(arc)]),
    ]
    xy = np.concatenate(parts)
    steps = np.hypot(*np.diff(xy, axis=0, append=xy[:1]).T)
    xy = xy[steps > 0.5]
    width = np.full(len(xy), half_width_m)
    return Road(center_xy_m=xy, width_right_m=width, width_left_m=width.copy(), name="stadium")


def room_m(road: Road, line: Line) -> FloatArray:
    """Return for each point of the line the free distance to the nearer edge.

    Measured across the spline through the road's centre: between points 5 m apart a straight
    chord would cut 0.3 m off a bend of 10 m radius.
    """
    xy = np.vstack([road.center_xy_m, road.center_xy_m[:1]])
    s_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    spline = CubicSpline(s_m, xy, bc_type="periodic")
    at = np.arange(0.0, s_m[-1], 0.05)
    tangent = spline(at, 1)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    normal /= np.hypot(*normal.T)[:, None]
    points = np.column_stack([line.x_m, line.y_m])
    _, nearest = cKDTree(spline(at)).query(points)
    lateral = ((points - spline(at)[nearest]) * normal[nearest]).sum(axis=1)
    left = np.interp(at, s_m, np.append(road.width_left_m, road.width_left_m[0]))
    right = np.interp(at, s_m, np.append(road.width_right_m, road.width_right_m[0]))
    result: FloatArray = np.minimum(left[nearest] - lateral, right[nearest] + lateral)
    return result


def assert_consistent(line: Line) -> None:
    """Position, heading and curvature have to be derivatives of one another."""
    assert line.step_m == pytest.approx(0.5, abs=0.01)
    dx, dy = (np.roll(a, -1) - np.roll(a, 1) for a in (line.x_m, line.y_m))
    along = np.unwrap(np.arctan2(dy, dx))
    off = np.angle(np.exp(1j * (along - line.heading_rad)))
    assert np.abs(off).max() < 2e-3
    curvature = np.diff(line.heading_rad) / line.step_m
    middle = 0.5 * (line.curvature_per_m[1:] + line.curvature_per_m[:-1])
    assert np.abs(curvature - middle).max() < 2e-3
    assert np.hypot(dx, dy).max() == pytest.approx(2.0 * line.step_m, abs=1e-3)


@pytest.mark.parametrize(("radius_m", "half_width_m"), [(9.0, 6.0), (8.0, 6.0), (11.0, 3.0)])
def test_tight_bends_are_widened_into_the_road_and_curvature_has_no_jump(
    radius_m: float, half_width_m: float
) -> None:
    road = stadium(radius_m, half_width_m=half_width_m)
    line = drivable_line(road)
    assert line.radius_m_min >= 12.0
    assert line.curvature_rate_per_m2_max <= 0.016
    assert room_m(road, line).min() > 0.5 * 1.488 + 0.5 - 0.05
    assert_consistent(line)


def test_drivable_centre_line_is_kept() -> None:
    road = open_road("campus")
    line = drivable_line(road)
    assert room_m(road, line).min() == pytest.approx(1.75, abs=0.01)
    assert_consistent(line)


@pytest.mark.parametrize("name", ["norisring", "oschersleben", "zandvoort"])
def test_circuit_has_a_line_inside_its_edges(name: str) -> None:
    road = open_road(name)
    line = drivable_line(road)
    assert line.radius_m_min >= 12.0
    assert line.curvature_rate_per_m2_max <= 0.008
    assert room_m(road, line).min() > 0.5 * 1.488 + 0.5 - 0.1
    assert_consistent(line)


def test_road_without_a_line_is_refused_with_place_and_radius() -> None:
    with pytest.raises(RoadError) as caught:
        drivable_line(stadium(radius_m=8.0, half_width_m=3.0), radius_m_min=12.0)
    message = str(caught.value)
    assert "\n" not in message and "holds no line of radius 12 m" in message
    for part in ("at s = ", "x = ", "y = ", "the best line found has 9."):
        assert part in message


def test_road_narrower_than_the_vehicle_is_refused_with_the_place() -> None:
    road = stadium(radius_m=30.0)
    width = road.width_left_m.copy()
    width[30] = 0.5
    road = Road(center_xy_m=road.center_xy_m, width_right_m=width, width_left_m=width, name="gate")
    with pytest.raises(RoadError, match=r"'gate' is too narrow: 1\.\d\d m at s = (59|60|61) m"):
        drivable_line(road)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_senseless_numbers_are_refused_by_name(value: float) -> None:
    road = stadium(radius_m=30.0)
    with pytest.raises(ValueError, match="radius_m_min is"):
        drivable_line(road, radius_m_min=value)
    with pytest.raises(ValueError, match="vehicle_width_m is"):
        drivable_line(road, vehicle_width_m=value)
    if value != 0.0:
        with pytest.raises(ValueError, match="margin_m is"):
            drivable_line(road, margin_m=value)


def test_noisy_centre_line_still_gives_a_smooth_line() -> None:
    road = stadium(radius_m=25.0)
    noise = np.random.default_rng(3).normal(0.0, 0.15, road.center_xy_m.shape)
    road = Road(
        center_xy_m=road.center_xy_m + noise,
        width_right_m=road.width_right_m,
        width_left_m=road.width_left_m,
        name="surveyed by hand",
    )
    line = drivable_line(road)
    assert line.radius_m_min >= 12.0 and line.curvature_rate_per_m2_max <= 0.009


def test_curvature_derivative_agrees_with_finite_differences() -> None:
    generator = np.random.default_rng(1)
    angles = np.sort(generator.uniform(0.0, 2.0 * np.pi, 15))
    xy = np.column_stack([20.0 * np.cos(angles), 14.0 * np.sin(angles)])
    normal = np.column_stack([np.cos(angles + 0.3), np.sin(angles + 0.3)])
    base, jacobian, _ = _curvature(xy, normal)
    for index in range(len(xy)):
        moved = xy.copy()
        moved[index] += 1e-6 * normal[index]
        change = (_curvature(moved, normal)[0] - base) / 1e-6
        assert np.allclose(jacobian.toarray()[:, index], change, atol=1e-4)


def test_quadratic_programme_agrees_with_a_hand_worked_one() -> None:
    # Nearest point to (2, 1) with x + y <= 2 and y >= 0.8: (1.2, 0.8).
    constraints = sparse.csc_matrix(np.array([[1.0, 1.0], [0.0, -1.0]]))
    solution = solve_quadratic_programme(
        sparse.identity(2, format="csc"),
        np.array([-2.0, -1.0]),
        constraints,
        np.array([2.0, -0.8]),
    )
    assert solution == pytest.approx([1.2, 0.8], abs=1e-4)
