"""A stretch of the bus, decoded: what was said, what nobody may believe, and what is missing."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from canbus.frame import Frame, FrameKind
from dbc.codec import Decoded, FrameFault, decode
from dbc.endpoint import SPEC_OF_NAME, STOPPING_IDS
from dbc.messages import SPECS
from dbc.protection import UNKNOWN, USABLE, AliveCheck, AliveState
from dbc.spec import MessageSpec

QUIET_NS: Final = 50_000_000
"""A bus of ours on which nothing at all is heard for so long is not well: five 10 ms cycles."""


@dataclass(frozen=True, slots=True)
class Heard:
    """One frame, decoded.

    Attributes:
        time_ns: When it was on the wire.
        frame: As it was.
        spec: Of its message; None for an identifier that is nobody's.
        content: What it says; None where it is malformed.
        fault: Why its receivers ignore it; None: they believe it.
    """

    time_ns: int
    frame: Frame
    spec: MessageSpec | None
    content: Any = None
    fault: FrameFault | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Silence:
    """A message that should have come and did not, or not in a form that can be used.

    Attributes:
        spec: Of the message.
        last: The last usable frame before.
        timeout_ns: After it: so long it may stay away.
        back_ns: When a usable one came again; None: not within the window.
        ignored: Frames with its identifier that came until it was looked for, each with what is
            wrong.
    """

    spec: MessageSpec
    last: Heard
    timeout_ns: int
    back_ns: int | None
    ignored: tuple[Heard, ...]

    @property
    def overdue_ns(self) -> int:
        """When its receivers had to notice."""
        return self.last.time_ns + self.timeout_ns


class Judge:
    """Tells of each frame, in order, whether the nodes believe it; remembers the counters."""

    def __init__(self) -> None:
        self._checks: dict[int, AliveCheck] = {}

    def judge(self, time_ns: int, frame: Frame) -> Heard:
        """One frame; the first of an identifier is believed, for nothing speaks against it."""
        spec = SPECS.get(frame.can_id) if frame.kind is not FrameKind.EXTENDED else None
        if spec is None:
            return Heard(time_ns, frame, None)
        decoded = decode(frame)
        check = self._checks.setdefault(frame.can_id, AliveCheck())
        if not isinstance(decoded, Decoded):
            check.judge(None)
            return Heard(time_ns, frame, spec, fault=decoded)
        if decoded.counter is None:
            return Heard(time_ns, frame, spec, decoded.message)
        is_first = check.expected == UNKNOWN
        state = check.judge(decoded.counter)
        check.is_in_sequence |= is_first
        if state is AliveState.REPEATED:
            return Heard(time_ns, frame, spec, decoded.message, FrameFault.REPEATED)
        if is_first or state in USABLE or frame.can_id in STOPPING_IDS:
            return Heard(time_ns, frame, spec, decoded.message)
        return Heard(time_ns, frame, spec, decoded.message, FrameFault.SEQUENCE)


class Window:
    """The frames of a stretch of time, in order; times in ns on one clock.

    Attributes:
        rows: Every frame.
    """

    def __init__(self, frames: Iterable[tuple[int, Frame]]) -> None:
        judge = Judge()
        self.rows = [judge.judge(time_ns, frame) for time_ns, frame in frames]
        self._times_ns = [row.time_ns for row in self.rows]
        self._usable: dict[str, list[Heard]] = {}
        self._ignored: dict[str, list[Heard]] = {}
        for row in self.rows:
            if row.spec is not None:
                kept = self._usable if row.fault is None else self._ignored
                kept.setdefault(row.spec.name, []).append(row)

    @property
    def begin_ns(self) -> int:
        """Time of the first frame; 0 without any."""
        return self._times_ns[0] if self.rows else 0

    @property
    def end_ns(self) -> int:
        """Time of the last frame; 0 without any."""
        return self._times_ns[-1] if self.rows else 0

    def between(self, begin_ns: int, end_ns: int) -> list[Heard]:
        """Every frame of a span, both ends included."""
        first, end = bisect_left(self._times_ns, begin_ns), bisect_right(self._times_ns, end_ns)
        return self.rows[first:end]

    def usable(self, name: str) -> list[Heard]:
        """Frames of a message that its receivers believe."""
        return self._usable.get(name, [])

    def ignored(self, name: str) -> list[Heard]:
        """Frames of a message that they do not."""
        return self._ignored.get(name, [])

    def newest(self, name: str, time_ns: int) -> Heard | None:
        """The newest usable frame of a message at a time; None before the first."""
        rows = self.usable(name)
        place = bisect_right(rows, time_ns, key=lambda row: row.time_ns)
        return rows[place - 1] if place else None

    def after(self, name: str, time_ns: int) -> Iterator[Heard]:
        """Usable frames of a message from a time on."""
        rows = self.usable(name)
        yield from rows[bisect_left(rows, time_ns, key=lambda row: row.time_ns) :]

    def sent_by(self, node: str, begin_ns: int, end_ns: int) -> Iterator[Heard]:
        """Frames with a node's identifiers, believed or not."""
        for row in self.between(begin_ns, end_ns):
            if row.spec is not None and row.spec.sender == node:
                yield row

    def silence(self, name: str, at_ns: int, timeout_ns: int = 0) -> Silence | None:
        """The silence of a message that is under way at a time, or has just ended then.

        Args:
            name: Of the message.
            at_ns: When.
            timeout_ns: After the last frame; 0: the DBC's.

        Returns:
            None where the message came in time, or never came before.
        """
        spec = SPEC_OF_NAME[name]
        timeout_ns = timeout_ns or spec.timeout_ns
        last = self.newest(name, at_ns)
        if last is None or not timeout_ns:
            return None
        rows = self.usable(name)
        place = bisect_right(rows, last.time_ns, key=lambda row: row.time_ns)
        back_ns = rows[place].time_ns if place < len(rows) else None
        end_ns = self.end_ns if back_ns is None else back_ns
        if end_ns - last.time_ns <= timeout_ns:
            return None
        ignored = [row for row in self.ignored(name) if last.time_ns < row.time_ns <= at_ns]
        return Silence(
            spec=spec, last=last, timeout_ns=timeout_ns, back_ns=back_ns, ignored=tuple(ignored)
        )

    def quiet(self, end_ns: int) -> tuple[int, int] | None:
        """The last span before a time in which no frame at all was heard; None without one."""
        place = bisect_right(self._times_ns, end_ns)
        for index in range(min(place, len(self._times_ns) - 1), 0, -1):
            if self._times_ns[index] - self._times_ns[index - 1] >= QUIET_NS:
                return self._times_ns[index - 1], self._times_ns[index]
        return None

