"""Step responses of steering and speed (UAH 5.1, Fig. 25 and 26), the paper's loops and ours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.drawing import BASELINE, OURS, PAPER, SETPOINT, picture
from experiments.response import StepFigures
from experiments.result import (
    NAN,
    Goal,
    Outcome,
    Row,
    Setting,
    TableOfWords,
    baseline_at_most_paper,
    baseline_within,
    ours_at_most,
    ours_at_most_share,
)
from experiments.uah.baseline import (
    PAPER_SPEED,
    PAPER_STEERING,
    Step,
    paper_speed_step,
    paper_steering_step,
)
from experiments.uah.plant import (
    SPEED_BAND,
    SPEED_STEP_MPS,
    STEERING_BAND,
    UAH_PAPER,
    VEHICLE,
    WHEEL_STEP_RAD,
)
from experiments.uah.stack import Stack
from experiments.uah.tuning import corners, worst
from simulation.plant.params import PlantParams

SPEED_S = 10.0
STEERING_S = 3.0
"""Of the step: the paper's board measures in whole degrees."""
STEADY_SHARE = 0.25
"""Of the paper's steady-state error: the goal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """The two steps of one controller."""

    steering: Step
    speed: Step


def baseline_of(plant: PlantParams) -> Pair:
    """With the paper's board."""
    return Pair(steering=paper_steering_step(plant), speed=paper_speed_step(plant))


def ours_of(plant: PlantParams, seed: int) -> Pair:
    """With this stack: the speed first, then the wheel of the rolling car."""
    stack = Stack(VEHICLE, plant, seed)
    speed_s = stack.now_s
    stack.speed_mps = SPEED_STEP_MPS
    stack.run_for(SPEED_S)
    run = stack.run
    speed = Step(
        run=run, start_s=speed_s, figures=run.speed(speed_s, SPEED_STEP_MPS, SPEED_BAND)
    )
    steering_s = stack.now_s
    stack.wheel_rad = WHEEL_STEP_RAD
    stack.run_for(STEERING_S)
    run = stack.run
    figures = run.steering(steering_s, WHEEL_STEP_RAD, STEERING_BAND)
    return Pair(steering=Step(run=run, start_s=steering_s, figures=figures), speed=speed)


def run(setting: Setting, file: Path) -> Outcome:
    """Both controllers with two and with four people, and in every corner."""
    people = {count: UAH_PAPER.with_occupants(count) for count in PAPER_SPEED}
    baseline = {count: baseline_of(plant) for count, plant in people.items()}
    ours = {count: ours_of(plant, setting.seed) for count, plant in people.items()}
    _draw(file, baseline, ours)
    rows = [*_steering_rows(baseline[2].steering.figures, ours[2].steering.figures)]
    for count in PAPER_SPEED:
        rows += _speed_rows(count, baseline[count].speed.figures, ours[count].speed.figures)
    rows.append(_wide_band(ours[2].speed))
    corner_rows, table = _corners(setting.seed)
    return Outcome(rows=(*rows, *corner_rows), notes=_NOTES, tables=(table,))


_NOTES = (
    "Steps: 90 deg of the steering wheel while the car rolls at 4 m/s, and 0 to 4 m/s; the paper "
    "gives no amplitudes. All times count from the step of the setpoint, for ours from the "
    "planner's decision, with gateway, bus and ECU in between. Settling bands: 5 % for the "
    "steering, 2 % for the speed: with 4.73 % of overshoot a speed is inside 5 % from its rise at "
    "2.2 s on, so the paper's 4.80 s cannot be meant for 5 %.",
    "The plant is TABBY EVO's but for the lag of its drive, 0.366 s in place of 0.08 s: with the "
    "faster drive no gains gave the paper's dead time and rise together. Both controllers run on "
    "it. The paper's four gains, a bound on the steering motor's duty and the time that a setpoint "
    "waits for the next cycle of its task (30 and 90 of 100 ms) are fitted; nothing else is.",
    "One figure of the baseline misses the 10 % by which it is judged: the overshoot with four "
    "people. The paper prints the same 4.73 % for both loads; on this plant it falls with the "
    "load. A differential evolution over lag, gains and wait, ended early, tried no point that had "
    "both within 10 %. The paper's board could not tell either: one encoder pulse in 100 ms is "
    "1.2 % of the step.",
    "The search that ends at the pinned numbers is `python -m experiments.uah.fit`. The band of "
    "2 % was chosen by hand. The rule by which our gains are picked was settled after looking at "
    "what earlier rules picked. One seed.",
    "Ours: the vehicle file as it is. Its gains are those of a grid over the corners below "
    "(experiments/uah/tuning.py); its acceleration limit is 2.0 m/s2 (the paper's loop asks for "
    "all the motor has), and its speed loop allows for 0.35 s of drive lag.",
)


def _row(
    axis: str, name: str, quantity: str, unit: str, values: tuple[float, float, float],
    *goals: Goal,
) -> Row:
    return Row(id=f"uah.steps.{axis}.{name}", paper="uah", quantity=quantity, unit=unit,
               paper_value=values[0], baseline_value=values[1], ours_value=values[2],
               goals=goals)  # fmt: skip


def _triple(
    name: str, paper: StepFigures, baseline: StepFigures, ours: StepFigures
) -> tuple[float, float, float]:
    return getattr(paper, name), getattr(baseline, name), getattr(ours, name)


