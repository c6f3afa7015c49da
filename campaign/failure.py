"""What it is for a seed to fail, and a result for one that has none."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self

from campaign.result import InjectionResult, SeedResult, ViolationResult
from campaign.settings import CampaignSettings
from simulation.faults import Fault

EXCEPTION = "no exception"
WORKER_LIVES = "no dead worker"
"""Properties of the campaign itself."""
TEXT_MAX = 8000
"""Characters of a traceback's end."""
LISTED_MAX = 20
"""So many failing seeds are told of one by one."""


class RunSeed(Protocol):
    """`campaign.run.run_seed`, or a stand-in."""

    def __call__(
        self, settings: CampaignSettings, seed: int, *, faults: Sequence[Fault] | None = None
    ) -> SeedResult:
        """Runs one seed."""


FaultsOf = Callable[[CampaignSettings, int], list[Fault]]
"""`campaign.run.faults_of`, or a stand-in."""


def failures_of(result: SeedResult) -> tuple[str, ...]:
    """What went wrong in a seed, once each: broken properties, missed faults, false trips."""
    broken = [violation.property for violation in result.violations]
    missed = [f"{named(item)} missed" for item in result.injections if item.is_missed]
    tripped = ["false trip"] if result.false_trips else []
    return tuple(dict.fromkeys(broken + missed + tripped))


def named(item: InjectionResult) -> str:
    """A fault in a few words."""
    return f"{item.kind} of {item.target}" if item.target else item.kind


def what_followed(item: InjectionResult) -> str:
    """What a fault asked for, and what came: `brake within 200 ms: 71.3 ms, ER2 NODE_SILENT`."""
    within = "" if item.budget_ms is None else f" within {item.budget_ms:g} ms"
    came = "nothing" if item.latency_ms is None else f"{item.latency_ms:.1f} ms"
    code = f", {item.code}" if item.code else ""
    missed = ", MISSED" if item.is_missed else "" if item.is_due else ", not due"
    return f"{item.demand}{within}: {came}{code}{missed}"


def first_failure(result: SeedResult) -> str:
    """In a line, with numbers; empty for a seed that did not fail."""
    for violation in result.violations:
        lines = violation.text.strip().splitlines() or [""]  # of a traceback, the last one tells
        return f"at {violation.at_s:.3f} s: {violation.property}: {lines[-1].strip()}"
    for item in result.injections:
        if item.is_missed:
            return f"at {item.at_s:.3f} s: {named(item)}: {what_followed(item)}"
    return f"{result.false_trips} false trips" if result.false_trips else ""


@dataclass(slots=True)
class Tally:
    """Counts over the seeds of a campaign.

    Attributes:
        failing: First failing seeds that were told of, each with its first failure.
    """

    seeds: int = 0
    simulated_s: float = 0.0
    engaged_s: float = 0.0
    injections: int = 0
    violations: int = 0
    missed: int = 0
    false_trips: int = 0
    failing_seeds: int = 0
    failing: dict[int, str] = field(default_factory=dict)

    @classmethod
    def of(cls, results: Iterable[SeedResult]) -> Self:
        """All of them."""
        tally = cls()
        for result in results:
            tally.add(result)
        return tally

    def add(self, result: SeedResult) -> None:
        """One more seed."""
        self.seeds += 1
        self.simulated_s += result.simulated_s
        self.engaged_s += result.engaged_s
        self.injections += len(result.injections)
        self.violations += len(result.violations)
        self.missed += sum(item.is_missed for item in result.injections)
        self.false_trips += result.false_trips
        failure = first_failure(result)
        if failure:
            self.failing_seeds += 1
            if len(self.failing) < LISTED_MAX:
                self.failing[result.seed] = failure


def run_or_tell(
    run_seed: RunSeed,
    settings: CampaignSettings,
    seed: int,
    *,
    faults: Sequence[Fault] | None = None,
) -> SeedResult:
    """A seed's result; an exception is a failure of the seed, and not the campaign's end."""
    try:
        return run_seed(settings, seed, faults=faults)
    except Exception:
        return failed(seed, EXCEPTION, traceback.format_exc()[-TEXT_MAX:])


def failed(seed: int, broken: str, text: str) -> SeedResult:
    """The result of a seed that has none: a property of the campaign itself broke."""
    return SeedResult(
        seed=seed,
        simulated_s=0.0,
        engaged_s=0.0,
        calm_s=0.0,
        stops=0,
        false_trips=0,
        repairs_s=(),
        injections=(),
        violations=(ViolationResult(property=broken, at_s=0.0, text=text),),
        excused=0,
        corruptions=0,
        corruptions_unseen=0,
        trace_sha256="",
        cpu_s=0.0,
    )


def worker_died(seed: int) -> SeedResult:
    """The result of a seed that killed its workers."""
    return failed(seed, WORKER_LIVES, "the process that ran the seed died, each time")


def faults_or_none(
    faults_of: FaultsOf, settings: CampaignSettings, seed: int
) -> tuple[Fault, ...]:
    """The faults that a seed draws; none if even that fails, as running it then has."""
    try:
        return tuple(faults_of(settings, seed))
    except Exception:
        return ()
