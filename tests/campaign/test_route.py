"""The road that a campaign's car drives: within what the vehicle can do, and true to the car."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest

from campaign.route import LATERAL_MPS2_MAX, RoadLimits, Route
from vehicles import known_vehicles, load_vehicle

SPAN_S = 0.02
LIMITS = RoadLimits.of(load_vehicle("tabby_evo"))


def follow(seed: int, steps: int, limits: RoadLimits = LIMITS) -> list[tuple[float, float, float]]:
    """Drives exactly along the road at its speed; `(speed, curvature, offset)` of every step."""
    route = Route(np.random.default_rng(seed), limits)
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
@pytest.mark.parametrize("name", known_vehicles())
def test_the_road_stays_within_speed_curvature_and_lateral_acceleration(
    name: str, seed: int
) -> None:
    vehicle = load_vehicle(name)
    limits = RoadLimits.of(vehicle)
    assert limits.speed_mps[0] < limits.speed_mps[1] <= 0.9 * vehicle.traction.speed_mps_max
    assert limits.curvature_per_m_max <= 0.8 * vehicle.curvature_per_m_max
    for speed_mps, curvature_per_m, _ in follow(seed, 10_000, limits):
        assert speed_mps <= limits.speed_mps[1]
        assert abs(curvature_per_m) <= limits.curvature_per_m_max
        assert speed_mps**2 * abs(curvature_per_m) < 1.3 * LATERAL_MPS2_MAX


def test_a_short_car_turns_its_wheels_as_far_as_a_long_one() -> None:
    long, short = load_vehicle("tabby_evo"), load_vehicle("baja_5b")
    bends = [
        RoadLimits.of(car).curvature_per_m_max * car.geometry.wheelbase_m for car in (long, short)
    ]
    assert RoadLimits.of(long).scale == 1.0
    assert bends[0] == pytest.approx(bends[1]) == pytest.approx(0.165, abs=0.001)


@pytest.mark.parametrize("seed", range(5))
def test_a_car_exactly_on_the_road_is_not_beside_it(seed: int) -> None:
    assert max(abs(offset_m) for _, _, offset_m in follow(seed, 10_000)) < 0.02


def test_offsets_are_positive_to_the_left_whatever_the_heading() -> None:
    for heading_rad in (0.0, 1.0, pi, -2.0):
        route = Route(np.random.default_rng(0), LIMITS)
        route.begin(3.0, -2.0, heading_rad)
        left = (3.0 - 0.5 * sin(heading_rad), -2.0 + 0.5 * cos(heading_rad))
        assert route.offset_of(*left) == pytest.approx(0.5)


def test_a_slow_cars_road_bends_as_well() -> None:
    slow = replace(LIMITS, speed_mps=(0.2, 0.4))
    assert max(abs(curvature) for _, curvature, _ in follow(0, 10_000, slow)) > 0.01


def test_a_road_does_not_bend_under_a_standing_car() -> None:
    route = Route(np.random.default_rng(1), LIMITS)
    route.begin(0.0, 0.0, 0.0)
    for _ in range(1000):
        route.go_on(0.0, 0.0, 0.0, 0.0, SPAN_S)
    assert route.curvature_per_m == 0.0 and route.offset_m == 0.0
