"""A campaign added up, seed by seed: what is kept does not grow with its injections."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from campaign.result import Demand, InjectionResult, SeedResult, ViolationResult
from campaign.settings import S_PER_H
from campaign.statistics import Moments

STEP_MS = 0.1
"""Latencies are counted in steps of this, each rounded up."""
SHARE_STEPS = 50
"""Steps of a fault's interval, for its distribution."""
LISTED_MAX = 200
"""Failing seeds and violations told one by one; all are counted."""
REASONS_MAX = 5
"""Of one failing seed."""


class Latencies:
    """How often each latency came; an answer that never came is later than all."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self._shares: Counter[int] = Counter()
        self.never = 0
        self.max_ms = math.nan
        """The longest that came; NaN if none did."""
        self.share_max = math.nan
        """The same in shares of its own interval."""

    def add(self, latency_ms: float | None, budget_ms: float) -> None:
        """Counts one answer, or its absence."""
        if latency_ms is None:
            self.never += 1
            return
        share = latency_ms / budget_ms
        self._counts[_step(latency_ms / STEP_MS)] += 1
        self._shares[max(_step(share * SHARE_STEPS), 1)] += 1
        self.max_ms = latency_ms if math.isnan(self.max_ms) else max(self.max_ms, latency_ms)
        self.share_max = share if math.isnan(self.share_max) else max(self.share_max, share)

    @property
    def answered(self) -> int:
        """How many came."""
        return sum(self._counts.values())

    def percentile_ms(self, percent: float) -> float:
        """The latency that so many per cent keep to, rounded up to a step or to the longest.

        One that came (nearest rank); infinite if too few came at all, NaN if none was due.
        """
        wanted = self.answered + self.never
        rank = max(math.ceil(round(wanted * percent / 100.0, 9)), 1)
        if not wanted:
            return math.nan
        for step in sorted(self._counts):
            rank -= self._counts[step]
            if rank <= 0:
                return min(round(step * STEP_MS, 1), self.max_ms)
        return math.inf

    def distribution(self) -> tuple[list[int], int]:
        """Answers in each step of their interval, and how many came after it."""
        within = [self._shares[step] for step in range(1, SHARE_STEPS + 1)]
        return within, self.answered - sum(within)

    def within(self, share: float) -> int:
        """Answers that took no more than this share of their interval, to the step."""
        last = math.floor(round(share * SHARE_STEPS, 6))
        return sum(count for step, count in self._shares.items() if step <= last)


def _step(value: float) -> int:
    """The step that a value falls into, each with its upper end."""
    return math.ceil(round(value, 6))  # 74.3 / 0.1 is no more than 743


class FaultTally:
    """What came of one kind of fault."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.injections = 0
        self.clean = 0
        self.due = 0
        self.detected = 0
        self.handled = 0
        self.missed = 0
        self.trials = 0
        """Clean injections that could have been missed."""
        self.trials_missed = 0
        self.budgets_ms: set[float] = set()
        self.latencies = Latencies()

    def add(self, injection: InjectionResult, *, is_handled: bool) -> None:
        """Counts one injection."""
        self.injections += 1
        self.clean += injection.is_clean
        self.due += injection.is_due
        self.detected += injection.is_detected
        self.handled += is_handled
        self.missed += injection.is_missed
        if is_trial(injection):
            self.trials += 1
            self.trials_missed += injection.is_missed
        if injection.is_due and injection.budget_ms is not None:
            self.budgets_ms.add(injection.budget_ms)
            self.latencies.add(injection.latency_ms, injection.budget_ms)


def is_trial(injection: InjectionResult) -> bool:
    """Whether it tells something about the probability of a miss.

    It was clean, and either due or of those that must not stop the car.
    """
    return injection.is_clean and (injection.is_due or injection.demand is Demand.GO_ON)


def is_handled(injection: InjectionResult, violations: Iterable[ViolationResult]) -> bool:
    """Whether the car came through it as it should.

    A fault that was due: answered in time. Any other: it was not missed, and from its beginning
    to its seed's end no property broke.
    """
    if injection.is_missed or injection.is_due:
        return not injection.is_missed
    return all(violation.at_s < injection.at_s for violation in violations)


