"""Turning round: the planner may ask for the other direction at any time, the car stops first."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

STANDING_MPS_MAX: Final = 0.1
STANDING_NS: Final = 600_000_000
"""Longer by 0.2 s than the throttle ECU's interlock, which does not trust this one, and the brake
ECU's judgement of a hill: both have seen the car stand when it is told to turn round."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rolling:
    """How the car rolls, m/s, signed; NaN when not available."""

    front_mps: float
    rear_mps: float
    applied_mps: float
    """The throttle ECU's setpoint in force; NaN as well when it follows none."""

    @property
    def is_standing(self) -> bool:
        """Both axles for certain: one may be locked."""
        return abs(self.front_mps) < STANDING_MPS_MAX and abs(self.rear_mps) < STANDING_MPS_MAX

    def is_against(self, sign: float) -> bool:
        """Whether an axle rolls against this direction, and not because the drive is told to."""
        is_idle = not abs(self.applied_mps) > 0.0
        rolls = (-sign * mps >= STANDING_MPS_MAX for mps in (self.front_mps, self.rear_mps))
        return is_idle and any(rolls)


class TurningRound:
    """The speed to command: 0, with the brake held, until the car may turn round."""

    def __init__(self) -> None:
        self._sign = 1.0
        self._standing_since_ns: int | None = None

    def commanded_mps(self, now_ns: int, wanted_mps: float, rolling: Rolling) -> float:
        """What to command now, in a car that drives itself.

        Args:
            now_ns: Never goes back.
            wanted_mps: The planner's, signed.
            rolling: A car that rolls the other way, on a hill for instance, has to turn round too.
        """
        wanted_sign = math.copysign(1.0, wanted_mps)
        if wanted_mps != 0.0 and rolling.is_against(wanted_sign):
            self._sign = -wanted_sign
        if wanted_mps * self._sign > 0.0:
            self._standing_since_ns = None  # the brake is let go: it does not stand for certain
            return wanted_mps
        if not rolling.is_standing:
            self._standing_since_ns = None
        elif self._standing_since_ns is None:
            self._standing_since_ns = now_ns
        since_ns = self._standing_since_ns
        if wanted_mps == 0.0 or since_ns is None or now_ns - since_ns < STANDING_NS:
            return 0.0
        self._sign, self._standing_since_ns = wanted_sign, None
        return wanted_mps

    def forget(self) -> None:
        """Nobody drives; the next drive begins forwards."""
        self._sign = 1.0
        self._standing_since_ns = None
