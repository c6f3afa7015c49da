"""UAH's steps with UAH's controller: what the paper prints, and the same here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from experiments.chance import generator
from experiments.response import StepFigures
from experiments.uah.paper_board import (
    PERIOD_NS,
    PaperBoard,
    PaperGains,
    Run,
)
from experiments.uah.plant import (
    PAPER_GAINS,
    SPEED_BAND,
    SPEED_STEP_MPS,
    SPEED_WAIT_NS,
    STEERING_BAND,
    STEERING_WAIT_NS,
    WHEEL_STEP_RAD,
)
from simulation.plant.car import Car
from simulation.plant.params import PlantParams
from vehicles import load_vehicle

WHEEL_RADIUS_M: Final = load_vehicle("tabby_evo").geometry.wheel_radius_m
STEADY_MPS: Final = float(np.radians(20.0)) * WHEEL_RADIUS_M
"""UAH 5.1: +-20 deg/s of wheel."""
PAPER_STEERING: Final = StepFigures(
    dead_time_s=0.100, rise_s=0.650, settling_s=0.799, overshoot_percent=3.92, steady_error=4.0
)
"""UAH 5.1; degrees of the steering wheel."""

PAPER_SPEED: Final = {
    2: StepFigures(dead_time_s=0.320, rise_s=2.20, settling_s=4.80, overshoot_percent=4.73,
                   steady_error=STEADY_MPS),
    4: StepFigures(dead_time_s=0.320, rise_s=2.39, settling_s=5.45, overshoot_percent=4.73,
                   steady_error=STEADY_MPS),
}  # fmt: skip
"""UAH 5.1, by the number of people; m/s."""

SPEED_S: Final = 16.0
"""So long is a step of the speed watched."""
STEERING_S: Final = 6.0
FIRST_TICK_NS: Final = 10 * PERIOD_NS
ROLLING_NS: Final = 200 * PERIOD_NS
"""From power-on to the step of the wheel of a car that rolls by then."""
SEED: Final = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """A run, and its figures since its setpoint stepped."""

    run: Run
    start_s: float
    figures: StepFigures


def paper_speed_step(
    plant: PlantParams, gains: PaperGains = PAPER_GAINS, *, wait_ns: int = SPEED_WAIT_NS
) -> Step:
    """From standstill to 4 m/s; the setpoint comes so long before the next cycle of its task."""
    board = PaperBoard(Car(plant, generator(SEED)), gains)
    start_ns = FIRST_TICK_NS - wait_ns
    board.run_until(start_ns)
    board.tell(0.0, SPEED_STEP_MPS / WHEEL_RADIUS_M)
    board.run_until(start_ns + round(SPEED_S * 1e9))
    run, start_s = board.run, start_ns * 1e-9
    return Step(run=run, start_s=start_s, figures=run.speed(start_s, SPEED_STEP_MPS, SPEED_BAND))


def paper_steering_step(
    plant: PlantParams,
    gains: PaperGains = PAPER_GAINS,
    *,
    is_rolling: bool = True,
    wait_ns: int = STEERING_WAIT_NS,
) -> Step:
    """90 deg of the steering wheel to the left."""
    board = PaperBoard(Car(plant, generator(SEED)), gains)
    wheel_radps = SPEED_STEP_MPS / WHEEL_RADIUS_M if is_rolling else 0.0
    board.tell(0.0, wheel_radps)
    start_ns = (ROLLING_NS if is_rolling else FIRST_TICK_NS) - wait_ns
    board.run_until(start_ns)
    board.tell(WHEEL_STEP_RAD, wheel_radps)
    board.run_until(start_ns + round(STEERING_S * 1e9))
    run, start_s = board.run, start_ns * 1e-9
    figures = run.steering(start_s, WHEEL_STEP_RAD, STEERING_BAND)
    return Step(run=run, start_s=start_s, figures=figures)
