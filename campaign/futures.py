"""Every kind of fault, at every target, alone in a car that drives itself: what came of it.

One drive for each seed runs up to the fault and is forked there, so that all futures have the same
past. `campaign.fault_docs` writes what two documents tell of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from campaign.fork import in_a_fork
from campaign.result import SeedResult
from campaign.run import Scenario, build, finish
from campaign.settings import CampaignSettings
from simulation.fault_kinds import FaultKind, targets_of
from simulation.faults import Fault
from telemetry.bus_log import BusLog
from telemetry.why.incident import Cause, Incident, Kind
from telemetry.why.watch import Watch
from vehicles import Vehicle, load_vehicle

CARS = ("tabby_evo", "baja_5b")
"""Kinds of fault that the first cannot have strike the second: its motors hang on drives."""
SEEDS = (1, 2)
BEGIN_S = 8.0
"""Engaged for some six seconds by then, and in a bend, for these seeds."""
FAULT_S = 2.0
WATCH_S = 4.0
NS_PER_S = 1_000_000_000
BEGIN_NS = round(BEGIN_S * NS_PER_S)
END_NS = round((BEGIN_S + WATCH_S) * NS_PER_S)


@dataclass(frozen=True, slots=True, kw_only=True)
class Future:
    """What came of one fault.

    Attributes:
        fault: The only one.
        result: Of the drive, with one injection.
        cause: What `dbw why` names first, of the first incident from the fault on that ended the
            drive; None: it tells of none.
    """

    fault: Fault
    result: SeedResult
    cause: Cause | None


def cases() -> Iterator[tuple[str, list[Fault]]]:
    """Every kind with every target, in the first car that can have it."""
    done: set[FaultKind] = set()
    for car in CARS:
        targets = targets_of(load_vehicle(car))
        yield car, [
            Fault(kind=kind, target=target, at_s=BEGIN_S, for_s=FAULT_S)
            for kind, names in targets.items()
            for target in names
            if kind not in done
        ]
        done.update(targets)


def futures(seeds: Sequence[int] = SEEDS) -> Iterator[Future]:
    """Every case in every drive."""
    for car, faults in cases():
        for seed in seeds:
            scenario = build(CampaignSettings(vehicle=car), seed)
            log = BusLog()
            scenario.world.wire.witnesses.append(log)
            scenario.world.run_until(BEGIN_NS)
            for fault in faults:
                yield in_a_fork(partial(_future, scenario, log, seed, fault))


def _future(scenario: Scenario, log: BusLog, seed: int, fault: Fault) -> Future:
    scenario.injector.begin(fault)
    scenario.world.run_until(END_NS)
    result = finish(scenario, seed)
    return Future(fault=fault, result=result, cause=first_cause(log, scenario.world.vehicle))


def first_cause(log: BusLog, vehicle: Vehicle) -> Cause | None:
    """The cause of the first incident from `BEGIN_NS` on that ended a drive."""
    for item in Watch(vehicle).follow(log.frames()):
        if (
            isinstance(item, Incident)
            and item.kind is not Kind.REFUSED_ENGAGEMENT
            and item.time_ns >= BEGIN_NS
        ):
            return item.cause
    return None
