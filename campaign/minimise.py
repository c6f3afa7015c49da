"""Which of a failing seed's faults it takes: delta debugging.

A. Zeller, R. Hildebrandt: Simplifying and Isolating Failure-Inducing Input. IEEE Transactions on
Software Engineering 28 (2), 2002, figure 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Generic, TypeVar

from campaign.failure import FaultsOf, RunSeed, failures_of, faults_or_none, run_or_tell
from campaign.settings import CampaignSettings
from simulation.faults import Fault

ItemT = TypeVar("ItemT")

RUNS_MAX = 40
"""A few minutes for each failing seed."""

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
        chunks = [self._left[low:high] for low, high in pairwise(edges)]
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


def minimise(
    run_seed: RunSeed,
    faults_of: FaultsOf,
    settings: CampaignSettings,
    seed: int,
    runs_max: int = RUNS_MAX,
) -> tuple[int, Minimal[Fault]]:
    """The seed, and the fewest of its faults with which the same thing goes wrong.

    The first thing that went wrong counts. What began only after it was found goes first.
    """
    faults = faults_or_none(faults_of, settings, seed)
    result = run_or_tell(run_seed, settings, seed, faults=faults)
    wrong = failures_of(result)
    if not wrong:
        return seed, Minimal(items=faults, runs=1, is_minimal=False)

    def fails(some: Sequence[Fault]) -> bool:
        return wrong[0] in failures_of(run_or_tell(run_seed, settings, seed, faults=some))

    runs = 1
    found_s = [item.at_s for item in result.violations if item.property == wrong[0]]
    earlier = tuple(fault for fault in faults if found_s and fault.at_s <= found_s[0])
    if 0 < len(earlier) < len(faults):
        runs += 1
        faults = earlier if fails(earlier) else faults
    least = ddmin(faults, fails, runs_max - runs)
    return seed, Minimal(items=least.items, runs=runs + least.runs, is_minimal=least.is_minimal)
