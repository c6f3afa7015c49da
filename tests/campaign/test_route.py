"""The road that a campaign's car drives: within what the vehicle can do, and true to the car."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest

from campaign.route import CURVATURE_PER_M_MAX, LATERAL_MPS2_MAX, SPEED_MPS, Route

SPAN_S = 0.02


def follow(seed: int, steps: int) -> list[tuple[float, float, float]]:
    """Drives exactly along the road at its speed; `(speed, curvature, offset)` of every step."""
    route = Route(np.random.default_rng(seed))
    x_m = y_m = heading_rad = speed_mps = 0.0
    route.begin(x_m, y_m, heading_rad)
    rows = []
    for _ in range(steps):
        route.go_on(x_m, y_m, heading_rad, speed_mps, SPAN_S)
        rows.append((speed_mps, route.curvature_per_m, route.offset_m))
        change_mps = min(max(route.speed_mps - speed_mps, -2.0 * SPAN_S), 1.5 * SPAN_S)
        speed_mps += change_mps
        way_m = speed_mps * SPAN_S
        turn_rad = way_m * (route.curvature_per_m + 0.5 * route.curvature_rate_per_ms * SPAN_S)
        x_m += way_m * cos(heading_rad + 0.5 * turn_rad)
        y_m += way_m * sin(heading_rad + 0.5 * turn_rad)
        heading_rad += turn_rad
    return rows


@pytest.mark.parametrize("seed", range(5))
def test_the_road_stays_within_speed_curvature_and_lateral_acceleration(seed: int) -> None:
    for speed_mps, curvature_per_m, _ in follow(seed, 10_000):
        assert speed_mps <= SPEED_MPS[1]
        assert abs(curvature_per_m) <= CURVATURE_PER_M_MAX
        assert speed_mps**2 * abs(curvature_per_m) < 1.3 * LATERAL_MPS2_MAX


@pytest.mark.parametrize("seed", range(5))
def test_a_car_exactly_on_the_road_is_not_beside_it(seed: int) -> None:
    assert max(abs(offset_m) for _, _, offset_m in follow(seed, 10_000)) < 0.02


def test_offsets_are_positive_to_the_left_whatever_the_heading() -> None:
    for heading_rad in (0.0, 1.0, pi, -2.0):
        route = Route(np.random.default_rng(0))
        route.begin(3.0, -2.0, heading_rad)
        left = (3.0 - 0.5 * sin(heading_rad), -2.0 + 0.5 * cos(heading_rad))
        assert route.offset_of(*left) == pytest.approx(0.5)


def test_a_road_does_not_bend_under_a_standing_car() -> None:
    route = Route(np.random.default_rng(1))
    route.begin(0.0, 0.0, 0.0)
    for _ in range(1000):
        route.go_on(0.0, 0.0, 0.0, 0.0, SPAN_S)
    assert route.curvature_per_m == 0.0 and route.offset_m == 0.0
