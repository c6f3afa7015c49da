"""The fewest faults that still fail, found in a bounded number of runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from campaign.failure import Tally, failures_of, first_failure
from campaign.minimise import RUNS_MAX, ddmin, minimise
from campaign.result import SeedResult, ViolationResult
from campaign.run import run_seed
from campaign.settings import CampaignSettings
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from tests.campaign import fakes

pytestmark = pytest.mark.whole_car


@given(size=st.integers(0, 40), data=st.data())
def test_what_is_left_is_what_it_takes(size: int, data: st.DataObject) -> None:
    needed = data.draw(st.sets(st.integers(0, max(0, size - 1)), max_size=min(size, 4)))
    calls: list[tuple[int, ...]] = []

    def fails(some: Sequence[int]) -> bool:
        calls.append(tuple(some))
        return needed <= set(some)

    least = ddmin(range(size), fails, 10_000)
    assert least.items == tuple(sorted(needed)) and least.is_minimal
    assert len(calls) == len(set(calls)) == least.runs


@given(st.sets(st.frozensets(st.integers(0, 11), min_size=1, max_size=5), min_size=1, max_size=4))
def test_nothing_that_is_left_can_be_left_out(causes: set[frozenset[int]]) -> None:
    def fails(some: Sequence[int]) -> bool:
        return any(cause <= set(some) for cause in causes)

    least = ddmin(range(12), fails, 10_000)
    assert fails(least.items)
    for fewer in combinations(least.items, len(least.items) - 1):
        assert not fails(fewer)


def test_a_fault_that_cancels_another_does_not_confuse_it() -> None:
    def fails(some: Sequence[int]) -> bool:
        return 3 in some and (5 not in some or 9 in some)

    assert ddmin(range(16), fails, 1000).items == (3,)


def test_runs_are_bounded_and_what_is_left_still_fails() -> None:
    def fails(some: Sequence[int]) -> bool:
        return {0, 21, 42, 63} <= set(some)

    least = ddmin(range(64), fails, 12)
    assert least.runs == 12 and not least.is_minimal
    assert fails(least.items) and len(least.items) <= 64


@pytest.mark.parametrize("seed", fakes.FAILING)
def test_the_two_faults_it_takes_are_found_among_a_dozen(seed: int) -> None:
    runs = 0

    def counted(
        settings: CampaignSettings, seed: int, *, faults: Sequence[Fault] | None = None
    ) -> SeedResult:
        nonlocal runs
        runs += 1
        return fakes.run_failing(settings, seed, faults=faults)

    found_seed, least = minimise(counted, fakes.faults_of, fakes.SETTINGS, seed)
    assert found_seed == seed and least.is_minimal
    assert [fault.kind for fault in least.items] == [FaultKind.CRASH, FaultKind.FREEZE]
    assert least.runs == runs <= RUNS_MAX


def test_an_exception_is_minimised_like_any_other_failure() -> None:
    def raising(
        settings: CampaignSettings, seed: int, *, faults: Sequence[Fault] | None = None
    ) -> SeedResult:
        if any(fault.kind is FaultKind.MUTE for fault in faults or ()):
            raise ZeroDivisionError
        return fakes.result_of(seed)

    _, least = minimise(raising, fakes.faults_of, fakes.SETTINGS, 0)
    assert [fault.kind for fault in least.items] == [FaultKind.MUTE]


def test_another_failure_is_not_taken_for_the_same() -> None:
    """Without its CRASH the seed fails otherwise, which does not count."""

    def two_ways(
        settings: CampaignSettings, seed: int, *, faults: Sequence[Fault] | None = None
    ) -> SeedResult:
        if any(fault.kind is FaultKind.CRASH for fault in faults or ()):
            return fakes.run_failing(settings, seed, faults=faults)
        raise ZeroDivisionError

    _, least = minimise(two_ways, fakes.faults_of, fakes.SETTINGS, 3)
    assert [fault.kind for fault in least.items] == [FaultKind.CRASH, FaultKind.FREEZE]


def test_a_seed_that_does_not_fail_any_more_keeps_its_faults() -> None:
    _, least = minimise(fakes.run_seed, fakes.faults_of, fakes.SETTINGS, 3)
    assert list(least.items) == fakes.faults_of(fakes.SETTINGS, 3)
    assert least.runs == 1 and not least.is_minimal


def test_a_seed_whose_faults_cannot_be_drawn_has_none(tmp_path: Path) -> None:
    def no_faults(settings: CampaignSettings, seed: int) -> list[Fault]:
        raise ZeroDivisionError

    run = partial(fakes.run_killing, tmp_path, 0)
    assert minimise(run, no_faults, fakes.SETTINGS, 3)[1].items == ()


def test_missed_faults_are_failures_and_are_told_with_numbers() -> None:
    result = fakes.result_of(11)
    late, other = result.injections
    missed = replace(result, injections=(replace(late, is_missed=True), other))
    assert failures_of(result) == () and first_failure(result) == ""
    assert failures_of(missed) == ("crash of Steering missed",)
    assert first_failure(missed) == "at 0.000 s: crash of Steering: go on: nothing, MISSED"
    tripped = replace(result, seed=12, false_trips=1)
    assert failures_of(tripped) == ("false trip",) and first_failure(tripped) == "1 false trips"
    tally = Tally.of([result, missed, tripped])
    assert (tally.seeds, tally.missed, tally.failing_seeds) == (3, 1, 2)
    assert list(tally.failing) == [11, 12]


def test_the_fault_that_stops_a_real_car_is_found() -> None:
    settings = CampaignSettings(seed_s=4.0)
    crash = Fault(kind=FaultKind.CRASH, target="Steering", at_s=2.5)
    harmless = [
        Fault(kind=FaultKind.SLOPE, at_s=at_s, for_s=0.5, value=0.02) for at_s in (1.0, 2.0, 2.5)
    ]

    def stops(
        settings: CampaignSettings, seed: int, *, faults: Sequence[Fault] | None = None
    ) -> SeedResult:
        result = run_seed(settings, seed, faults=faults)
        broken = ViolationResult(property="goes on", at_s=2.6, text=f"{result.stops} stops")
        return replace(result, violations=(broken,) if result.stops else ())

    _, least = minimise(stops, lambda *_: [*harmless, crash], settings, 17)
    assert least.items == (crash,) and least.is_minimal
