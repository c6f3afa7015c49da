"""The planner falls silent (UAH 4.5): stop and centre the wheel after 1 s, and what ours does."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np

from experiments.drawing import BASELINE, OURS, picture
from experiments.response import first_crossing_s
from experiments.result import Outcome, Row, Setting, ours_at_most_share
from experiments.uah.baseline import WHEEL_RADIUS_M
from experiments.uah.paper_board import SILENCE_NS_MAX, PaperBoard, Run
from experiments.uah.plant import PAPER_GAINS, SPEED_STEP_MPS, UAH_PAPER, VEHICLE
from experiments.uah.stack import Stack
from simulation.plant.car import Car

WHEEL_RAD: Final = math.radians(90.0)
SILENT_S: Final = 12.0
WATCHED_S: Final = 20.0
SLOWER_MPS: Final = 0.1
STANDING_MPS: Final = 0.1


def run(setting: Setting, file: Path) -> Outcome:
    """Both at 4 m/s in a bend when the last setpoint comes."""
    board = PaperBoard(Car(UAH_PAPER, setting.rng), PAPER_GAINS)
    board.tell(WHEEL_RAD, SPEED_STEP_MPS / WHEEL_RADIUS_M)
    board.run_until(round(SILENT_S * 1e9))
    board.run_until(round((SILENT_S + WATCHED_S) * 1e9), is_told=False)
    stack = Stack(VEHICLE, UAH_PAPER, setting.seed)
    stack.speed_mps = SPEED_STEP_MPS
    stack.run_for(SILENT_S / 2.0)
    stack.wheel_rad = WHEEL_RAD
    stack.run_for(SILENT_S / 2.0)
    silent_s, stack.is_silent = stack.now_s, True
    stack.run_for(WATCHED_S)
    theirs, ours = after(board.run, SILENT_S), after(stack.run, silent_s)
    with picture(file, 5.0, rows=2) as (speed, wheel):
        for found, colour, label in ((theirs, BASELINE, "paper's board"), (ours, OURS, "ours")):
            speed.plot(found.time_s, found.speed_mps, color=colour, label=label)
            wheel.plot(found.time_s, np.degrees(found.column_angle_rad), color=colour)
        speed.set_ylabel("speed, m/s")
        wheel.set_ylabel("steering wheel, deg")
        wheel.set_xlabel("time since the last setpoint, s")
        speed.legend()
    figures = (
        ("slower_s", "from the last setpoint to 0.1 m/s slower", SILENCE_NS_MAX * 1e-9,
         slower_s(theirs), slower_s(ours), "paper"),
        ("standing_s", "from the last setpoint to standstill", math.nan, standing_s(theirs),
         standing_s(ours), "baseline"),
    )  # fmt: skip
    rows = tuple(
        Row(id=f"uah.silence.{name}", paper="uah", quantity=quantity, unit="s", paper_value=paper,
            baseline_value=baseline, ours_value=own, goals=(ours_at_most_share(0.5, of),))
        for name, quantity, paper, baseline, own, of in figures
    )  # fmt: skip
    return Outcome(rows=rows, notes=(
        "The paper's board waits 1 s, then asks for zero speed and a centred wheel and brakes with "
        "the motor. This stack brakes with the servo as soon as the planner is late, and holds the "
        f"wheel's angle until the car is slow: it ends at "
        f"{math.degrees(ours.column_angle_rad[-1]):.0f} deg, the paper's at "
        f"{math.degrees(theirs.column_angle_rad[-1]):.0f} deg. Centring a wheel in a bend would "
        "take the car off its lane.",
    ))  # fmt: skip


def after(run: Run, start_s: float) -> Run:
    """What happened since, with its own zero of time."""
    kept = run.after(start_s)
    return Run(time_s=run.time_s[kept] - start_s, column_angle_rad=run.column_angle_rad[kept],
               speed_mps=run.speed_mps[kept], x_m=run.x_m[kept], y_m=run.y_m[kept])  # fmt: skip


def slower_s(run: Run) -> float:
    """Until the car has lost 0.1 m/s."""
    return first_crossing_s(run.time_s, run.speed_mps[0] - run.speed_mps, SLOWER_MPS)


def standing_s(run: Run) -> float:
    """Until the car stands."""
    return first_crossing_s(run.time_s, -run.speed_mps, -STANDING_MPS)
