"""Past-time monitors in integer nanoseconds: what held, what was lately, what is overdue.

Each is told what is the case at instants that never go back; between them it stays the case. The
tests compare them with the past-time temporal operators of a published library.
"""

from __future__ import annotations

from oracle.words import NEVER_NS


class Held:
    """`historically[0,T] p`: the condition has held for `hold_ns` without a gap."""

    __slots__ = ("hold_ns", "since_ns")

    def __init__(self, hold_ns: int) -> None:
        self.hold_ns = hold_ns
        self.since_ns: int | None = None

    def update(self, now_ns: int, holds: bool) -> bool:
        """Whether it has, counting this instant."""
        if not holds:
            self.since_ns = None
            return False
        if self.since_ns is None:
            self.since_ns = now_ns
        return now_ns - self.since_ns >= self.hold_ns


class Lately:
    """`once[0,T] p`: it was the case at some instant of the last `span_ns`."""

    __slots__ = ("last_ns", "span_ns")

    def __init__(self, span_ns: int) -> None:
        self.span_ns = span_ns
        self.last_ns = NEVER_NS

    def note(self, now_ns: int) -> None:
        """It is the case now."""
        self.last_ns = now_ns

    def was(self, now_ns: int) -> bool:
        """Whether it was."""
        return now_ns - self.last_ns <= self.span_ns


class Told:
    """`once[0,T] (heard and p)`, of a condition that is told by changes and heard in between."""

    __slots__ = ("_holds", "_last_ns")

    def __init__(self) -> None:
        self._holds = False
        self._last_ns = NEVER_NS

    def update(self, now_ns: int, holds: bool) -> None:
        """What is told from now on; until now it was what was told before."""
        if self._holds or holds:
            self._last_ns = now_ns
        self._holds = holds

    def was(self, now_ns: int, heard_ns: int, span_ns: int) -> bool:
        """Whether it was told within the span; `heard_ns` is when anything was heard last."""
        last_ns = heard_ns if self._holds else self._last_ns
        return now_ns - last_ns <= span_ns


class Deadline:
    """`(not answer) since[>T] (cause and not answer)`: an answer is overdue.

    A cause while one is waiting for its answer already changes nothing: the first one counts.
    """

    __slots__ = ("since_ns", "span_ns")

    def __init__(self, span_ns: int) -> None:
        self.span_ns = span_ns
        self.since_ns: int | None = None

    def start(self, now_ns: int) -> None:
        """A cause: the answer is due within `span_ns` from now."""
        if self.since_ns is None:
            self.since_ns = now_ns

    def answer(self) -> None:
        """The answer; or the cause needs none any more."""
        self.since_ns = None

    def is_overdue(self, now_ns: int) -> bool:
        """Whether the answer should have come."""
        return self.since_ns is not None and now_ns - self.since_ns > self.span_ns
