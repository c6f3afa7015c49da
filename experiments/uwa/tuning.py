"""The steering gains of UWA's car: `python -m experiments.uwa.tuning` finds them again.

The steer ECU's loop runs on the plant without bus and supervisor, over a grid of gains. Each
candidate meets the same cars: the plant, a fifth more and less of the motor, a heavier column, half
and one and a half times the friction and the scrub. Of those whose rolling car overshoots by 12 %
at most in every car, the one is taken whose standing wheel is off least in its worst car.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from experiments.uah.tuning import BareLoops, Gains, Grid, candidates, with_steering
from experiments.uwa.stack import PLANT, VEHICLE
from simulation.plant.params import PlantParams

GRID: Final[Grid] = {
    "position_gain_per_s": (7.0, 9.0, 12.0),
    "integral_gain_per_s2": (4.0, 8.0, 15.0),
    "rate_gain": (0.6, 0.8, 1.0),
    "motor_friction_duty_ratio": (0.10, 0.14, 0.18, 0.22),
}
TUNED: Final[Gains] = {name: getattr(VEHICLE.steering, name) for name in GRID}
"""The vehicle file's; a test asks their neighbours again."""
OVERSHOOT_PERCENT_MAX: Final = 12.0

TARGETS_DEG: Final = (15.0, 0.0, -15.0, 0.0)
HOLD_S: Final = 1.5
ROLLING_MPS: Final = 4.0
BEFORE_S: Final = 4.0
STEP_S: Final = 2.0
STEP_RAD: Final = math.radians(40.0)
SETTLED_S: Final = 1.0
"""From the step on; what the overshoot is measured against."""
RATIO: Final = PLANT.steering.column_to_road_wheel_ratio
PATH: Final = Path("out") / "uwa_tuning.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A candidate."""

    error_deg: float
    """Largest error of the standing road wheel; the sensor's zero, which no loop sees, apart."""
    overshoot_percent: float
    """Of a step of the column, rolling."""


def cars(plant: PlantParams = PLANT) -> Iterator[tuple[str, PlantParams]]:
    """The plant, and those that differ from it in one thing."""
    yield "as fitted", plant
    for name, field, factor in (
        ("motor 20 % weaker", "motor_stall_torque_nm", 0.8),
        ("motor 20 % stronger", "motor_stall_torque_nm", 1.2),
        ("column 20 % heavier", "column_inertia_kgm2", 1.2),
        ("friction half", "coulomb_torque_nm", 0.5),
        ("friction one and a half times", "coulomb_torque_nm", 1.5),
        ("scrub half", "scrub_torque_nm", 0.5),
        ("scrub one and a half times", "scrub_torque_nm", 1.5),
    ):
        changed = {field: factor * getattr(plant.steering, field)}
        yield name, replace(plant, steering=replace(plant.steering, **changed))


def judged_in(gains: Gains, plant: PlantParams) -> Judged:
    """A candidate in one car."""
    vehicle = with_steering(VEHICLE, gains)
    standing = BareLoops(vehicle, plant)
    zero_deg = math.degrees(plant.sensors.column_angle_zero_rad) / RATIO
    errors = []
    for target_deg in TARGETS_DEG:
        standing.run_for(HOLD_S, 0.0, math.radians(target_deg) * RATIO)
        reached_deg = math.degrees(standing.run.column_angle_rad[-1]) / RATIO
        errors.append(abs(reached_deg + zero_deg - target_deg))
    rolling = BareLoops(vehicle, plant)
    rolling.run_for(BEFORE_S, ROLLING_MPS, 0.0)
    rolling.run_for(STEP_S, ROLLING_MPS, STEP_RAD)
    run = rolling.run
    column = run.column_angle_rad[run.after(BEFORE_S)]
    settled = column[run.time_s[run.after(BEFORE_S)] > BEFORE_S + SETTLED_S].mean()
    overshoot = 100.0 * (float(np.max(column) / settled) - 1.0)
    return Judged(error_deg=max(errors), overshoot_percent=overshoot)


def judged(gains: Gains) -> Judged:
    """The worst of every car."""
    found = [judged_in(gains, plant) for _, plant in cars()]
    return Judged(
        error_deg=max(one.error_deg for one in found),
        overshoot_percent=max(one.overshoot_percent for one in found),
    )


def best(found: Iterable[tuple[Gains, Judged]]) -> Gains:
    """The gains with the smallest error, of those within the limit of the overshoot."""
    allowed = [pair for pair in found if pair[1].overshoot_percent <= OVERSHOOT_PERCENT_MAX]
    return min(allowed, key=lambda pair: pair[1].error_deg)[0]


def main() -> int:
    """Goes over the grid and writes what it found to `out/uwa_tuning.json`."""
    found = [(gains, judged(gains)) for gains in candidates(GRID)]
    rows = [{**gains, **asdict(one)} for gains, one in found]
    PATH.parent.mkdir(exist_ok=True)
    text = json.dumps({"best": best(found), "candidates": rows}, indent=1)
    PATH.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
