"""Virtual time against real time: the whole stack on one core, and where its time goes."""

from __future__ import annotations

import cProfile
import pstats
import time
from dataclasses import dataclass
from statistics import median

from bench.machine import REFERENCE_COUNT, cpu_s, reference_loop_s
from bench.profile_split import split_by_part
from bench.rig import Rig
from bench.table import Table, command_line, met
from dbw.drive import drive
from dbw.plan import DrivePlan, make_plan
from dbw.virtual_stage import VirtualStage
from oracle.judge import Oracle
from planner.road import open_road
from simulation import kernel
from simulation.observer import Observer
from simulation.world import World
from vehicles import load_vehicle

NAME = "speed"
DRIVE_GOALS = (50.0, 100.0)
"""Times real time, on one core: goal and aim."""
WATCHED_GOALS, WATCHED_GOALS_COMPILED = (100.0, 1000.0), (300.0, 1000.0)
PLANNER_PERIOD_NS = 20_000_000
RUNS, QUICK_RUNS = 3, 1
DISTANCE_M, QUICK_DISTANCE_M = 200.0, 30.0
WORLD_S, QUICK_WORLD_S = 20.0, 2.0
SPEED_MPS, CURVATURE_PER_M = 4.0, 0.03
"""What the watched car holds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedRun:
    """One run of something in virtual time."""

    virtual_s: float
    cpu_s: float
    wall_s: float
    reference_s: float
    """CPU time of the reference loop directly after it."""

    @property
    def factor(self) -> float:
        """Virtual time over CPU time."""
        return self.virtual_s / self.cpu_s


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedResult:
    """What `measure` answers."""

    quick: bool
    drives: tuple[SpeedRun, ...]
    """Whole stack, planner and recording included."""
    parked: tuple[SpeedRun, ...]
    """Nodes, wire and plant alone, in MANUAL."""
    watched: tuple[SpeedRun, ...]
    """Nodes, wire and plant, the car driving itself under the eyes of the oracle."""
    shares: tuple[tuple[str, float], ...]
    """Share of the profiled time by part, largest first; sums to 1."""

    def tables(self) -> list[Table]:
        """Speed, and its split."""
        command = command_line(NAME, quick=self.quick)
        rows = []
        watched_goals = WATCHED_GOALS_COMPILED if _is_compiled() else WATCHED_GOALS
        for what, runs, goals in (
            ("campus drive: all nodes, wire, plant, planner, recording", self.drives, DRIVE_GOALS),
            ("all nodes, wire and plant, parked in MANUAL", self.parked, ()),
            ("all nodes, wire, plant and oracle, driving", self.watched, watched_goals),
        ):
            best = max(runs, key=lambda run: run.factor)
            middle = median(run.factor for run in runs)
            rows.append(
                (what, f"{best.virtual_s:.1f}", f"{best.cpu_s:.2f}", f"{best.wall_s:.2f}",
                 f"{best.factor:.1f}x", f"{middle:.1f}x", f"{best.reference_s * 1e3:.0f}",
                 f"{best.virtual_s / best.cpu_s * best.reference_s:.2f}",
                 ", ".join(f"{goal:g}x: {met(best.factor >= goal)}" for goal in goals))
            )
        speed = Table(
            title=f"Virtual time against real time, one core, {_build()}",
            command=command,
            headers=("what", "virtual, s", "CPU, s", "wall, s", "best: virtual / CPU", "median",
                     "reference loop, ms", "virtual s per reference loop",
                     "goal, aim"),
            rows=rows,
            notes=(f"Best and median of {len(self.drives)} runs. The reference loop is "
                   f"`sum(range({REFERENCE_COUNT:_}))`; the last figure but one is comparable "
                   "between machines and between busy and quiet hours of one.",),
        )
        split = Table(
            title="Where the time of the campus drive goes",
            command=command,
            headers=("part", "share"),
            rows=[(part, f"{share:.1%}") for part, share in self.shares],
            notes=("cProfile's own times; what libraries and built-in functions take is put down "
                   "to the part that calls them. cProfile makes many small calls look dearer than "
                   "they are.",),
        )
        return [speed, split]


def _is_compiled() -> bool:
    return not str(kernel.__file__).endswith(".py")


def _build() -> str:
    return "compiled (`make bench-compiled`)" if _is_compiled() else "interpreted"


def measure(*, quick: bool = False) -> SpeedResult:
    """A part of the campus lap, then the same profiled."""
    return measure_distance(
        QUICK_DISTANCE_M if quick else DISTANCE_M,
        world_s=QUICK_WORLD_S if quick else WORLD_S,
        runs=QUICK_RUNS if quick else RUNS,
        quick=quick,
    )


def measure_distance(distance_m: float, *, world_s: float, runs: int, quick: bool) -> SpeedResult:
    """The same over a distance of one's own."""
    plan = make_plan(
        vehicle=load_vehicle("tabby_evo"),
        road=open_road("campus"),
        planner_period_ns=PLANNER_PERIOD_NS,
        distance_m=distance_m,
    )
    _drive(plan)  # imports and caches are no part of the speed
    drives = tuple(_timed_drive(plan) for _ in range(runs))
    parked = tuple(_timed(_parked(), world_s) for _ in range(runs))
    watched = tuple(_timed_watched(world_s) for _ in range(runs))
    profile = cProfile.Profile()
    stage = VirtualStage(plan, 0)
    profile.enable()
    _drive_stage(stage, plan)
    profile.disable()
    return SpeedResult(
        quick=quick, drives=drives, parked=parked, watched=watched,
        shares=split_by_part(pstats.Stats(profile)),
    )


def _drive(plan: DrivePlan) -> float:
    return _drive_stage(VirtualStage(plan, 0), plan)


def _drive_stage(stage: VirtualStage, plan: DrivePlan) -> float:
    with stage:
        end = drive(stage, plan, lambda progress: None)
    assert not end.ended_early, end.ended_early
    return stage.log.end_s


def _timed_drive(plan: DrivePlan) -> SpeedRun:
    stage = VirtualStage(plan, 0)
    start_ns = time.monotonic_ns()
    cpu = cpu_s(lambda: _drive_stage(stage, plan))
    wall_s = (time.monotonic_ns() - start_ns) * 1e-9
    return SpeedRun(
        virtual_s=stage.log.end_s, cpu_s=cpu, wall_s=wall_s, reference_s=reference_loop_s()
    )


def _parked() -> World:
    return World(load_vehicle("tabby_evo"), 0, keep_frames=False)


def _timed_watched(span_s: float) -> SpeedRun:
    rig = Rig(0)
    oracle = Oracle(rig.world.vehicle)
    Observer(rig.world, oracle)
    rig.drive_to(SPEED_MPS, CURVATURE_PER_M)
    rig.stop_listening()
    run = _timed(rig.world, span_s)
    report = oracle.finish(rig.world.now_ns)
    assert rig.is_driving and not report.violations, report
    return run


def _timed(world: World, span_s: float) -> SpeedRun:
    start_ns = time.monotonic_ns()
    cpu = cpu_s(lambda: world.run_for(span_s))
    wall_s = (time.monotonic_ns() - start_ns) * 1e-9
    return SpeedRun(virtual_s=span_s, cpu_s=cpu, wall_s=wall_s, reference_s=reference_loop_s())
