"""What the paper leaves open, fitted to its step responses: `python -m experiments.uah.fit`.

The paper prints no gains, no lag of its drive, no bound on the steering motor's duty, and not how
long a setpoint waits for the next cycle of its 100 ms task. The search goes, in steps of a few
percent, ever to the best neighbour, until none is better. Better is a fit with fewer figures off by
more than a tenth, then one with the smaller sum of squares of what they are off. It is a local
search and ends at the same point every time: the one pinned in `plant.py`. It starts where a
differential evolution over the same numbers had ended.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from typing import Final

from experiments.response import StepFigures
from experiments.search import NEAR, Point, Score, Search, tell
from experiments.uah.baseline import (
    PAPER_SPEED,
    PAPER_STEERING,
    paper_speed_step,
    paper_steering_step,
)
from experiments.uah.paper_board import PERIOD_NS, PaperGains
from experiments.uah.plant import (
    PAPER_GAINS,
    SPEED_WAIT_NS,
    STEERING_WAIT_NS,
    UAH_PAPER,
)

FITTED: Final = ("dead_time_s", "rise_s", "settling_s", "overshoot_percent")
LAG: Final = "torque_lag_s"
WAIT: Final = "wait_ns"
GAINS: Final = frozenset(field.name for field in fields(PaperGains))
NEVER: Final = (99, 99.0)
"""Of a loop that does not settle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop(Search):
    """What is fitted of one loop."""

    figures_of: Callable[[Point], list[tuple[StepFigures, StepFigures]]]
    """The paper's figures and those of a point, for each response."""

    def score(self, point: Point) -> Score:
        """How well a point fits."""
        try:
            pairs = self.figures_of(point)
        except ValueError:
            return NEVER
        errors = [getattr(found, name) / getattr(paper, name) - 1.0
                  for paper, found in pairs for name in FITTED]  # fmt: skip
        missed = sum(abs(error) > NEAR for error in errors)
        missed += sum(found.steady_error > paper.steady_error for paper, found in pairs)
        return missed, sum(error * error for error in errors)


def gains_of(point: Point) -> PaperGains:
    """The pinned gains, but for those of a point."""
    return replace(PAPER_GAINS, **{name: point[name] for name in point.keys() & GAINS})


def steering_figures(point: Point) -> list[tuple[StepFigures, StepFigures]]:
    """The step of the steering wheel."""
    step = paper_steering_step(UAH_PAPER, gains_of(point), wait_ns=round(point[WAIT]))
    return [(PAPER_STEERING, step.figures)]


def speed_figures(point: Point) -> list[tuple[StepFigures, StepFigures]]:
    """The steps of the speed with two and with four people, on a plant with the point's lag."""
    plant = replace(UAH_PAPER, traction=replace(UAH_PAPER.traction, torque_lag_s=point[LAG]))
    return [
        (paper, paper_speed_step(plant.with_occupants(people), gains_of(point),
                                 wait_ns=round(point[WAIT])).figures)
        for people, paper in PAPER_SPEED.items()
    ]  # fmt: skip


STEERING: Final = Loop(
    start={
        "steering_duty_per_deg": 0.01105,
        "steering_duty_per_deg_s": 0.001264,
        "steering_duty_max": 0.272,
        WAIT: 30e6,
    },
    steps={
        "steering_duty_per_deg": 0.0005,
        "steering_duty_per_deg_s": 0.0001,
        "steering_duty_max": 0.01,
        WAIT: 10e6,
    },
    pinned={**asdict(PAPER_GAINS), WAIT: float(STEERING_WAIT_NS)},
    highest={WAIT: PERIOD_NS},
    figures_of=steering_figures,
)
SPEED: Final = Loop(
    start={
        LAG: 0.366,
        "throttle_per_degps": 0.001988,
        "throttle_per_deg": 0.0001215,
        WAIT: 90e6,
    },
    steps={LAG: 0.02, "throttle_per_degps": 0.0001, "throttle_per_deg": 0.00001, WAIT: 10e6},
    pinned={
        **asdict(PAPER_GAINS), LAG: UAH_PAPER.traction.torque_lag_s, WAIT: float(SPEED_WAIT_NS)
    },
    highest={WAIT: PERIOD_NS},
    figures_of=speed_figures,
)
LOOPS: Final = {"steering": STEERING, "speed": SPEED}


def main() -> int:
    """Walks, and tells each step."""
    for name, loop in LOOPS.items():
        for line in tell(name, loop):
            sys.stdout.write(f"{line}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
