"""One hazard: what called for the emergency brake, and what followed."""

from __future__ import annotations

from oracle.report import Reaction
from oracle.words import NS_PER_MS


class Hazard:
    """One cause that calls for the brake, and when what followed."""

    __slots__ = (
        "began_ns", "budget_ns", "emergency_ns", "full_ns", "is_end_told", "is_excused",
        "is_late_told",
        "is_over", "is_planners", "kind", "setpoint_ns", "speed_mps", "standstill_ns", "target",
    )

    def __init__(
        self, kind: str, target: str, began_ns: int, budget_ns: int, speed_mps: float,
        is_planners: bool = False,
    ) -> None:
        self.kind = kind
        self.target = target
        self.began_ns = began_ns
        self.budget_ns = budget_ns
        self.speed_mps = speed_mps
        self.is_planners = is_planners
        self.emergency_ns: int | None = None
        self.setpoint_ns: int | None = None
        self.full_ns: int | None = None
        self.standstill_ns: int | None = None
        self.is_over = False  # the driver has the car, or the cause went before it was due
        self.is_late_told = False
        self.is_excused = False
        self.is_end_told = False

    @property
    def is_answered(self) -> bool:
        """The brake is called, or applied without a word."""
        return self.emergency_ns is not None or self.setpoint_ns is not None

    def reaction(self) -> Reaction:
        """As the report tells it."""
        return Reaction(
            kind=self.kind, target=self.target, true_ns=self.began_ns,
            emergency_ms=self._since(self.emergency_ns), setpoint_ms=self._since(self.setpoint_ns),
            brake_ms=self._since(self.full_ns), standstill_ms=self._since(self.standstill_ns),
            is_missed=self.is_late_told and not self.is_excused,
            is_moot=self.is_over and not self.is_answered,
        )

    def _since(self, time_ns: int | None) -> float | None:
        return None if time_ns is None else (time_ns - self.began_ns) / NS_PER_MS

    def __str__(self) -> str:
        """What it is, and since when."""
        return f"{self.kind} of {self.target} at {self.began_ns / 1e9:.3f} s"
