"""Which way the drive turns: forwards or backwards, and a change at standstill alone."""

from __future__ import annotations

from typing import Final

STANDING_NS: Final = 400_000_000
"""Both axles stand and nothing is asked of the motor for so long: no torque is left in the drive
either, not even of a hill start's push (dead time and lag are a quarter of this)."""


class Direction:
    """The interlock; one object, changed by `update` and `release` alone.

    Attributes:
        sign: 1.0 forwards, -1.0 backwards.
    """

    __slots__ = ("_standing_since_ns", "sign")

    def __init__(self) -> None:
        self.sign = 1.0
        self._standing_since_ns: int | None = None

    def update(self, now_ns: int, target_mps: float, *, is_standing: bool) -> None:
        """Turns round for a target of the other sign, once the car has stood for long enough.

        Args:
            now_ns: Never goes back.
            target_mps: Signed; 0 leaves the direction.
            is_standing: Both axles for certain, and nothing is asked of the motor.
        """
        if not is_standing:
            self._standing_since_ns = None
        elif self._standing_since_ns is None:
            self._standing_since_ns = now_ns
        since_ns = self._standing_since_ns
        has_stood = since_ns is not None and now_ns - since_ns >= STANDING_NS
        if has_stood and target_mps * self.sign < 0.0:
            self.sign = -self.sign

    def release(self) -> None:
        """The relay is open: the driver has the car, and his own selector."""
        self.sign = 1.0
        self._standing_since_ns = None
