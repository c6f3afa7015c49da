"""One seed from power-on to the verdict."""

from __future__ import annotations

import resource
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from campaign.ledger import Ledger
from campaign.pilot import Pilot
from campaign.result import SeedResult, ViolationResult
from campaign.settings import CampaignSettings
from campaign.swarm import storms
from oracle.judge import Oracle
from simulation.fault_kinds import KINDS, Strikes, targets_of
from simulation.faults import Fault
from simulation.injector import Injector
from simulation.observer import Observer
from simulation.world import World

FAULT_STREAM = 1
"""Sets the generator of a seed's faults apart from the world's own."""
FALSE_TRIP = "no emergency brake without a reason"
NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A world with everything that a seed attaches to it, at its beginning."""

    world: World
    oracle: Oracle
    ledger: Ledger
    injector: Injector
    pilot: Pilot


def build(settings: CampaignSettings, seed: int) -> Scenario:
    """The world of a seed, without faults planned."""
    world = World(settings.car, seed, keep_frames=False)
    oracle = Oracle(settings.car)
    ledger = Ledger(world, oracle)
    injector = Injector(world, world.fault_rng)
    injector.listeners.append(ledger.on_fault)
    injector.corruption_listeners.append(oracle.on_corruption)

    def is_busy() -> bool:
        return any(KINDS[fault.kind].strikes is Strikes.CONTROL for fault in injector.active)

    pilot = Pilot(world, world.planner_rng, lambda: injector.planner, is_busy)
    Observer(world, oracle, pilot.path_error_m)
    return Scenario(world=world, oracle=oracle, ledger=ledger, injector=injector, pilot=pilot)


def run_seed(
    settings: CampaignSettings,
    seed: int,
    *,
    faults: Sequence[Fault] | None = None,
    watch: Callable[[World], None] | None = None,
) -> SeedResult:
    """Runs one seed.

    Args:
        settings: Of the campaign.
        seed: Of everything that is left to chance: the world, the route, the faults.
        faults: In place of those that the seed draws (`faults_of`), all else being equal.
        watch: Given the world before it begins, to attach a recorder.
    """
    before_s = _cpu_s()
    scenario = build(settings, seed)
    scenario.injector.plan(faults_of(settings, seed) if faults is None else list(faults))
    if watch is not None:
        watch(scenario.world)
    scenario.world.run_until(round(settings.seed_s * NS_PER_S))
    return finish(scenario, seed, before_s)


def faults_of(settings: CampaignSettings, seed: int) -> list[Fault]:
    """The faults that a seed draws, with their times, in order."""
    rng = np.random.default_rng((seed, FAULT_STREAM))
    plan = settings.faults
    if plan is None:
        return storms(settings.seed_s, rng, targets_of(settings.car))
    return plan.draw(settings.seed_s, rng)


def finish(scenario: Scenario, seed: int, begin_cpu_s: float = 0.0) -> SeedResult:
    """What came of a scenario until now; its faults may still be there."""
    report = scenario.oracle.finish(scenario.world.now_ns)
    ledger = scenario.ledger
    broken = [
        ViolationResult(property=item.property, at_s=item.true_ns / NS_PER_S, text=item.text)
        for item in report.violations
    ]
    return SeedResult(
        seed=seed,
        simulated_s=scenario.world.now_ns / NS_PER_S,
        engaged_s=round(ledger.engaged_s, 6),
        calm_s=round(ledger.calm_s, 6),
        stops=ledger.stops,
        false_trips=report.counts.get(FALSE_TRIP, 0),
        repairs_s=tuple(ledger.repairs_s),
        injections=ledger.results(report.reactions),
        violations=tuple(sorted([*broken, *ledger.violations], key=lambda item: item.at_s)),
        excused=len(report.excused),
        corruptions=report.corruptions.count,
        corruptions_unseen=report.corruptions.unseen,
        trace_sha256=scenario.world.trace.sha256,
        cpu_s=_cpu_s() - begin_cpu_s,
    )


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime
