"""What must not brake the car: a single lost frame, whichever it is, and no fault at all.

Every frame of a stretch of time is lost once, each in a fork of the same world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial

import numpy as np

from bench.rig import NS_PER_S, Rig
from bench.spread import spread
from campaign.fork import in_a_fork
from canbus.frame import Frame
from dbc.messages import Request

DRIVING_FRAMES = 240
"""A quarter of a second: every cyclic frame comes at least five times."""
ENGAGING_FRAMES = 200
"""From the request until well after AUTOMATIC has begun."""
WATCH_S = 0.25
"""After the loss; silence is noticed within 75 ms, a stale decision within 100 ms."""
LOOK_S = 0.005
MANOEUVRE_S = 2.0
SPEEDS_MPS = (0.0, 1.0, 2.5, 4.0, 5.5, 6.9)
LATERAL_MPS2_MAX = 0.9
"""From one side to the other within 0.5 s stays below the monitor's 5 m/s3."""
CURVATURE_PER_M_MAX = 0.08


class Situation(Enum):
    """When the frame is lost."""

    DRIVING = "driving, one frame lost"
    ENGAGING = "engaging, one frame lost"


@dataclass(frozen=True, slots=True, kw_only=True)
class LossRun:
    """A world in which frames are lost one by one."""

    situation: Situation
    seed: int
    stride: int
    """Every so many frames; 1 for each."""
    one_receiver: bool
    """Lost on the way to one receiver, chosen by chance, instead of to all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """One frame lost."""

    can_id: int | None
    """None when nothing was: the receiver chosen does not listen to the frame, or sent it."""
    trip: str
    """What came of it; empty when nothing did."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Losses:
    """All losses of one situation."""

    situation: str
    runs: int
    identifiers: int
    """How many different ones were lost."""
    trips: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultFree:
    """Drives in which nothing is broken."""

    drives: int
    span_s: float
    frames: int
    trips: tuple[str, ...]


def measure_losses(*, stride: int = 1) -> tuple[Losses, ...]:
    """Each of the situations, with every `stride`-th frame lost."""
    runs = [
        LossRun(situation=situation, seed=seed, stride=stride, one_receiver=one_receiver)
        for situation in Situation
        for one_receiver in (False, True)
        for seed in (0, 1)
    ]
    results = spread(losses_of, runs)
    summaries: dict[str, list[Loss]] = {}
    for run, losses in zip(runs, results, strict=True):
        whom = "for one receiver" if run.one_receiver else "for all"
        summaries.setdefault(f"{run.situation.value} {whom}", []).extend(losses)
    return tuple(_summary(situation, losses) for situation, losses in summaries.items())


def _summary(situation: str, losses: Sequence[Loss]) -> Losses:
    identifiers = [loss.can_id for loss in losses if loss.can_id is not None]
    return Losses(
        situation=situation,
        runs=len(identifiers),
        identifiers=len(set(identifiers)),
        trips=tuple(loss.trip for loss in losses if loss.trip),
    )


def losses_of(run: LossRun) -> list[Loss]:
    """One world, forked for each frame that is lost."""
    rig = Rig(run.seed)
    if run.situation is Situation.DRIVING:
        rig.drive_to(4.0, 0.03)
        count = DRIVING_FRAMES
    else:
        rig.make_ready()
        count = ENGAGING_FRAMES
    return [
        in_a_fork(partial(_lose, rig, run, number)) for number in range(0, count, run.stride)
    ]


def _lose(rig: Rig, run: LossRun, number: int) -> Loss:
    """Loses the frame that comes after `number` others."""
    target = rig.frames + 1 + number
    stations = list(rig.world.stations)
    receiver = stations[int(np.random.default_rng((run.seed, 3, number)).integers(len(stations)))]
    lost: list[Frame] = []

    def keep(true_ns: int, sender: str, frame: Frame, to: str) -> bool:
        if rig.frames != target or (run.one_receiver and to != receiver):
            return True
        lost.append(frame)
        return False

    rig.world.wire.filters.append(keep)
    if run.situation is Situation.ENGAGING:
        rig.request(Request.ENGAGE)
    while rig.frames < target:
        rig.world.run_for(LOOK_S)
    rig.world.run_for(WATCH_S)
    can_id = lost[0].can_id if lost else None
    if rig.is_driving:
        return Loss(can_id=can_id, trip="")
    whom = f" for {receiver}" if run.one_receiver else ""
    what = f"{lost[0]}{whom}" if lost else "nothing lost"
    where = f"{run.situation.value}, seed {run.seed}, number {number}"
    return Loss(can_id=can_id, trip=f"{where}: {what}: {rig.how_it_ended()}")


def measure_fault_free(seeds: Sequence[int], span_s: float) -> FaultFree:
    """Drives of `span_s` each, at speeds and in bends that change every two seconds."""
    results = spread(partial(_drive_freely, span_s=span_s), seeds)
    return FaultFree(
        drives=len(seeds),
        span_s=span_s * len(seeds),
        frames=sum(frames for frames, _ in results),
        trips=tuple(trip for _, trip in results if trip),
    )


def _drive_freely(seed: int, span_s: float) -> tuple[int, str]:
    rig = Rig(seed)
    rig.drive_to(4.0, 0.0)
    rng = np.random.default_rng((seed, 4))
    end_ns = rig.world.now_ns + round(span_s * NS_PER_S)
    while rig.world.now_ns < end_ns:
        speed_mps = SPEEDS_MPS[int(rng.integers(len(SPEEDS_MPS)))]
        fastest_mps = max(speed_mps, rig.car.truth.speed_mps, 1.0)
        curvature_per_m = min(LATERAL_MPS2_MAX / fastest_mps**2, CURVATURE_PER_M_MAX)
        rig.speed_mps = speed_mps
        rig.curvature_per_m = float(rng.uniform(-curvature_per_m, curvature_per_m))
        rig.world.run_for(MANOEUVRE_S)
        if not rig.is_driving:
            at_s = rig.world.now_ns / NS_PER_S
            return rig.frames, f"fault-free, seed {seed}, {at_s:.1f} s: {rig.how_it_ended()}"
    return rig.frames, ""
