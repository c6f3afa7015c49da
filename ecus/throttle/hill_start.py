"""Setting off on a hill: torque against the brake, which the brake ECU lets go late and slowly.

The slope is not known here. On any slope that the brake holds, brake and drive together hold the
car while one takes over from the other; it moves where the drive wins, and what the drive needed
then tells the slope to the speed loop.
"""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import Final

from ecus.throttle.control import STANDSTILL_MPS

NOTICE_NS: Final = 200_000_000
"""On the level the servo is released within 120 ms, the bus included: a brake that its own ECU
still holds after this is held against a hill."""
BUILD_S: Final = 0.4
"""In which the torque comes to what the held brake can hold."""
LAG_S: Final = 0.15
"""Assumption: what is asked of a drive acts about so much later."""


class HillPhase(Enum):
    """How far a hill start has come."""

    NONE = auto()
    """There is none: the speed loop drives."""
    PUSH = auto()
    """The car stands; torque builds against the brake."""
    MOVE = auto()
    """It moves; the speed loop drives, and makes up for what the brake still takes."""


class HillStart:
    """One object, changed by `update` alone.

    Attributes:
        phase: How far it has come.
        push_mps2: What to push with while the car stands.
        hill_mps2: What the hill and the car's resistance take, if it moves now.
    """

    __slots__ = ("_felt_mps2", "_since_ns", "hill_mps2", "phase", "push_mps2")

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """There is none; the next begins anew."""
        self.phase = HillPhase.NONE
        self.push_mps2 = self.hill_mps2 = 0.0
        self._felt_mps2 = 0.0
        self._since_ns: int | None = None

    def update(
        self,
        now_ns: int,
        dt_s: float,
        *,
        is_held: bool,
        speed_mps: float,
        hold_mps2: float,
        brake_mps2: float,
    ) -> HillPhase:
        """The phase after this step.

        Args:
            now_ns: Never goes back.
            dt_s: Since the last update.
            is_held: The car is told to go, and the brake ECU holds it.
            speed_mps: Towards where it is told to go.
            hold_mps2: What the brake holds the car with.
            brake_mps2: What it takes now; NaN ends the start.
        """
        if not is_held or math.isnan(brake_mps2):
            self.forget()
            return self.phase
        if self._since_ns is None:
            if abs(speed_mps) >= STANDSTILL_MPS:
                return self.phase  # braked on the way, not held
            self._since_ns = now_ns
        if self.phase is HillPhase.MOVE or now_ns - self._since_ns < NOTICE_NS:
            return self.phase
        # What beats brake and hill has grown from nothing while it made the car this fast: it is no
        # part of the hill.
        surplus_mps2 = math.sqrt(2.0 * hold_mps2 / BUILD_S * max(speed_mps, 0.0))
        if speed_mps >= STANDSTILL_MPS:
            self.phase = HillPhase.MOVE
            self.hill_mps2 = self._felt_mps2 - brake_mps2 - surplus_mps2
            return self.phase
        self.phase = HillPhase.PUSH
        self._felt_mps2 += dt_s / (dt_s + LAG_S) * (self.push_mps2 - self._felt_mps2)
        self.hill_mps2 = self._felt_mps2 - brake_mps2 - surplus_mps2
        self.push_mps2 = min(self.push_mps2 + hold_mps2 / BUILD_S * dt_s, hold_mps2)
        return self.phase
