"""The past-time monitors: at their edges, and beside a published library's operators."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle.deadlines import Deadline, Held, Lately, Told

TRACE = st.lists(st.booleans(), min_size=1, max_size=60)
PAIRS = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60)
SPAN = st.integers(min_value=1, max_value=12)


def published(pattern: str, trace: Sequence[dict[str, bool]]) -> list[bool]:
    """The verdicts of reelay's monitor for past-time metric temporal logic, one a sample."""
    reelay: Any = pytest.importorskip("reelay", reason="not published for this platform")
    monitor = reelay.discrete_timed_monitor(pattern=pattern, condense=False)
    return [bool(monitor.update(values)["value"]) for values in trace]


@pytest.mark.slow
@given(TRACE, SPAN)
def test_held_is_historically(trace: list[bool], span: int) -> None:
    held = Held(span)
    ours = [held.update(now, holds) for now, holds in enumerate(trace)]
    theirs = published(f"historically[0:{span}]{{p}}", [{"p": holds} for holds in trace])
    assert ours[span:] == theirs[span:]  # what was before the first sample, nobody knows
    assert not any(ours[:span])


@pytest.mark.slow
@given(TRACE, SPAN)
def test_lately_is_once(trace: list[bool], span: int) -> None:
    lately = Lately(span)
    ours = []
    for now, holds in enumerate(trace):
        if holds:
            lately.note(now)
        ours.append(lately.was(now))
    assert ours == published(f"once[0:{span}]{{p}}", [{"p": holds} for holds in trace])


@pytest.mark.slow
@given(PAIRS, SPAN)
def test_deadline_is_a_bounded_response(trace: list[tuple[bool, bool]], span: int) -> None:
    deadline = Deadline(span)
    ours = []
    for now, (is_cause, is_answer) in enumerate(trace):
        if is_answer:
            deadline.answer()
        elif is_cause:
            deadline.start(now)
        ours.append(deadline.is_overdue(now))
    pattern = f"(not {{answer}}) since[{span + 1}:] ({{cause}} and not {{answer}})"
    samples = [{"cause": cause, "answer": answer} for cause, answer in trace]
    assert ours == published(pattern, samples)


@pytest.mark.slow
@given(PAIRS, SPAN)
def test_told_is_once_heard_and_held(trace: list[tuple[bool, bool]], span: int) -> None:
    told, heard, before = Told(), -(1 << 60), False
    ours = []
    for now, (is_heard, holds) in enumerate(trace):
        if is_heard and holds is not before:
            told.update(now, holds)
            before = holds
        if is_heard:
            heard = now
        ours.append(told.was(now, heard, span))
    samples = [{"heard": is_heard, "p": holds} for is_heard, holds in trace]
    theirs = published(f"once[0:{span}]({{heard}} and {{p}})", samples)
    # told by changes: what held until a change is taken to have held until then
    assert all(mine or not other for mine, other in zip(ours, theirs, strict=True))


def test_held_counts_from_the_first_instant_to_the_nanosecond() -> None:
    held = Held(50)
    assert [held.update(now, True) for now in (100, 149, 150)] == [False, False, True]
    assert not held.update(151, False)
    assert [held.update(now, True) for now in (152, 201, 202)] == [False, False, True]


def test_lately_ends_to_the_nanosecond() -> None:
    lately = Lately(50)
    assert not lately.was(0)
    lately.note(100)
    assert lately.was(150) and not lately.was(151)


def test_a_deadline_ends_to_the_nanosecond_and_counts_from_the_first_cause() -> None:
    deadline = Deadline(50)
    assert not deadline.is_overdue(10**9)
    deadline.start(100)
    deadline.start(120)
    assert not deadline.is_overdue(150) and deadline.is_overdue(151)
    deadline.answer()
    assert not deadline.is_overdue(10**9)


def test_told_is_true_while_what_holds_is_heard_and_for_its_span_after() -> None:
    told = Told()
    assert not told.was(0, 0, 50)
    told.update(100, True)
    assert told.was(180, 160, 50) and not told.was(180, 100, 50)
    told.update(200, False)  # until now it held
    assert told.was(250, 240, 50) and not told.was(251, 240, 50)
