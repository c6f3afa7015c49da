"""The campus road is the path UAH describes, and a road one could build."""

import numpy as np
import pytest

from planner.campus import build_campus
from planner.line import Line, drivable_line


@pytest.fixture(scope="module")
def line() -> Line:
    return drivable_line(build_campus())


def test_loop_measures_800_m_and_turns_once(line: Line) -> None:
    assert line.length_m == pytest.approx(800.0, abs=0.05)
    turn = line.heading_rad[-1] - line.heading_rad[0]
    assert turn == pytest.approx(2.0 * np.pi, abs=0.02)


def test_loop_closes_with_one_ordinary_step() -> None:
    xy = build_campus().center_xy_m
    steps = np.hypot(*np.diff(xy, axis=0, append=xy[:1]).T)
    assert steps.min() > 0.9 and steps.max() < 1.1


def test_two_roundabouts_are_driven_by_more_than_half_a_turn(line: Line) -> None:
    circling = line.curvature_per_m > 1.0 / 17.0
    starts = np.flatnonzero(circling & ~np.roll(circling, 1))
    turns = []
    for start in starts:
        length = int(np.argmin(np.roll(circling, -start)))
        turns.append(line.curvature_per_m[start : start + length].sum() * line.step_m)
    assert len(turns) == 2
    assert all(np.pi < turn < 2.0 * np.pi for turn in turns)


def test_approach_and_exit_bend_the_other_way(line: Line) -> None:
    assert line.curvature_per_m.min() == pytest.approx(-1.0 / 30.0, rel=0.02)


def test_radius_stays_above_12_m_and_clothoids_join_it(line: Line) -> None:
    assert line.radius_m_min == pytest.approx(13.0, abs=0.05)
    # From a straight to the tighter circle over 8 m would be 0.0096; a jump would be 0.15.
    assert line.curvature_rate_per_m2_max < 0.0096


def test_start_lies_on_a_straight_heading_east(line: Line) -> None:
    assert np.abs(line.curvature_per_m[:60]).max() < 1e-3
    assert line.heading_rad[0] == pytest.approx(0.0, abs=1e-6)


def test_carriageways_do_not_touch() -> None:
    road = build_campus()
    xy = road.center_xy_m
    count = len(xy)
    gaps = np.hypot(*(xy[:, None, :] - xy[None, :, :]).transpose(2, 0, 1))
    apart = np.abs(np.arange(count)[:, None] - np.arange(count)[None, :])
    apart = np.minimum(apart, count - apart)
    half = road.width_left_m
    elsewhere = apart > 20
    assert np.all((gaps - half[:, None] - half[None, :])[elsewhere] > 0.5)


def test_lane_is_3_5_m_wide_and_the_circle_5_m() -> None:
    road = build_campus()
    width = road.width_left_m + road.width_right_m
    assert width.min() == pytest.approx(3.5) and width.max() == pytest.approx(5.0)
    assert np.abs(np.diff(width, append=width[:1])).max() < 0.1


def test_same_road_every_time() -> None:
    assert np.array_equal(build_campus().center_xy_m, build_campus().center_xy_m)
