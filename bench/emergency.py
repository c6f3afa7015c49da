"""From every cause to the emergency brake, for many seeds, beside the design's time budget.

Each seed drives one world to the same state; each cause begins in a fork of it (`campaign.fork`),
at a phase of its own within 100 ms, which is a whole number of every node's and the planner's
cycles.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median

import numpy as np

from bench.causes import CAUSES, Cause, Origin, brake_budget_ns, bus_budget_ns
from bench.false_trips import FaultFree, Losses, measure_fault_free, measure_losses
from bench.rig import NS_PER_MS, NS_PER_S, TABBY, Rig, told
from bench.spread import spread
from bench.table import Table, command_line, met
from campaign.fork import in_a_fork
from canbus.frame import Frame

NAME = "emergency"
SEEDS, QUICK_SEEDS = 200, 10
SPEED_MPS = 5.0
CURVATURE_PER_M = 0.03
PHASE_NS_MAX = 100 * NS_PER_MS
BRAKE_RATIO = 0.9
LOOK_NS = NS_PER_MS
"""The brake is looked at this often; the plant's own step is as long."""

QUICK_STRIDE = 29
FAULT_FREE_DRIVES, FAULT_FREE_S = 10, 60.0
QUICK_FAULT_FREE_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One cause in one world."""

    cause: str
    seed: int
    bus_ns: int | None
    """From the origin to the end of the first EMERGENCY_BRAKE; None without one."""
    brake_ns: int | None
    """From the origin to 90 % brake; None without."""
    lead_ns: int
    """From the cause to the origin."""
    first: str
    """What the first EMERGENCY_BRAKE said."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseResult:
    """All samples of one cause."""

    cause: Cause
    samples: tuple[Sample, ...]

    def worst(self, kind: str) -> Sample:
        """The slowest, never counting as slowest of all."""
        return max(self.samples, key=lambda sample: _never_last(getattr(sample, kind)))

    def median_ns(self, kind: str) -> float:
        """Median; infinite when most never came."""
        return median(_never_last(getattr(sample, kind)) for sample in self.samples)

    @property
    def firsts(self) -> str:
        """What was heard first, the most frequent in front."""
        counts = Counter(sample.first for sample in self.samples)
        return ", ".join(first for first, _ in counts.most_common(2))

    @property
    def is_within_budget(self) -> bool:
        """Bus, unless nothing can get out, and brake."""
        bus_ns = _never_last(self.worst("bus_ns").bus_ns)
        brake_ns = _never_last(self.worst("brake_ns").brake_ns)
        is_heard_in_time = not self.cause.is_heard or bus_ns <= bus_budget_ns(self.cause, TABBY)
        return is_heard_in_time and brake_ns <= brake_budget_ns(self.cause, TABBY)


def _never_last(span_ns: int | None) -> float:
    return float("inf") if span_ns is None else span_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class EmergencyResult:
    """What `measure` answers."""

    quick: bool
    seeds: int
    causes: tuple[CauseResult, ...]
    losses: tuple[Losses, ...]
    fault_free: FaultFree

    def tables(self) -> list[Table]:
        """Times per cause, and what must not brake."""
        return [self._times(), *self._leads(), self._no_trips()]

    def _times(self) -> Table:
        rows = []
        for result in self.causes:
            cause = result.cause
            bus, brake = result.worst("bus_ns"), result.worst("brake_ns")
            budget = f"{_ms(bus_budget_ns(cause, TABBY))}"
            cells = [_ms(result.median_ns("bus_ns")), _ms(bus.bus_ns), budget, str(bus.seed)]
            if not cause.is_heard:
                cells = ["-", "-", "-", "-"]
            rows.append(
                (cause.name, cause.budget.value, *cells, _ms(result.median_ns("brake_ns")),
                 _ms(brake.brake_ns), _ms(brake_budget_ns(cause, TABBY)), str(brake.seed),
                 met(result.is_within_budget), result.firsts)
            )
        return Table(
            title="From the cause to EMERGENCY_BRAKE on the bus, and to 90 % brake",
            command=command_line(NAME, quick=self.quick),
            headers=("cause", "kind", "bus: median, ms", "worst", "budget", "seed",
                     "90 % brake: median, ms", "worst", "budget", "seed", "", "first on the bus"),
            rows=rows,
            notes=(
                f"{self.seeds} seeds at {SPEED_MPS:g} m/s in a bend of "
                f"{1 / CURVATURE_PER_M:.0f} m, the cause at a random phase within 100 ms; \"seed\" "
                "is that of the worst case. Times end with the frame on the wire, and with the "
                "servo's true position.",
                "Budgets of the design: sensed 20 ms and the wire (a longest frame under way and "
                f"the frame itself, {_ms(bus_budget_ns(_SENSED, TABBY) - 20 * NS_PER_MS)} ms); "
                "silent 75 ms; planner the age limit of 85 ms and 15 ms; monitor the time its own "
                "check allows and then as sensed. Then 290 ms, the servo's whole travel.",
                "The time counts from the cause; for a stranger's frame from its end on the wire; "
                "for a silent planner from its last decision; for the monitor's divergence checks "
                "from the status frame that first exceeds the limit.",
            ),
        )

    def _leads(self) -> list[Table]:
        rows = [
            (result.cause.name, _ms(median(leads)), _ms(max(leads)))
            for result in self.causes
            if result.cause.origin is Origin.LIMIT
            and (leads := [sample.lead_ns for sample in result.samples])
        ]
        if not rows:
            return []
        return [
            Table(
                title="From the fault to the limit that the monitor watches",
                command=command_line(NAME, quick=self.quick),
                headers=("cause", "median, ms", "longest"),
                rows=rows,
                notes=("What a fault takes to show; comes before the times above.",),
            )
        ]

    def _no_trips(self) -> Table:
        rows = [
            (loss.situation, str(loss.runs), f"{loss.identifiers} identifiers",
             str(len(loss.trips)), met(not loss.trips))
            for loss in self.losses
        ]
        free = self.fault_free
        rows.append(
            ("no fault at all: speeds and bends at random", str(free.drives),
             f"{free.span_s / 60:.1f} min, {free.frames} frames", str(len(free.trips)),
             met(not free.trips))
        )
        trips = [trip for loss in self.losses for trip in loss.trips] + list(free.trips)
        return Table(
            title="What must not brake",
            command=command_line(NAME, quick=self.quick),
            headers=("situation", "runs", "seen", "false trips", ""),
            rows=rows,
            notes=[f"False trip: {trip}" for trip in trips],
        )


