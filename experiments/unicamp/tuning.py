"""The curvature control's gains: `python -m experiments.unicamp.tuning` finds them again.

Each candidate of a grid drives 4 s to the left and 4 s to the right on the circle of 2.0 m, over
the simulated bus, in every corner that makes a difference to it. The one is taken whose curvature
is nearest to the wanted one on average over them all, from the first decision on. UNICAMP's own
PID, whose gains the paper does not print, is tuned by the same rule.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import fmean
from typing import Final

import numpy as np

from experiments.uah.tuning import Gains, Grid, candidates
from experiments.unicamp.corners import corners
from experiments.unicamp.drivers import OurDriver, PaperDriver, PaperGains
from experiments.unicamp.plant import UNICAMP_PLANT, PlantParams
from experiments.unicamp.wire import Driver, Run, ThreeDrives
from gateway.curvature_control import CurvatureTuning

SPEED_MPS: Final = 0.4
"""UNICAMP 6.2."""
RADIUS_M: Final = 2.0
STANDING_S: Final = 2.0
SIDE_S: Final = 4.0
SEED: Final = 0
PATH: Final = Path("out") / "tuning-unicamp.json"

GRID: Final[Grid] = {
    "proportional_ratio": (0.6, 0.9, 1.2),
    "integral_per_s": (2.0, 3.0, 4.0, 5.0),
    "lag_s": (0.05, 0.1, 0.2),
}
PAPER_GRID: Final[Grid] = {
    "proportional_rad_m": (0.1, 0.2, 0.3, 0.4),
    "integral_rad_m_per_s": (0.5, 0.9, 1.3, 1.7),
}
TUNED: Final[Gains] = {"proportional_ratio": 0.9, "integral_per_s": 3.0, "lag_s": 0.1}
TUNED_PAPER: Final[Gains] = {"proportional_rad_m": 0.2, "integral_rad_m_per_s": 1.3}
"""What the grids gave; a test asks their neighbours again."""


def ours(gains: Gains = TUNED) -> OurDriver:
    """This stack with gains; what the grid leaves alone was not worth a dimension of it."""
    return OurDriver(
        CurvatureTuning(**gains, derivative_s=0.0, filter_s=0.1, correction_per_m_max=0.25)
    )


def papers(gains: Gains = TUNED_PAPER) -> PaperDriver:
    """UNICAMP's controller with gains."""
    return PaperDriver(PaperGains(**gains, derivative_rad_m_s=0.0))


def both_sides(plant: PlantParams, driver: Driver, radius_m: float = RADIUS_M) -> tuple[Run, Run]:
    """From standstill to the left, then to the right."""
    car = ThreeDrives(plant, driver, SEED)
    car.run_for(STANDING_S)
    start_s = car.now_s
    driver.speed_mps = SPEED_MPS
    for side in (1.0, -1.0):
        driver.curvature_per_m = side / radius_m
        car.run_for(SIDE_S)
    run = car.run
    middle_s = start_s + SIDE_S
    return run.between(start_s, middle_s), run.between(middle_s, car.now_s)


def curvature_error(runs: tuple[Run, Run], radius_m: float = RADIUS_M) -> float:
    """Mean distance of yaw rate from speed over radius, by the wanted yaw rate."""
    distances = [
        np.abs(side * run.yaw_rate_radps * radius_m - run.speed_mps)
        for side, run in zip((1.0, -1.0), runs, strict=True)
    ]
    return float(np.concatenate(distances).mean()) / SPEED_MPS


def judged(driver: Callable[[Gains], Driver], gains: Gains) -> float:
    """The mean of a candidate's errors over the corners."""
    return fmean(
        curvature_error(both_sides(corner.plant, driver(gains)))
        for corner in corners(UNICAMP_PLANT)
        if corner.is_of_tuning
    )


def best(
    driver: Callable[[Gains], Driver], grid: Iterable[Gains]
) -> tuple[Gains, list[dict[str, float]]]:
    """The candidate with the smallest error, and all with theirs."""
    found = [(judged(driver, gains), gains) for gains in grid]
    return min(found, key=lambda pair: pair[0])[1], [
        {**gains, "error": error} for error, gains in found
    ]


def main() -> int:
    """Goes over both grids and writes what it found to `out/tuning-unicamp.json`."""
    told = {}
    for name, driver, grid in (("paper", papers, PAPER_GRID), ("ours", ours, GRID)):
        gains, listed = best(driver, candidates(grid))
        told[name] = {"best": gains, "candidates": listed}
    PATH.parent.mkdir(exist_ok=True)
    PATH.write_text(json.dumps(told, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
