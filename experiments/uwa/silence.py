"""The planner falls silent (UWA 7.1, ER5): a check every 300 ms, and what ours does."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from experiments.drawing import BASELINE, OURS, PAPER, picture
from experiments.response import first_crossing_s
from experiments.result import Outcome, Row, Setting, baseline_within, ours_at_most_share
from experiments.uwa.brake import MOVED_RATIO, SAMPLE_S
from experiments.uwa.paper_board import CHECK_NS, PERIOD_NS, UwaBoard
from experiments.uwa.stack import PLANT, UwaStack
from simulation.plant.car import Car

PAPER_S: Final = 0.3
PHASES: Final = tuple(range(0, CHECK_NS, 3 * PERIOD_NS))
"""From a check to the last command."""
WATCHED_S: Final = 0.8
SPEED_MPS: Final = 2.0
SEEDS: Final = 3


def baseline_s(car: Car, phase_ns: int) -> float:
    """From the last command of UWA's board to the servo's first movement."""
    board = UwaBoard(car)
    board.tell()
    board.run_for((2 * CHECK_NS + phase_ns) * 1e-9)
    begin_s, count = board.now_s - PERIOD_NS * 1e-9, len(board.servo_ratio)
    board.run_for(WATCHED_S, is_told=False)
    return first_crossing_s(
        board.run.time_s[count:] - begin_s, np.array(board.servo_ratio[count:]), MOVED_RATIO
    )


def ours_s(seed: int) -> float:
    """From this stack's last decision to the servo's first movement."""
    stack = UwaStack(seed)
    stack.speed_mps = SPEED_MPS
    stack.run_for(4.0)
    world = stack.world
    # the last decision was taken at the beginning of the last tick
    begin_s = stack.now_s - stack.link.planner_period_ns * 1e-9
    samples = []
    for _ in range(round(WATCHED_S / SAMPLE_S)):
        world.run_for(SAMPLE_S)
        samples.append((world.now_ns * 1e-9 - begin_s, world.car.truth.servo_position_ratio))
    time_s, servo_ratio = np.array(samples).T
    return first_crossing_s(time_s, servo_ratio, MOVED_RATIO)


def run(setting: Setting, file: Path) -> Outcome:
    """The shortest and the longest time of each."""
    theirs = [baseline_s(Car(PLANT, setting.rng), phase_ns) for phase_ns in PHASES]
    ours = [ours_s(setting.seed + number) for number in range(SEEDS)]
    with picture(file, 3.4) as (axis,):
        phases_ms = np.array(PHASES) / 1e6
        axis.plot(phases_ms, 1e3 * np.array(theirs), "o", color=BASELINE, label="UWA's board")
        for number, found_s in enumerate(ours):
            axis.axhline(1e3 * found_s, color=OURS, label=None if number else "ours, three seeds")
        axis.axhline(1e3 * PAPER_S, color=PAPER, linewidth=1.0, label="paper: 300 ms")
        axis.set_xlabel("from the board's check to the last command, ms")
        axis.set_ylabel("last command to brake, ms")
        axis.set_ylim(0.0, 700.0)
        axis.legend(loc="upper right", ncols=3)
    rows = (
        Row(id="uwa.silence.shortest_s", paper="uwa", unit="s",
            quantity="from the last command to the brake, at least", paper_value=PAPER_S,
            baseline_value=min(theirs), ours_value=min(ours),
            goals=(baseline_within(0.10), ours_at_most_share(0.5))),
        Row(id="uwa.silence.longest_s", paper="uwa", unit="s",
            quantity="from the last command to the brake, at most", baseline_value=max(theirs),
            ours_value=max(ours), goals=(ours_at_most_share(0.333, "baseline"),)),
    )  # fmt: skip
    return Outcome(rows=rows, notes=(
        "The board looks every 300 ms whether a command has come, so that a planner may be silent "
        "for nearly 600 ms, if its last command came just after a look. Ours judges the age of the "
        "planner's decision every 10 ms; the vehicle file's 300 ms are the bound on the age that "
        "it allows, a planner that promises 20 ms is given 85 ms.",
    ))  # fmt: skip
