"""The pacer: a grid of absolute deadlines, lag counted, nothing caught up."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.pacing import GAP_NS_MIN, Pacer

MS = 1_000_000


def test_first_deadline_is_the_next_point_of_the_grid() -> None:
    assert Pacer(start_ns=123 * MS, phase_ns=2 * MS).next_deadline_ns == 132 * MS
    assert Pacer(start_ns=121 * MS, phase_ns=2 * MS).next_deadline_ns == 122 * MS


def test_a_deadline_at_the_start_itself_is_left_to_the_next_period() -> None:
    assert Pacer(start_ns=122 * MS, phase_ns=2 * MS).next_deadline_ns == 132 * MS


def test_a_late_cycle_does_not_shift_the_grid() -> None:
    pacer = Pacer(start_ns=0)
    pacer.begin(12 * MS)
    assert not pacer.end(13 * MS)
    assert pacer.next_deadline_ns == 20 * MS
    assert (pacer.lag_ns, pacer.overruns, pacer.skipped) == (2 * MS, 0, 0)


def test_worst_lag_is_kept() -> None:
    pacer = Pacer(start_ns=0)
    for begin_ns in (13 * MS, 21 * MS):
        pacer.begin(begin_ns)
        pacer.end(begin_ns)
    assert (pacer.lag_ns, pacer.lag_ns_max) == (1 * MS, 3 * MS)


def test_missed_deadlines_are_skipped_and_counted_not_caught_up() -> None:
    pacer = Pacer(start_ns=0)
    pacer.begin(10 * MS)
    assert pacer.end(43 * MS)
    assert pacer.next_deadline_ns == 50 * MS
    assert (pacer.overruns, pacer.skipped) == (1, 3)


def test_a_deadline_too_close_after_a_late_cycle_is_skipped() -> None:
    pacer = Pacer(start_ns=0)
    pacer.begin(10 * MS)
    assert not pacer.end(20 * MS - GAP_NS_MIN + 1)
    assert pacer.next_deadline_ns == 30 * MS
    assert (pacer.overruns, pacer.skipped) == (0, 1)


def test_a_deadline_just_far_enough_away_is_kept() -> None:
    pacer = Pacer(start_ns=0)
    pacer.begin(10 * MS)
    pacer.end(20 * MS - GAP_NS_MIN)
    assert (pacer.next_deadline_ns, pacer.skipped) == (20 * MS, 0)


def test_a_cycle_that_is_not_due_is_a_mistake() -> None:
    with pytest.raises(AssertionError, match="not due"):
        Pacer(start_ns=0).begin(9 * MS)


def test_wait_is_never_negative() -> None:
    pacer = Pacer(start_ns=0)
    assert pacer.wait_ns(4 * MS) == 6 * MS
    assert pacer.wait_ns(14 * MS) == 0


@given(
    start_ns=st.integers(0, 10**12),
    phase_ns=st.integers(0, 10 * MS - 1),
    cycles=st.lists(st.tuples(st.integers(0, 60 * MS), st.integers(0, 60 * MS)), max_size=20),
)
def test_cycles_keep_their_distance_and_every_deadline_is_accounted_for(
    start_ns: int, phase_ns: int, cycles: list[tuple[int, int]]
) -> None:
    pacer = Pacer(start_ns=start_ns, phase_ns=phase_ns)
    first_ns = pacer.next_deadline_ns
    assert start_ns < first_ns <= start_ns + 10 * MS
    for lag_ns, work_ns in cycles:
        begin_ns = pacer.next_deadline_ns + lag_ns
        pacer.begin(begin_ns)
        pacer.end(begin_ns + work_ns)
        assert pacer.next_deadline_ns % (10 * MS) == phase_ns
        assert pacer.next_deadline_ns - (begin_ns + work_ns) >= GAP_NS_MIN
    assert (pacer.next_deadline_ns - first_ns) // (10 * MS) == pacer.cycles + pacer.skipped
