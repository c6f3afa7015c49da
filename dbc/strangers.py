"""What a node tells of frames that are none of ours, or not from whom they seem to be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from canbus.frame import ReceivedFrame

INTERVAL_NS: Final = 1_000_000_000

_KIND_SHIFT: Final = 29


class StrangerLog:
    """Each identifier is told of at most once a second, with the number of frames left out.

    Strangers may fill the bus with frames that are tolerated: a line for each of them would cost a
    node more than everything else it does.
    """

    def __init__(self) -> None:
        self._until_ns = 0
        self._counts: dict[int, int] = {}
        self._before: dict[int, int] = {}

    def lines(self, now_ns: int, foreign: Sequence[ReceivedFrame]) -> list[str]:
        """What is worth a line in the log."""
        if not foreign:
            return []
        if now_ns >= self._until_ns:
            self._until_ns = now_ns + INTERVAL_NS
            self._before, self._counts = self._counts, {}
        lines = []
        for item in foreign:
            frame = item.frame
            key = frame.kind << _KIND_SHIFT | frame.can_id
            count = self._counts.get(key, 0)
            self._counts[key] = count + 1
            if count == 0:
                untold = self._before.get(key, 1) - 1
                more = f", after {untold} more" if untold else ""
                lines.append(f"{frame} ({frame.kind.name.lower()}){more}")
        return lines
