"""Which of a failing seed's faults it takes: delta debugging.

A. Zeller, R. Hildebrandt: Simplifying and Isolating Failure-Inducing Input. IEEE Transactions on
Software Engineering 28 (2), 2002, figure 5.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from campaign.result import SeedResult, ViolationResult
from campaign.settings import CampaignSettings
from simulation.faults import Fault

ItemT = TypeVar("ItemT")

RUNS_MAX = 40
"""A few minutes for each failing seed."""
EXCEPTION = "no exception"
WORKER_LIVES = "no dead worker"
TEXT_MAX = 8000
"""Characters of a traceback's end."""


class RunSeed(Protocol):
    """`campaign.run.run_seed`, or a stand-in."""

    def __call__(
        self, settings: CampaignSettings, seed: int, *, faults: Sequence[Fault] | None = None
    ) -> SeedResult:
        """Runs one seed."""


FaultsOf = Callable[[CampaignSettings, int], list[Fault]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Minimal(Generic[ItemT]):
    """What is left of a list.

    Attributes:
        items: They fail, and none of them can be left out, if `is_minimal`.
        runs: How often it was tried.
        is_minimal: False if the runs were used up before.
    """

    items: tuple[ItemT, ...]
    runs: int
    is_minimal: bool


class _OutOfRuns(Exception):
    pass


def ddmin(
    items: Sequence[ItemT], fails: Callable[[Sequence[ItemT]], bool], runs_max: int
) -> Minimal[ItemT]:
    """The fewest items that still fail: leaving out any one of them would not.

    Args:
        items: They fail all together.
        fails: Whether some of them, in their order, do.
        runs_max: How often `fails` may be asked.
    """
    return _Search(items, fails, runs_max).search()


class _Search(Generic[ItemT]):
    def __init__(
        self, items: Sequence[ItemT], fails: Callable[[Sequence[ItemT]], bool], runs_max: int
    ) -> None:
        self._items = items
        self._fails = fails
        self._runs_max = runs_max
        self._known: dict[tuple[int, ...], bool] = {}
        self._left = tuple(range(len(items)))

    def search(self) -> Minimal[ItemT]:
        """Halves first, then finer parts, alone or left out."""
        try:
            if self._try(()):
                self._left = ()
            parts = 2
            while len(self._left) >= 2:
                parts = self._shorten(parts)
                if parts == 0:
                    break
            is_minimal = True
        except _OutOfRuns:
            is_minimal = False
        items = tuple(self._items[number] for number in self._left)
        return Minimal(items=items, runs=len(self._known), is_minimal=is_minimal)

    def _shorten(self, parts: int) -> int:
        """One round; answers into how many parts to divide next, 0 when no more can be done."""
        count = len(self._left)
        edges = [count * number // parts for number in range(parts + 1)]
        chunks = [self._left[low:high] for low, high in zip(edges, edges[1:], strict=False)]
        for chunk in chunks:
            if self._try(chunk):
                self._left = chunk
                return 2
        for chunk in chunks if parts > 2 else ():  # of two, each is the other's complement
            rest = tuple(number for number in self._left if number not in chunk)
            if self._try(rest):
                self._left = rest
                return max(parts - 1, 2)
        return min(2 * parts, count) if parts < count else 0

    def _try(self, numbers: tuple[int, ...]) -> bool:
        if numbers not in self._known:
            if len(self._known) >= self._runs_max:
                raise _OutOfRuns
            self._known[numbers] = self._fails([self._items[number] for number in numbers])
        return self._known[numbers]


def failures_of(result: SeedResult) -> tuple[str, ...]:
    """What went wrong in a seed, each thing once: properties that broke, faults that were missed."""
    broken = [violation.property for violation in result.violations]
    missed = [
        f"{item.kind} of {item.target} missed" if item.target else f"{item.kind} missed"
        for item in result.injections
        if item.is_missed
    ]
    return tuple(dict.fromkeys(broken + missed))


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


def minimise(
    run_seed: RunSeed,
    faults_of: FaultsOf,
    settings: CampaignSettings,
    seed: int,
    runs_max: int = RUNS_MAX,
) -> Minimal[Fault]:
    """The fewest of a failing seed's faults with which the same thing goes wrong.

    The first thing that went wrong counts. What began only after it was found goes first.
    """
    faults = faults_of(settings, seed)
    result = run_or_tell(run_seed, settings, seed, faults=faults)
    wrong = failures_of(result)
    if not wrong:
        return Minimal(items=tuple(faults), runs=1, is_minimal=False)

    def fails(some: Sequence[Fault]) -> bool:
        return wrong[0] in failures_of(run_or_tell(run_seed, settings, seed, faults=some))

    runs = 1
    found_s = [item.at_s for item in result.violations if item.property == wrong[0]]
    earlier = [fault for fault in faults if found_s and fault.at_s <= found_s[0]]
    if 0 < len(earlier) < len(faults):
        runs += 1
        faults = earlier if fails(earlier) else faults
    least = ddmin(faults, fails, runs_max - runs)
    return Minimal(items=least.items, runs=runs + least.runs, is_minimal=least.is_minimal)
