"""A node's own watch over its cycle: lateness and overruns (ER2)."""

from __future__ import annotations

from enum import Enum
from typing import Final

from canbus.node import PERIOD_NS

LATE_NS_MAX: Final = 50_000_000
"""A node later than this is not to be trusted with an actuator (design, ER2)."""

OVERRUN_NS: Final = PERIOD_NS // 2
"""A cycle that begins later than this after its due time is an overrun."""

OVERRUNS_IN_A_ROW_MAX: Final = 3

assert OVERRUN_NS < PERIOD_NS < LATE_NS_MAX  # an overrun alone must not brake


class CycleFault(Enum):
    """What a step may learn about its own timing."""

    LATE = "late by more than 50 ms"
    OVERRUNS = "three overruns in a row"


class CycleWatch:
    """Judges the times at which a node is stepped."""

    __slots__ = ("_in_a_row", "_last_ns", "lateness_ns", "overruns")

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._in_a_row = 0
        self.lateness_ns = 0
        self.overruns = 0

    def check(self, now_ns: int) -> CycleFault | None:
        """To be called first in every step; the fault this step has revealed, if any."""
        last_ns, self._last_ns = self._last_ns, now_ns
        if last_ns is None:
            return None
        assert now_ns >= last_ns, "time went back"
        self.lateness_ns = now_ns - last_ns - PERIOD_NS
        if self.lateness_ns <= OVERRUN_NS:
            self._in_a_row = 0
            return None
        self.overruns += 1
        self._in_a_row += 1
        if self.lateness_ns > LATE_NS_MAX:
            return CycleFault.LATE
        return CycleFault.OVERRUNS if self._in_a_row >= OVERRUNS_IN_A_ROW_MAX else None