def _steering_rows(baseline: StepFigures, ours: StepFigures) -> list[Row]:
    paper, near = PAPER_STEERING, baseline_within(0.10)

    def row(name: str, quantity: str, unit: str, *goals: Goal) -> Row:
        values = _triple(name, paper, baseline, ours)
        return _row("steering", name, f"steering: {quantity}", unit, values, *goals)

    return [
        row("dead_time_s", "dead time", "s", near),
        row("rise_s", "rise to 90 %", "s", near),
        row("settling_s", "settling, 5 %", "s", near, ours_at_most_share(0.5)),
        row("overshoot_percent", "overshoot", "%", near, ours_at_most_share(1.0)),
        row("steady_error", "steady-state error", "deg", baseline_at_most_paper(),
            ours_at_most(STEADY_SHARE * paper.steady_error, "deg")),
    ]  # fmt: skip


def _speed_rows(count: int, baseline: StepFigures, ours: StepFigures) -> list[Row]:
    paper, near = PAPER_SPEED[count], baseline_within(0.10)

    def row(name: str, quantity: str, unit: str, *goals: Goal) -> Row:
        values = _triple(name, paper, baseline, ours)
        return _row(f"speed_{count}_people", name, f"speed, {count} people: {quantity}", unit,
                    values, *goals)  # fmt: skip

    return [
        row("dead_time_s", "dead time", "s", near),
        row("rise_s", "rise to 90 %", "s", near),
        row("settling_s", "settling, 2 %", "s", near, ours_at_most_share(0.6)),
        row("overshoot_percent", "overshoot", "%", near, ours_at_most_share(1.0)),
        row("steady_error", "steady-state error", "m/s", baseline_at_most_paper(),
            ours_at_most_share(1.0)),
    ]  # fmt: skip


def _wide_band(ours: Step) -> Row:
    """The goal once more with the band of the steering; the baseline has no such figure."""
    figures = ours.run.speed(ours.start_s, SPEED_STEP_MPS, STEERING_BAND)
    values = (PAPER_SPEED[2].settling_s, NAN, figures.settling_s)
    return _row("speed_2_people", "settling_wide_s", "speed, 2 people: settling, 5 %", "s", values,
                ours_at_most_share(0.6))  # fmt: skip


def _corners(seed: int) -> tuple[list[Row], TableOfWords]:
    """Both controllers in cars that are not the one believed in."""
    cells, ours, baseline = [], [], []
    for corner in corners(UAH_PAPER):
        pairs = baseline_of(corner.plant), ours_of(corner.plant, seed)
        baseline.append(pairs[0])
        ours.append(pairs[1])
        cells.append((corner.name, *(text for pair in pairs for text in _cells(pair))))
    table = TableOfWords(
        title="Robustness: settling (s) and overshoot (%), and the steering's steady error (deg)",
        headers=("car", "paper's: steering", "speed", "ours: steering", "speed"),
        rows=tuple(cells),
    )
    rows = []
    for axis, quantity, paper in (
        ("steering", "steering: settling in the worst corner", PAPER_STEERING),
        ("speed", "speed: settling in the worst corner", PAPER_SPEED[2]),
    ):
        theirs_s, ours_s = (
            worst(getattr(pair, axis).figures for pair in pairs).settling_s
            for pairs in (baseline, ours)
        )
        rows.append(_row(f"corners.{axis}", "settling_s", quantity, "s",
                         (paper.settling_s, theirs_s, ours_s),
                         ours_at_most_share(1.0)))  # fmt: skip
    return rows, table


def _cells(pair: Pair) -> tuple[str, str]:
    steering, speed = pair.steering.figures, pair.speed.figures
    return (
        f"{steering.settling_s:.2f} s, {steering.overshoot_percent:.1f} %, "
        f"{steering.steady_error:.1f} deg",
        f"{speed.settling_s:.2f} s, {speed.overshoot_percent:.1f} %",
    )


def _draw(file: Path, baseline: dict[int, Pair], ours: dict[int, Pair]) -> None:
    with picture(file, 7.0, rows=2, columns=2) as axes:
        for row, count in enumerate(PAPER_SPEED):
            wheel, speed = axes[2 * row : 2 * row + 2]
            wheel_deg = float(np.degrees(WHEEL_STEP_RAD))
            for pair, colour, label in (
                (baseline[count], BASELINE, "paper's PI, 10 Hz"),
                (ours[count], OURS, "ours"),
            ):
                step = pair.steering
                wheel.plot(step.run.time_s - step.start_s, step.run.steering_deg(step.start_s),
                           color=colour, label=label)  # fmt: skip
                step = pair.speed
                speed.plot(step.run.time_s - step.start_s, step.run.speed_mps,
                           color=colour, label=label)  # fmt: skip
            _mark(wheel, wheel_deg, PAPER_STEERING, STEERING_BAND, 2.0)
            _mark(speed, SPEED_STEP_MPS, PAPER_SPEED[count], SPEED_BAND, 8.0)
            wheel.set_ylabel(f"{count} people\nsteering wheel, deg")
            speed.set_ylabel("speed, m/s")
        axes[0].legend(loc="lower right")
        for axis in axes[2:]:
            axis.set_xlabel("time since the setpoint's step, s")


def _mark(axis: Any, setpoint: float, paper: StepFigures, band: float, end_s: float) -> None:
    """Setpoint, its band, and the paper's rise and settling time."""
    axis.plot([-0.1 * end_s, 0.0, 0.0, end_s], [0.0, 0.0, setpoint, setpoint], color=SETPOINT,
              linewidth=1.0, linestyle=(0, (4, 2)), label="setpoint")  # fmt: skip
    axis.axhspan((1.0 - band) * setpoint, (1.0 + band) * setpoint, color=PAPER, alpha=0.15)
    axis.plot(paper.rise_s, 0.9 * setpoint, "s", color=PAPER, label="paper: 90 %, settled")
    axis.plot(paper.settling_s, setpoint, "s", color=PAPER)
    axis.set_xlim(-0.1 * end_s, end_s)
    axis.set_ylim(-0.05 * setpoint, 1.15 * setpoint)
