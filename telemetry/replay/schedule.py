"""When each frame of a log is due, as the log is played once more. No clock in here."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from telemetry.logs.frames import LogFrame

NS_PER_S: Final = 1_000_000_000
LOOP_PAUSE_NS: Final = 10_000_000
"""Between the last frame of a loop and the first of the next: a node's cycle."""


@dataclass(slots=True, kw_only=True)
class Schedule:
    """Frames with the time at which each is due, in ns from the start of the replay.

    The log's own distances are kept, divided by the speed. Times that go back, as they do where a
    clock was set or several files were joined, are no distance: the frame is due at once.

    Attributes:
        speed: Times as fast as recorded; infinite: everything is due at once.
        loops: How often the log is played; None for ever.
        gap_ns_max: Longer silences are cut to this; None keeps them.
        backwards: Frames so far whose time lay before that of the frame in front of them.
    """

    speed: float = 1.0
    loops: int | None = 1
    gap_ns_max: int | None = None
    backwards: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        """Speeds above zero alone make a time."""
        assert self.speed > 0.0 and (self.loops is None or self.loops >= 1)

    def frames(
        self, read: Callable[[], Iterable[LogFrame]]
    ) -> Iterator[tuple[int, LogFrame]]:
        """`(due_ns, frame)`, from loop to loop.

        Args:
            read: Gives the frames, anew for every loop. A log without frames is played once.
        """
        log_ns = 0
        loop = 0
        while self.loops is None or loop < self.loops:
            last_ns: int | None = None
            for frame in read():
                if last_ns is None:
                    log_ns += LOOP_PAUSE_NS if loop else 0
                else:
                    log_ns += self._distance_ns(frame.time_ns - last_ns)
                last_ns = frame.time_ns
                yield self._due_ns(log_ns), frame
            if last_ns is None:
                return
            loop += 1

    def _distance_ns(self, distance_ns: int) -> int:
        if distance_ns < 0:
            self.backwards += 1
            return 0
        return distance_ns if self.gap_ns_max is None else min(distance_ns, self.gap_ns_max)

    def _due_ns(self, log_ns: int) -> int:
        return 0 if math.isinf(self.speed) else round(log_ns / self.speed)
