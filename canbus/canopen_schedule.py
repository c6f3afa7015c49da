"""When a node's own CANopen frames leave: periodic ones, and emergencies (inhibit time)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

from canbus.frame import Frame

AT_ONCE_NS: Final = -(1 << 63)
NEVER_NS: Final = 1 << 63

EMCY_QUEUE_MAX: Final = 8
"""Emergencies that wait; of more, the oldest is dropped: what holds now is what matters."""


@dataclass(slots=True)
class CyclicFrame:
    """A periodic frame as data; `next_ns` is its next deadline, `NEVER_NS` once stopped."""

    can_id: int
    data: bytes
    period_ns: int
    next_ns: int = NEVER_NS


class CyclicSchedule:
    """Periodic frames on absolute deadlines.

    A late step shifts no later deadline, and whole periods missed are left out, not made up for.
    """

    def __init__(self) -> None:
        self._frames: list[CyclicFrame] = []

    def add(self, frame: CyclicFrame, now_ns: int) -> None:
        """Send `frame` every `period_ns` from one period after `now_ns` on."""
        assert frame.period_ns > 0, "a periodic frame needs a period"
        frame.next_ns = now_ns + frame.period_ns
        self._frames = [other for other in self._frames if other.next_ns != NEVER_NS]
        self._frames.append(frame)

    def take_due(self, now_ns: int) -> tuple[list[Frame], int]:
        """The frames to send by now, and the time of the next one."""
        due: list[Frame] = []
        next_ns = NEVER_NS
        for frame in self._frames:
            if frame.next_ns <= now_ns:
                due.append(Frame(frame.can_id, frame.data))
                periods = (now_ns - frame.next_ns) // frame.period_ns + 1
                frame.next_ns += periods * frame.period_ns
            next_ns = min(next_ns, frame.next_ns)
        return due, next_ns


@dataclass(frozen=True, slots=True)
class Emergency:
    """One EMCY: error code (CiA 301, table 26), error register, manufacturer's bytes."""

    error_code: int
    error_register: int
    manufacturer: bytes = b""

    def __post_init__(self) -> None:
        """Check what must fit into the frame."""
        assert 0 <= self.error_code <= 0xFFFF, f"error code {self.error_code:#x}"
        assert 0 <= self.error_register <= 0xFF, f"error register {self.error_register:#x}"
        assert len(self.manufacturer) <= 5, "an EMCY has five manufacturer bytes"


class EmergencyQueue:
    """Emergencies that wait (CiA 301, 7.2.7 and object 0x1015): a bounded
    queue with a least time between two departures.

    Attributes:
        dropped: emergencies lost because too many waited.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting: deque[Emergency] = deque()
        self._allowed_ns = AT_ONCE_NS

    @property
    def due_ns(self) -> int:
        """When the next emergency may leave; `NEVER_NS` when none waits."""
        return self._allowed_ns if self._waiting else NEVER_NS

    def put(self, emergency: Emergency) -> None:
        """Add one at the end."""
        if len(self._waiting) == EMCY_QUEUE_MAX:
            self._waiting.popleft()
            self.dropped += 1
        self._waiting.append(emergency)

    def take(self, now_ns: int, inhibit_ns: int) -> Emergency:
        """The oldest one, which is due now; the next one then waits for `inhibit_ns`."""
        assert now_ns >= self.due_ns, "not due yet"
        self._allowed_ns = now_ns + inhibit_ns
        return self._waiting.popleft()

    def clear(self) -> None:
        """Forget what waits."""
        self._waiting.clear()