@dataclass(frozen=True, slots=True, kw_only=True)
class FailingSeed:
    """A seed in which something was missed, broke, or stopped without a cause."""

    seed: int
    reasons: tuple[str, ...]
    """In words; the first few."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedViolation:
    """A violation and where it was found."""

    seed: int
    violation: ViolationResult


@dataclass(slots=True)
class CampaignTally:
    """All seeds so far."""

    seeds: int = 0
    seed_first: int | None = None
    seed_last: int | None = None
    simulated_s: float = 0.0
    engaged_s: float = 0.0
    calm_s: float = 0.0
    cpu_s: float = 0.0
    stops: int = 0
    false_trips: int = 0
    repairs_h: Moments = field(default_factory=Moments)
    property_violations: int = 0
    excused: int = 0
    corruptions: int = 0
    corruptions_unseen: int = 0
    faults: dict[str, FaultTally] = field(default_factory=dict)
    failing_seeds: list[int] = field(default_factory=list)
    failures: list[FailingSeed] = field(default_factory=list)
    """Of the first failing seeds."""
    violations: list[SeedViolation] = field(default_factory=list)
    """The first ones."""
    _digest: hashlib._Hash = field(default_factory=hashlib.sha256)

    @property
    def trace_sha256(self) -> str:
        """Of the seeds' own hashes, as text, one after the other."""
        return self._digest.hexdigest()

    def add(self, result: SeedResult) -> None:
        """Takes one more seed in.

        Raises:
            ValueError: It does not come after the last one: the hash depends on the order.
        """
        if self.seed_last is not None and result.seed <= self.seed_last:
            raise ValueError(
                f"seed {result.seed} after {self.seed_last}: seeds are wanted in order, each once"
            )
        if self.seed_first is None:
            self.seed_first = result.seed
        self.seed_last = result.seed
        self._digest.update(result.trace_sha256.encode())
        self._add_counts(result)
        for injection in result.injections:
            if injection.kind not in self.faults:
                self.faults[injection.kind] = FaultTally(injection.kind)
            self.faults[injection.kind].add(
                injection, is_handled=is_handled(injection, result.violations)
            )
        self._add_failures(result)

    def _add_counts(self, result: SeedResult) -> None:
        self.seeds += 1
        self.simulated_s += result.simulated_s
        self.engaged_s += result.engaged_s
        self.calm_s += result.calm_s
        self.cpu_s += result.cpu_s
        self.stops += result.stops
        self.false_trips += result.false_trips
        for repair_s in result.repairs_s:
            self.repairs_h.add(repair_s / S_PER_H)
        self.property_violations += len(result.violations)
        self.excused += result.excused
        self.corruptions += result.corruptions
        self.corruptions_unseen += result.corruptions_unseen

    def _add_failures(self, result: SeedResult) -> None:
        reasons = reasons_of(result)
        if not reasons:
            return
        self.failing_seeds.append(result.seed)
        if len(self.failures) < LISTED_MAX:
            if len(reasons) > REASONS_MAX:
                reasons[REASONS_MAX:] = [f"and {len(reasons) - REASONS_MAX} more"]
            self.failures.append(FailingSeed(seed=result.seed, reasons=tuple(reasons)))
        room = LISTED_MAX - len(self.violations)
        self.violations += [
            SeedViolation(seed=result.seed, violation=violation)
            for violation in result.violations[:room]
        ]


def reasons_of(result: SeedResult) -> list[str]:
    """Why a seed counts as failing, in words; empty if it does not."""
    reasons = [
        f"broken at {violation.at_s:.3f} s: {violation.property}: {_last_line(violation.text)}"
        for violation in result.violations
    ]
    reasons += [_miss(injection) for injection in result.injections if injection.is_missed]
    if result.false_trips:
        times = "once" if result.false_trips == 1 else f"{result.false_trips} times"
        reasons.append(f"stopped {times} without a cause")
    return reasons


def _last_line(text: str) -> str:
    """All of most texts; of a traceback, what was raised."""
    return (text.strip().splitlines() or [""])[-1]


def _miss(injection: InjectionResult) -> str:
    of = f" of {injection.target}" if injection.target else ""
    what = f"missed: {injection.kind}{of} at {injection.at_s:.3f} s"
    after = "" if injection.latency_ms is None else f" after {injection.latency_ms:.1f} ms"
    if injection.demand is Demand.GO_ON:
        return f"{what}: the car must go on, and braked{after}"
    within = "" if injection.budget_ms is None else f" within {injection.budget_ms:g} ms"
    came = f"came{after}" if after else "never came"
    return f"{what}: {injection.demand} wanted{within}, {came}"


def summarise(results: Iterable[SeedResult]) -> CampaignTally:
    """Adds up a campaign.

    Args:
        results: In order of seed, each once.
    """
    tally = CampaignTally()
    for result in results:
        tally.add(result)
    return tally
