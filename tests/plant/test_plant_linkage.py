"""A worn linkage between the steering's shaft and the road wheels."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from simulation.plant.linkage import Linkage
from simulation.plant.params import TABBY_EVO, LinkageParams
from tests.plant.conftest import build, feed

WORN = LinkageParams(
    transmission_ratio=0.9, play_rad=math.radians(1.0), dead_zone_rad=math.radians(0.5)
)
RATIO = 40.0


def test_the_wheels_follow_behind_play_and_dead_zone() -> None:
    linkage, found = Linkage(WORN), []
    for driven_deg in (1.4, 1.6, 6.0, 4.1, 3.0, -1.4, -6.0):
        found.append(math.degrees(linkage.follow(math.radians(driven_deg))))
    tight_deg = [0.0, 0.1, 4.5, 4.5, 3.5, 0.0, -4.5]
    assert found == pytest.approx([0.9 * angle_deg for angle_deg in tight_deg], abs=1e-9)


@pytest.mark.parametrize("shaft_deg", [1.0, 4.0])
def test_a_car_turns_by_what_its_linkage_lets_through(shaft_deg: float) -> None:
    car = build(replace(TABBY_EVO, linkage=WORN))
    feed(car, 3.0, throttle=0.2, hold_angle_rad=math.radians(shaft_deg) * RATIO)
    truth = car.truth
    driven_deg = math.degrees(truth.column_angle_rad) / RATIO
    assert driven_deg == pytest.approx(shaft_deg, abs=0.4)
    road_deg = 0.9 * max(0.0, driven_deg - 1.5)
    assert (road_deg > 1.5) == (shaft_deg > 2.0)
    assert math.degrees(truth.road_wheel_angle_rad) == pytest.approx(road_deg, abs=0.05)
    curvature_per_m = truth.yaw_rate_radps / truth.speed_mps
    assert curvature_per_m == pytest.approx(math.tan(math.radians(road_deg)) / 2.36, abs=0.001)
