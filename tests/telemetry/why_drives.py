"""A car that drives itself, and what its bus carries when something goes wrong: made once a run."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache, partial

from campaign.fork import in_a_fork
from campaign.futures import BEGIN_NS
from campaign.run import Scenario, build
from campaign.settings import CampaignSettings
from canbus.frame import Frame
from simulation.faults import Fault
from telemetry.bus_log import BusLog
from telemetry.why.incident import Incident
from telemetry.why.watch import Told, Watch
from vehicles import load_vehicle

Frames = tuple[tuple[int, Frame], ...]
VEHICLE = load_vehicle("tabby_evo")


@cache
def _drive() -> tuple[Scenario, BusLog]:
    scenario = build(CampaignSettings(), 1)
    log = BusLog()
    scenario.world.wire.witnesses.append(log)
    scenario.world.run_until(BEGIN_NS)
    return scenario, log


@cache
def frames_with(*faults: Fault, for_s: float = 2.5) -> Frames:
    """All frames of a drive in which these faults begin at `BEGIN_NS`, and of `for_s` after."""
    scenario, log = _drive()
    return in_a_fork(partial(_future, scenario, log, faults, for_s))


def _future(scenario: Scenario, log: BusLog, faults: Iterable[Fault], for_s: float) -> Frames:
    for fault in faults:
        scenario.injector.begin(fault)
    scenario.world.run_until(BEGIN_NS + round(for_s * 1e9))
    return tuple(log.frames())


def told_of(frames: Iterable[tuple[int, Frame]]) -> list[Told]:
    """Everything that a watch tells of these frames."""
    return list(Watch(VEHICLE).follow(frames))


def incidents_of(frames: Iterable[tuple[int, Frame]]) -> list[Incident]:
    """Incidents alone."""
    return [item for item in told_of(frames) if isinstance(item, Incident)]


def candump(frames: Iterable[tuple[int, Frame]]) -> str:
    """The frames as `candump -L` writes them."""
    return "".join(f"({ns // 10**9}.{ns % 10**9 // 1000:06d}) vcan0 {f}\n" for ns, f in frames)
