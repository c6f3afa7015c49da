"""Odometry (UAH 3.4): a lap of the campus by the wheels alone, and how far that leads astray.

The gateway is told the pose once, at the start; the truth must stay inside the error it states.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from dbw.drive import DriveProgress, drive
from dbw.plan import DrivePlan
from experiments.drawing import BASELINE, OURS, PAPER, SETPOINT, picture
from experiments.response import FloatArray
from experiments.result import Outcome, Row, Setting, TableOfWords, ours_at_most
from experiments.uah.path import campus_plan, our_stage

SIGMAS: Final = 3.0
"""The error stays within so many of the standard deviations that are stated."""
WAY_SHARE_MAX: Final = 0.03
NEAR_M: Final = 10.0
"""Before this the deviations are centimetres, below what a run of one car can judge."""
TABLE_M: Final = (50.0, 100.0, 200.0, 400.0, 800.0)
Sample = tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Astray:
    """The pose by the wheels beside the true one, each of shape (N,)."""

    way_m: FloatArray
    """As driven."""
    told_way_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    true_x_m: FloatArray
    true_y_m: FloatArray
    heading_error_rad: FloatArray
    position_sigma_m: FloatArray
    heading_sigma_rad: FloatArray

    @property
    def error_m(self) -> FloatArray:
        """Distance from the truth."""
        return np.hypot(self.x_m - self.true_x_m, self.y_m - self.true_y_m)


def lap_by_wheels(plan: DrivePlan, seed: int) -> Astray:
    """Our lap, whose planner has a receiver; the odometry has none."""
    stage = our_stage(plan, seed)
    start, samples = plan.line.start, list[Sample]()

    def note(progress: DriveProgress) -> None:
        found, truth = progress.state.odometry, stage.world.car.truth
        samples.append((
            truth.distance_m, found.way_m, found.x_m, found.y_m, truth.pose.x_m, truth.pose.y_m,
            math.remainder(found.heading_rad - truth.pose.heading_rad, 2.0 * math.pi),
            found.position_sigma_m, found.heading_sigma_rad,
        ))  # fmt: skip

    with stage:
        stage.car.give_pose(x_m=start.x_m, y_m=start.y_m, heading_rad=start.heading_rad)
        end = drive(stage, plan, note)
    assert not end.ended_early, end.ended_early
    return Astray(**dict(zip(Astray.__slots__, np.array(samples).T, strict=True)))


def run(setting: Setting, file: Path) -> Outcome:
    """One lap."""
    lap = lap_by_wheels(campus_plan(), setting.seed)
    _draw(file, lap)
    far = lap.way_m > NEAR_M
    way_error = float(abs(lap.told_way_m[-1] / lap.way_m[-1] - 1.0))
    figures = (
        ("position_sigmas", "largest error of the position over its standard deviation", "",
         float((lap.error_m[far] / lap.position_sigma_m[far]).max()), SIGMAS),
        ("heading_sigmas", "largest error of the heading over its standard deviation", "",
         float(abs(lap.heading_error_rad[far] / lap.heading_sigma_rad[far]).max()), SIGMAS),
        ("way_percent", "error of the lap's length", "%", 100.0 * way_error,
         100.0 * WAY_SHARE_MAX),
    )  # fmt: skip
    rows = tuple(
        Row(id=f"uah.odometry.{name}", paper="uah", quantity=quantity, unit=unit, ours_value=value,
            goals=(ours_at_most(most, unit),))
        for name, quantity, unit, value, most in figures
    )  # fmt: skip
    return Outcome(rows=rows, notes=_NOTES, tables=(_growth(lap),))


_NOTES = (
    "The paper describes its odometry and prints no figure of it. It takes the turn from the "
    "difference of two rear encoders; this bus carries one rear wheel, and the turn comes from the "
    "steering. The car's tyres are 1 % smaller, its steering is off by 0.015 rad and its tyres "
    "slip; the gateway knows none of it and states what such things may do.",
    "An error of the steering's zero bends the whole way, so the deviation grows faster than the "
    "way, and shrinks when the lap closes. A planner that gives the pose again "
    "(`Car.give_pose`) begins anew.",
)


def _growth(lap: Astray) -> TableOfWords:
    places = [int(np.searchsorted(lap.way_m, way_m)) for way_m in TABLE_M]
    return TableOfWords(
        title="Odometry alone: the error and its standard deviation over the way",
        headers=("way, m", "error, m", "stated, m", "heading, deg", "stated, deg"),
        rows=tuple(
            (f"{way_m:g}", f"{lap.error_m[place]:.2f}", f"{lap.position_sigma_m[place]:.2f}",
             f"{math.degrees(lap.heading_error_rad[place]):.2f}",
             f"{math.degrees(lap.heading_sigma_rad[place]):.2f}")
            for way_m, place in zip(TABLE_M, places, strict=True)
            if place < lap.way_m.size
        ),
    )  # fmt: skip


def _draw(file: Path, lap: Astray) -> None:
    """The path, and both errors over the way."""
    with picture(file, 10.0, rows=3) as (road, position, heading):
        road.plot(lap.true_x_m, lap.true_y_m, color=SETPOINT, linewidth=1.0, label="truth")
        road.plot(lap.x_m, lap.y_m, color=OURS, label="by the wheels alone")
        road.set_aspect("equal")
        road.set_ylabel("y, m")
        road.legend(loc="lower right")
        sigma_deg = np.degrees(lap.heading_sigma_rad)
        for axis, error, sigma, unit in (
            (position, lap.error_m, lap.position_sigma_m, "position, m"),
            (heading, abs(np.degrees(lap.heading_error_rad)), sigma_deg, "heading, deg"),
        ):
            axis.plot(lap.way_m, error, color=OURS, label="error")
            axis.plot(lap.way_m, sigma, color=PAPER, label="stated standard deviation")
            axis.plot(lap.way_m, SIGMAS * sigma, color=BASELINE, linestyle=(0, (4, 2)),
                      label=f"{SIGMAS:g} of them: the bound")  # fmt: skip
            axis.set_ylabel(unit)
        position.legend(loc="upper left")
        heading.set_xlabel("way, m")
