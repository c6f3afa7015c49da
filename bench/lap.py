"""Laps with the reference planner, as `dbw demo` drives them: how far from the line, and braked?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from bench.spread import spread
from bench.table import Table, command_line, met
from dbw.drive import drive
from dbw.plan import make_plan
from dbw.results import Drive, summarise
from dbw.virtual_stage import VirtualStage
from planner.road import open_road
from telemetry.report import UAH_MAX_ERROR_M, UAH_RMSE_M, DriveReport
from vehicles import load_vehicle

NAME = "lap"
CAMPUS = "campus"
CIRCUITS = ("norisring", "oschersleben", "zandvoort")
CAMPUS_SEEDS = 5
QUICK_DISTANCE_M = 60.0
AIM = 1.0 / 3.0
"""Of UAH's figures: what the project aims at."""

PLANNER_PERIOD_NS = 20_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One drive to be done."""

    track: str
    seed: int
    distance_m: float | None = None
    """None: the whole lap."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LapResult:
    """What `measure` answers."""

    quick: bool
    runs: tuple[Run, ...]
    reports: tuple[DriveReport, ...]
    """One for each run, in the same order."""

    def tables(self) -> list[Table]:
        """The campus against UAH, and all drives one by one."""
        return [*self._campus(), self._drives()]

    def _campus(self) -> list[Table]:
        laps = [run.track == CAMPUS and run.distance_m is None for run in self.runs]
        reports = [report for report, is_lap in zip(self.reports, laps, strict=True) if is_lap]
        if not reports:
            return []  # a part of a lap says nothing about the roundabouts
        are_whole = all(report.lap_completed for report in reports)
        rows = []
        for label, values, paper in (
            ("RMSE, m", [report.rmse_m for report in reports], UAH_RMSE_M),
            ("largest error, m", [report.max_error_m for report in reports], UAH_MAX_ERROR_M),
        ):
            worst = max(values)
            rows.append(
                (label, f"{paper:.3f}", f"{fmean(values):.3f}", f"{worst:.3f}",
                 f"{worst / paper:.2f}", met(are_whole and worst < paper),
                 met(are_whole and worst < AIM * paper))
            )
        return [
            Table(
                title="Campus lap against UAH",
                command=command_line(NAME, quick=self.quick),
                headers=("", "UAH", f"mean of {len(reports)} seeds", "worst", "worst / UAH",
                         "goal: below UAH", "aim: below a third"),
                rows=rows,
                notes=("Distance between the true pose and the planned line; UAH drove another "
                       "road of about this shape and length with the same speed limit.",),
            )
        ]

    def _drives(self) -> Table:
        rows = [
            (r.track, str(r.seed), _yes(r.lap_completed), f"{r.distance_m:.0f}",
             f"{r.duration_s:.0f}", f"{r.rmse_m:.3f}", f"{r.max_error_m:.3f}",
             f"{r.speed_max_mps * 3.6:.1f}", str(r.emergency_brakes), " ".join(r.codes) or "none",
             f"{r.bus_load_mean:.1%}", f"{r.bus_load_max:.1%}")
            for r in self.reports
        ]
        return Table(
            title="Drives",
            command=command_line(NAME, quick=self.quick),
            headers=("track", "seed", "lap completed", "m", "s", "RMSE, m", "largest error, m",
                     "km/h", "emergency brakes", "codes", "bus load", "busiest 100 ms"),
            rows=rows,
            notes=() if not self.quick else ("Parts of laps only.",),
        )


def measure(*, quick: bool = False) -> LapResult:
    """Several seeds on the campus, one on each real circuit; with `quick` a part of each road."""
    if quick:
        runs = [Run(track=track, seed=0, distance_m=QUICK_DISTANCE_M)
                for track in (CAMPUS, CIRCUITS[0])]
    else:
        runs = [Run(track=track, seed=0) for track in reversed(CIRCUITS)]  # the longest first
        runs += [Run(track=CAMPUS, seed=seed) for seed in range(CAMPUS_SEEDS)]
    return measure_runs(runs, quick=quick)


def measure_runs(runs: Sequence[Run], *, quick: bool) -> LapResult:
    """The given drives, one per core at a time."""
    return LapResult(quick=quick, runs=tuple(runs), reports=tuple(spread(drive_once, runs)))


def drive_once(run: Run) -> DriveReport:
    """One drive in virtual time, with the drive loop of `dbw demo`."""
    plan = make_plan(
        vehicle=load_vehicle("tabby_evo"),
        road=open_road(run.track),
        planner_period_ns=PLANNER_PERIOD_NS,
        distance_m=run.distance_m,
    )
    stage = VirtualStage(plan, run.seed)
    with stage:
        end = drive(stage, plan, lambda progress: None)
    done = Drive(
        plan=plan,
        end=end,
        recorder=stage.recorder,
        log=stage.log,
        bus="simulated",
        channel="sim0",
        seed=run.seed,
        trace_sha256=stage.trace_sha256,
        real_time_factor=float("nan"),  # several drives share the machine
    )
    report, _, _ = summarise(done)
    return report


def _yes(is_so: bool) -> str:
    return "yes" if is_so else "**no**"
