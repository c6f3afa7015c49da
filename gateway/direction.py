"""Turning round: the planner may ask for the other direction at any time, the car stops first."""

from __future__ import annotations

from typing import Final

STANDING_MPS_MAX: Final = 0.1
STANDING_NS: Final = 300_000_000
"""As the throttle ECU's interlock, which does not trust this one."""


class TurningRound:
    """The speed to command: 0, with the brake held, until the car may turn round."""

    def __init__(self) -> None:
        self._sign = 1.0
        self._standing_since_ns: int | None = None

    def commanded_mps(self, now_ns: int, wanted_mps: float, measured_mps: float) -> float:
        """What to command now.

        Args:
            now_ns: Never goes back.
            wanted_mps: The planner's, signed.
            measured_mps: Signed; NaN when not available, and then the car does not stand.
        """
        if not abs(measured_mps) < STANDING_MPS_MAX:
            self._standing_since_ns = None
        elif self._standing_since_ns is None:
            self._standing_since_ns = now_ns
        if wanted_mps * self._sign >= 0.0:
            return wanted_mps
        since_ns = self._standing_since_ns
        if since_ns is None or now_ns - since_ns < STANDING_NS:
            return 0.0
        self._sign = -self._sign
        return wanted_mps

    def forget(self) -> None:
        """A drive has ended; the next begins forwards."""
        self._sign = 1.0
        self._standing_since_ns = None
