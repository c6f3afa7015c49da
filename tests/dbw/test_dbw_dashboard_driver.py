"""The planner behind the dashboard's page: it drives as long as somebody holds a wish."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import cast

import pytest

from dbw.dashboard_controls import ABANDONED_NS, PageDriver, in_bend, steered
from gateway.api import Car
from telemetry.dashboard.control import DEAD_MAN_NS, NO_WISH, Wish
from vehicles import load_vehicle

MS = 1_000_000
VEHICLE = load_vehicle("tabby_evo")
FORWARD = Wish(speed_mps=3.0)


class FakeCar:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.commands: list[tuple[float, float]] = []

    def command(self, *, speed_mps: float, curvature_per_m: float) -> None:
        self.commands.append((speed_mps, curvature_per_m))


@pytest.fixture
def car() -> FakeCar:
    return FakeCar()


@pytest.fixture
def driver(car: FakeCar) -> PageDriver:
    return PageDriver(cast(Car, car), VEHICLE)


def test_a_wish_is_decided_anew_as_long_as_it_is_repeated(car: FakeCar, driver: PageDriver) -> None:
    for now_ns in range(0, 5 * DEAD_MAN_NS, 20 * MS):
        if now_ns % (100 * MS) == 0:
            driver.hold(FORWARD, now_ns)
        driver.decide(3.0, 0.02, now_ns)
    assert car.commands == [(3.0, 0.0)] * (5 * DEAD_MAN_NS // (20 * MS))


def test_a_wish_that_is_neither_repeated_nor_let_go_is_decided_no_more(
    car: FakeCar, driver: PageDriver
) -> None:
    driver.hold(FORWARD, 0)
    driver.decide(3.0, 0.02, ABANDONED_NS)
    assert len(car.commands) == 1
    driver.decide(3.0, 0.02, ABANDONED_NS + 1)
    driver.decide(3.0, 0.02, 10 * ABANDONED_NS)
    assert len(car.commands) == 1, "a silent planner: the nodes stop the car"
    assert ABANDONED_NS > DEAD_MAN_NS, "the dead-man itself comes first"


def test_nothing_held_is_standing_and_may_last(car: FakeCar, driver: PageDriver) -> None:
    driver.hold(FORWARD, 0)
    driver.hold(NO_WISH, 10 * MS)
    driver.decide(3.0, 0.02, 100 * ABANDONED_NS)
    assert car.commands == [(0.0, 0.0)]


def test_the_curvature_changes_no_faster_than_the_monitor_allows(
    car: FakeCar, driver: PageDriver
) -> None:
    sharp = Wish(speed_mps=2.0, curvature_per_m=0.1)
    for number in range(400):
        driver.hold(sharp, number * 20 * MS)
        driver.decide(5.0, 0.02, number * 20 * MS)
    curvatures = [curvature for _, curvature in car.commands]
    step_max = VEHICLE.envelope.lateral_jerk_mps3_max / 5.0**2 * 0.02
    steps = [after - before for before, after in pairwise(curvatures)]
    assert 0.0 < max(steps) < step_max
    assert curvatures[-1] == pytest.approx(0.1)


def test_an_unknown_speed_counts_as_the_fastest(car: FakeCar, driver: PageDriver) -> None:
    driver.hold(Wish(speed_mps=2.0, curvature_per_m=0.1), 0)
    driver.decide(math.nan, 0.02, 0)
    (_, curvature), = car.commands
    assert 0.0 < curvature < 0.01


def test_bends_are_slowed_down_for_and_steps_are_bounded_both_ways() -> None:
    assert in_bend(5.0, 0.0) == 5.0
    assert in_bend(5.0, -0.1) == in_bend(5.0, 0.1) < 5.0
    assert steered(0.0, 1.0, 0.25) == 0.25 and steered(0.0, -1.0, 0.25) == -0.25
    assert steered(0.0, 0.1, 0.25) == 0.1
