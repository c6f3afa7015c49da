"""Cross-track error against hand-worked traces."""

import math

import numpy as np
import pytest

from planner.errors import tracking_errors
from planner.line import Line
from planner.road import FloatArray
from planner.tracker import LineTracker


def circle(radius_m: float) -> Line:
    length_m = math.tau * radius_m
    count = round(length_m / 0.5)
    s_m: FloatArray = np.arange(count, dtype=np.float64) * (length_m / count)
    return Line(
        s_m=s_m,
        x_m=radius_m * np.sin(s_m / radius_m),
        y_m=radius_m - radius_m * np.cos(s_m / radius_m),
        heading_rad=s_m / radius_m,
        curvature_per_m=np.full(count, 1.0 / radius_m),
        length_m=length_m,
    )


def on_circle(
    radius_m: float, centre_m: float, turn_rad: float, count: int = 777
) -> list[list[float]]:
    angles = np.linspace(0.0, turn_rad, count)
    x = radius_m * np.sin(angles)
    y = centre_m - radius_m * np.cos(angles)
    return [x.tolist(), y.tolist()]


@pytest.mark.parametrize("inside_m", [-1.5, -0.3, 0.0, 0.3, 1.5])
def test_parallel_trace_has_its_distance_as_error_left_positive(inside_m: float) -> None:
    errors = tracking_errors(circle(12.0), *on_circle(12.0 - inside_m, 12.0, math.tau))
    assert errors.lateral_m == pytest.approx(np.full(777, inside_m), abs=1e-3)
    assert errors.rmse_m == pytest.approx(abs(inside_m), abs=1e-3)
    assert errors.max_error_m == pytest.approx(abs(inside_m), abs=1e-3)
    expected = np.linspace(0.0, math.tau * 12.0, 777)
    assert errors.progress_m == pytest.approx(expected, abs=2e-3)


def test_rmse_and_maximum_of_a_displaced_circle() -> None:
    # A circle displaced by d has the error d*cos(angle): RMS d/sqrt(2), maximum d.
    x, y = on_circle(30.0, 30.0, math.tau, count=4001)
    errors = tracking_errors(circle(30.0), x, [value + 0.5 for value in y])
    assert errors.rmse_m == pytest.approx(0.5 / math.sqrt(2.0), rel=0.01)
    assert errors.max_error_m == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(
    ("turns", "completed"), [(1.0, True), (0.995, True), (0.9, False), (0.0, False), (1.2, True)]
)
def test_lap_counts_when_its_end_is_reached(turns: float, completed: bool) -> None:
    errors = tracking_errors(circle(30.0), *on_circle(30.0, 30.0, turns * math.tau))
    assert errors.lap_completed is completed


def test_turning_back_to_the_start_is_no_lap() -> None:
    x, y = on_circle(30.0, 30.0, 0.4 * math.tau)
    errors = tracking_errors(circle(30.0), x + x[::-1], y + y[::-1])
    assert not errors.lap_completed
    assert errors.progress_m[-1] == pytest.approx(0.0, abs=1e-3)


def test_progress_counts_on_over_laps() -> None:
    errors = tracking_errors(circle(20.0), *on_circle(20.0, 20.0, 3.0 * math.tau, count=2000))
    assert errors.progress_m[-1] == pytest.approx(3.0 * math.tau * 20.0, abs=0.01)


def test_poses_read_from_the_line_turn_on_over_laps() -> None:
    line = circle(20.0)
    tracker = LineTracker(line)
    for s_m in (0.0, 10.3, line.length_m - 0.1, line.length_m + 5.2, -3.1):
        pose = tracker.pose_at(s_m)
        assert pose.heading_rad == pytest.approx(s_m / 20.0, abs=1e-9)
        assert pose.x_m == pytest.approx(20.0 * math.sin(s_m / 20.0), abs=1e-4)


@pytest.mark.parametrize(
    ("x", "y"), [([], []), ([0.0, 1.0], [0.0]), ([math.nan], [0.0]), ([0.0], [math.inf])]
)
def test_trace_that_is_none_is_refused(x: list[float], y: list[float]) -> None:
    with pytest.raises(ValueError, match="x_m"):
        tracking_errors(circle(20.0), x, y)
