"""The numbers of the papers' plants and boards are what the fits find."""

from __future__ import annotations

import pytest

from experiments.response import StepFigures
from experiments.search import tell
from experiments.uah.fit import LOOPS, NEVER, WAIT, Loop
from experiments.uwa.fit import PID

pytestmark = pytest.mark.whole_car


def figures(settling_s: float, error: float = 0.0) -> StepFigures:
    return StepFigures(dead_time_s=0.1, rise_s=1.0, settling_s=settling_s, overshoot_percent=4.0,
                       steady_error=error)  # fmt: skip


def test_a_walk_goes_to_the_better_neighbour_and_ends_where_there_is_none() -> None:
    loop = Loop(
        start={"a": 1.0, WAIT: 50e6}, steps={"a": 1.0, WAIT: 10e6}, pinned={}, highest={WAIT: 90e6},
        figures_of=lambda point: [
            (figures(10.0), figures(10.0 + abs(point["a"] - 3.0) + abs(point[WAIT] - 70e6) * 1e-8))
        ],
    )  # fmt: skip
    points = [point for point, _ in loop.walk(loop.start)]
    assert points[0] == loop.start and points[-1] == {"a": 3.0, WAIT: 70e6}
    assert {"a": 0.0, WAIT: 50e6} not in list(loop.neighbours(loop.start))
    assert {"a": 1.0, WAIT: 100e6} not in list(loop.neighbours({"a": 1.0, WAIT: 90e6}))
    told = list(tell("it", loop))
    assert len(told) == len(points) and all(line.startswith("it: ") for line in told)
    assert told[-1].endswith("a 3, wait_ns 7e+07")


def test_a_missed_figure_counts_more_than_any_sum_and_no_response_most() -> None:
    def score(found: StepFigures) -> tuple[int, float]:
        return Loop(start={}, steps={}, pinned={},
                    figures_of=lambda _: [(figures(10.0), found)]).score({})  # fmt: skip

    assert score(figures(10.9))[0] == 0 and score(figures(11.1))[0] == 1
    assert score(figures(10.0, error=0.1))[0] == 1

    def fails(_: dict[str, float]) -> list[tuple[StepFigures, StepFigures]]:
        raise ValueError

    assert Loop(start={}, steps={}, pinned={}, figures_of=fails).score({}) == NEVER


@pytest.mark.parametrize("name", LOOPS)
def test_what_is_pinned_is_better_than_the_start_and_misses_what_the_documents_say(
    name: str,
) -> None:
    loop = LOOPS[name]
    pinned = loop.score(loop.pinned)
    assert pinned < loop.score(loop.start)
    assert pinned[0] == {"steering": 0, "speed": 1}[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", LOOPS)
def test_the_walk_ends_at_what_is_pinned(name: str) -> None:
    loop = LOOPS[name]
    *_, (point, _) = loop.walk(loop.start)
    assert point == pytest.approx({field: loop.pinned[field] for field in point}, rel=1e-9)


def test_uwas_pinned_numbers_miss_nothing_and_are_better_than_the_start() -> None:
    pinned = PID.score(PID.pinned)
    assert pinned[0] == 0 and pinned < PID.score(PID.start)


@pytest.mark.slow
def test_the_walk_of_uwas_numbers_ends_at_what_is_pinned() -> None:
    *_, (point, _) = PID.walk(PID.start)
    assert point == pytest.approx(PID.pinned, rel=1e-9)