_SENSED = CAUSES["emergency-stop input"]


def _ms(span_ns: float | None) -> str:
    if span_ns is None or span_ns == float("inf"):
        return "never"
    return f"{span_ns / NS_PER_MS:.1f}"


def measure(*, quick: bool = False) -> EmergencyResult:
    """All causes, all losses."""
    seeds = range(QUICK_SEEDS if quick else SEEDS)
    return EmergencyResult(
        quick=quick,
        seeds=len(seeds),
        causes=measure_causes(seeds, list(CAUSES)),
        losses=measure_losses(stride=QUICK_STRIDE if quick else 1),
        fault_free=measure_fault_free(
            range(2 if quick else FAULT_FREE_DRIVES), QUICK_FAULT_FREE_S if quick else FAULT_FREE_S
        ),
    )


def measure_causes(seeds: Sequence[int], names: Sequence[str]) -> tuple[CauseResult, ...]:
    """The causes of these names in worlds of these seeds."""
    by_seed = spread(partial(samples_of_seed, names=tuple(names)), seeds)
    return tuple(
        CauseResult(
            cause=CAUSES[name],
            samples=tuple(sample for samples in by_seed for sample in samples
                          if sample.cause == name),
        )
        for name in names
    )


def samples_of_seed(seed: int, names: Sequence[str]) -> list[Sample]:
    """One world, driven to the state and forked for each cause."""
    rig = Rig(seed)
    rig.drive_to(SPEED_MPS, CURVATURE_PER_M)
    order = list(CAUSES)
    return [
        in_a_fork(partial(sample_of, rig, CAUSES[name], order.index(name))) for name in names
    ]


def sample_of(rig: Rig, cause: Cause, number: int) -> Sample:
    """Lets the cause begin at its phase, and watches; changes the rig for good."""
    phase_ns = int(np.random.default_rng((rig.seed, 2, number)).integers(PHASE_NS_MAX))
    rig.world.run_until(rig.world.now_ns + phase_ns)
    assert rig.is_driving, rig.world.events
    limit = LimitWatch(rig, cause)
    begin_ns = rig.world.now_ns
    cause.begin(rig)
    brake_ns = _brake_time_ns(rig, begin_ns + round(cause.watch_s * NS_PER_S))
    origin_ns = _origin_ns(rig, cause, begin_ns, limit)
    return Sample(
        cause=cause.name,
        seed=rig.seed,
        bus_ns=None if rig.emergency is None else rig.emergency[0] - origin_ns,
        brake_ns=None if brake_ns is None else brake_ns - origin_ns,
        lead_ns=origin_ns - begin_ns,
        first="-" if rig.emergency is None or not cause.is_heard else told(rig.emergency[2]),
    )


def _brake_time_ns(rig: Rig, end_ns: int) -> int | None:
    """When the servo has gone nine tenths of its way."""
    while rig.world.now_ns < end_ns:
        rig.world.run_until(rig.world.now_ns + LOOK_NS)
        if rig.car.truth.servo_position_ratio >= BRAKE_RATIO:
            return rig.world.now_ns
    return None


def _origin_ns(rig: Rig, cause: Cause, begin_ns: int, limit: LimitWatch) -> int:
    if cause.origin is Origin.FRAME:
        assert rig.stranger_ns is not None
        return rig.stranger_ns
    if cause.origin is Origin.DECISION:
        return rig.decided_ns
    if cause.origin is Origin.LIMIT and limit.since_ns is not None:
        return limit.since_ns
    return begin_ns


class LimitWatch:
    """Since when, without a gap, the bus has told of a limit exceeded; stops at the emergency."""

    def __init__(self, rig: Rig, cause: Cause) -> None:
        self._rig = rig
        self._exceeds = cause.exceeds
        self.since_ns: int | None = None
        if cause.exceeds is not None:
            rig.world.wire.witnesses.append(self._witness)

    def _witness(self, true_ns: int, sender: str, frame: Frame) -> None:
        assert self._exceeds is not None
        if self._rig.emergency is not None:
            return
        if not self._exceeds(self._rig):
            self.since_ns = None
        elif self.since_ns is None:
            self.since_ns = true_ns

