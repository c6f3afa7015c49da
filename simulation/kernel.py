"""The event kernel: virtual time in integer nanoseconds, in a total order."""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush

Action = Callable[[int], None]


class Kernel:
    """Runs actions in the order of `(time_ns, priority, sequence)`; a lower number goes first."""

    __slots__ = ("_heap", "_sequence", "now_ns")

    def __init__(self) -> None:
        self.now_ns = 0
        self._heap: list[tuple[int, int, int, Action]] = []
        self._sequence = 0

    def at(self, time_ns: int, priority: int, action: Action) -> None:
        """Plans `action(time_ns)`; a time that has passed is a programmer's error."""
        assert time_ns >= self.now_ns
        self._sequence += 1
        heappush(self._heap, (time_ns, priority, self._sequence, action))

    def run_until(self, time_ns: int) -> None:
        """Runs everything that is due up to and including `time_ns`, and leaves time there."""
        heap = self._heap
        while heap and heap[0][0] <= time_ns:
            due_ns, _, _, action = heappop(heap)
            self.now_ns = due_ns
            action(due_ns)
        self.now_ns = max(self.now_ns, time_ns)
