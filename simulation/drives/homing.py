"""Homing (CiA 402-2, clause on hm): where the encoder's zero lies.

Methods 33 and 34 (the index next to here), 35 (here), and the EPOS2's -3 and -4 (the end stop, felt
by the current). The position at the place found becomes the home offset (607C). An EPOS2 drives
away from a stop afterwards; this one holds there.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final

from canbus import cia402
from canbus.cia402 import HomingMethod
from simulation.drives.axis import TICK_S, Axis, Dwell
from simulation.drives.motor import COUNTS_PER_REV

BLOCKED_MS: Final = 50
"""How long the motor must stand although the homing current flows (assumption)."""
_BLOCKED_SHARE: Final = 0.95

_DIRECTION: Final = {
    HomingMethod.STOP_NEGATIVE: -1,
    HomingMethod.STOP_POSITIVE: 1,
    HomingMethod.INDEX_NEGATIVE: -1,
    HomingMethod.INDEX_POSITIVE: 1,
    HomingMethod.HERE: 0,
}
_INDEX: Final = (HomingMethod.INDEX_NEGATIVE, HomingMethod.INDEX_POSITIVE)


class _Phase(Enum):
    WAITING = auto()
    SEARCHING = auto()
    ATTAINED = auto()
    INTERRUPTED = auto()
    FAILED = auto()


class Homing:
    """Searches while bit 4 stands; taking it away interrupts."""

    holds_position = False

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self._blocked = Dwell()
        self._phase = _Phase.WAITING
        self._turn = 0

    @property
    def limit_a(self) -> float:
        """The homing current, so that an end stop is touched softly."""
        return self._axis.values[cia402.HOMING_CURRENT] * 0.001

    def start(self) -> None:
        """Nothing is searched for before bit 4 rises; a zero that was found stays."""
        self._phase = _Phase.WAITING

    def command(self, controlword: int, before: int) -> None:
        """Bit 4 rising starts, falling interrupts."""
        asked = bool(controlword & cia402.HOMING_START)
        if asked and not before & cia402.HOMING_START:
            self._phase = _Phase.SEARCHING
            self._turn = self._turn_now
            self._blocked = Dwell()
        elif not asked and self._phase is _Phase.SEARCHING:
            self._phase = _Phase.INTERRUPTED

    def tick(self, controlword: int) -> None:
        """One tick of the search; standing when there is none."""
        axis = self._axis
        is_halted = bool(controlword & cia402.HALT)
        method = HomingMethod(axis.values[cia402.HOMING_METHOD])
        speed = cia402.HOMING_SPEED_INDEX if method in _INDEX else cia402.HOMING_SPEED_STOP
        is_moving = self._phase is _Phase.SEARCHING and not is_halted
        target = _DIRECTION[method] * axis.rate(speed) if is_moving else 0.0
        acceleration = axis.rate(cia402.HOMING_ACCELERATION)
        axis.reference.ramp(target, acceleration, acceleration, TICK_S)
        if is_moving:
            self._search(method)

    def status(self) -> int:
        """Bits 13, 12 and 10 as in the table of CiA 402-2."""
        bits = {_Phase.ATTAINED: cia402.HOMING_ATTAINED, _Phase.FAILED: cia402.HOMING_ERROR}
        is_done = self._phase is not _Phase.SEARCHING and self._axis.is_standing
        return bits.get(self._phase, 0) | (cia402.TARGET_REACHED if is_done else 0)

    @property
    def _turn_now(self) -> int:
        return self._axis.motor.counts // COUNTS_PER_REV

    def _search(self, method: HomingMethod) -> None:
        axis = self._axis
        is_full = abs(axis.motor.current_a) >= _BLOCKED_SHARE * self.limit_a
        is_blocked = self._blocked.lasts(is_full and axis.is_standing, BLOCKED_MS)
        if method is HomingMethod.HERE:
            self._found(axis.motor.counts)
        elif method in _INDEX:
            turn = self._turn_now
            if turn != self._turn:  # the index lies between the two turns
                self._found(max(turn, self._turn) * COUNTS_PER_REV)
            elif is_blocked:
                self._phase = _Phase.FAILED
                axis.start()
        elif is_blocked:
            self._found(axis.motor.counts)
            axis.start()

    def _found(self, counts: int) -> None:
        """The encoder's reading at the place that was searched for."""
        axis = self._axis
        before = axis.zero_counts
        axis.zero_counts = counts - axis.values[cia402.HOME_OFFSET]
        axis.reference.position += before - axis.zero_counts
        self._phase = _Phase.ATTAINED
