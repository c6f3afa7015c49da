"""Setting off on a hill: torque against the brake, which the brake ECU lets go late and slowly.

The slope is not known here. On any slope that the brake holds, brake and drive together hold the
car while one takes over from the other; it moves where the drive wins, and what the drive needed
then tells the slope to the speed loop.
"""

from __future__ import annotations

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
        push_mps2: What to push with while the car stands.
        felt_mps2: What of it the car feels by now.
    """

    __slots__ = ("_since_ns", "felt_mps2", "phase", "push_mps2")

    def __init__(self) -> None:
        self.phase = HillPhase.NONE
        self.push_mps2 = 0.0
        self.felt_mps2 = 0.0
        self._since_ns: int | None = None

    def update(
        self, now_ns: int, dt_s: float, *, is_held: bool, speed_mps: float, hold_mps2: float
    ) -> HillPhase:
        """The phase after this step.

        Args:
            now_ns: Never goes back.
            dt_s: Since the last update.
            is_held: The car is told to go, and the brake ECU holds it.
            speed_mps: Towards where it is told to go.
            hold_mps2: What the brake holds the car with.
        """
        if not is_held:
            self._since_ns, self.phase = None, HillPhase.NONE
            self.push_mps2 = self.felt_mps2 = 0.0
            return self.phase
        if self._since_ns is None:
            if abs(speed_mps) >= STANDSTILL_MPS:
                return self.phase  # braked on the way, not held
            self._since_ns = now_ns
        if self.phase is not HillPhase.MOVE and now_ns - self._since_ns >= NOTICE_NS:
            has_moved = speed_mps >= STANDSTILL_MPS
            self.phase = HillPhase.MOVE if has_moved else HillPhase.PUSH
            self.felt_mps2 += dt_s / (dt_s + LAG_S) * (self.push_mps2 - self.felt_mps2)
            self.push_mps2 = min(self.push_mps2 + hold_mps2 / BUILD_S * dt_s, hold_mps2)
        return self.phase
