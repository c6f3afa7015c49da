"""UWA's gains and its sensor's zero, fitted to Table 3 and Fig. 9: `python -m experiments.uwa.fit`.

The paper prints neither. Each figure's error counts by the goal that it is judged by in the report:
a tenth of an angle error and of the speed, 0.001 of R^2. The search starts where a differential
evolution over the same numbers had ended and ends at what is pinned in `paper_board.py` and
`simulation/plant/fsae_electric.py`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Final

from experiments.chance import generator
from experiments.search import NEAR, Point, Score, Search, tell
from experiments.uwa.paper_board import GAINS, PidGains
from experiments.uwa.stack import PLANT
from experiments.uwa.steering import (
    PAPER_ERRORS_DEG,
    PAPER_R2,
    PAPER_RATE_DEGPS,
    R2_SHARE,
    board_in,
    found_of,
)
from simulation.plant.car import Car

ZERO: Final = "column_angle_zero_rad"
SEED: Final = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Pid(Search):
    """The steering's PID on the standing car."""

    def score(self, point: Point) -> Score:
        """By the figures of `experiments.uwa.steering`."""
        sensors = replace(PLANT.sensors, column_angle_zero_rad=point[ZERO])
        gains = PidGains(**{name: value for name, value in point.items() if name != ZERO})
        car = Car(replace(PLANT, sensors=sensors), generator(SEED))
        found = found_of(board_in(car, gains))
        off = [(found.error_deg(target) / paper - 1.0) / NEAR
               for target, paper in PAPER_ERRORS_DEG.items()]  # fmt: skip
        off.append((found.rate_degps / PAPER_RATE_DEGPS - 1.0) / NEAR)
        off.append((found.r2 / PAPER_R2 - 1.0) / R2_SHARE)
        return sum(abs(one) > 1.0 for one in off), sum(one * one for one in off)


PID: Final = Pid(
    start={"proportional": 0.030, "integral_per_s": 0.0128, "derivative_s": 0.0025, ZERO: 0.018},
    steps={"proportional": 0.001, "integral_per_s": 0.0005, "derivative_s": 0.0005, ZERO: 0.001},
    pinned={
        "proportional": GAINS.proportional,
        "integral_per_s": GAINS.integral_per_s,
        "derivative_s": GAINS.derivative_s,
        ZERO: PLANT.sensors.column_angle_zero_rad,
    },
)


def main() -> int:
    """Walks, and tells each step."""
    for line in tell("steering", PID):
        sys.stdout.write(f"{line}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
