"""Profile position and profile velocity (CiA 402-2, clauses on pp and pv)."""

from __future__ import annotations

from typing import Protocol

from canbus import cia402
from simulation.drives.axis import TICK_S, Axis, Dwell


class Mode(Protocol):
    """A mode of operation while the operation is enabled."""

    @property
    def holds_position(self) -> bool:
        """Whether the position loop works, and a following error is a fault."""

    @property
    def limit_a(self) -> float:
        """Bound on the current besides the drive's own."""

    def start(self) -> None:
        """The mode begins, or operation is enabled anew: nothing moves that was not asked for."""

    def command(self, controlword: int, before: int) -> None:
        """A controlword came; `before` is the one before it."""

    def tick(self, controlword: int) -> None:
        """Moves the reference by one tick."""

    def status(self) -> int:
        """The mode's bits of the statusword."""


class ProfilePosition:
    """Moves to positions, one at once or one after another; bit 4 hands them over."""

    holds_position = True
    limit_a = float("inf")

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self._window = Dwell()
        self._target: int | None = None
        self._next: int | None = None
        self._is_handing_over = False
        self._is_reached = False
        self._is_limited = False

    def start(self) -> None:
        """Holds where it is until a set-point comes."""
        self._target = self._next = None
        self._is_reached = self._is_limited = self._is_handing_over = False

    def command(self, controlword: int, before: int) -> None:
        """Takes a set-point with the rising edge of bit 4; bit 5: at once, bit 6: relative."""
        asked = bool(controlword & cia402.NEW_SETPOINT)
        if asked and not before & cia402.NEW_SETPOINT:
            values = self._axis.values
            target = values[cia402.TARGET_POSITION]
            if controlword & cia402.RELATIVE:
                target += round(self._axis.reference.position) if self._target is None else (
                    self._target
                )
            low, high = values[cia402.POSITION_LIMIT_MIN], values[cia402.POSITION_LIMIT_MAX]
            within = min(max(target, low), high)
            self._is_limited = within != target
            if controlword & cia402.CHANGE_AT_ONCE or self._target is None or self._is_reached:
                self._target, self._next, self._is_reached = within, None, False
            elif self._next is None:
                self._next = within
        self._is_handing_over = asked

    def tick(self, controlword: int) -> None:
        """Approaches the target, or stops while bit 8 stands."""
        axis, values = self._axis, self._axis.values
        if controlword & cia402.HALT or self._target is None:
            axis.stop(values[cia402.HALT_OPTION])
            self._is_reached = axis.is_standing and axis.reference.velocity == 0.0
            return
        axis.reference.approach(
            self._target,
            min(axis.rate(cia402.PROFILE_VELOCITY), axis.rate(cia402.PROFILE_VELOCITY_MAX)),
            axis.rate(cia402.PROFILE_ACCELERATION),
            axis.rate(cia402.PROFILE_DECELERATION),
            TICK_S,
        )
        is_near = abs(self._target - axis.position) <= values[cia402.POSITION_WINDOW]
        self._is_reached = self._window.lasts(is_near, values[cia402.POSITION_WINDOW_TIME])
        if self._is_reached and self._next is not None:
            self._target, self._next, self._is_reached = self._next, None, False

    def status(self) -> int:
        """Target reached (standing, under halt), set-point acknowledged, limit."""
        taken = self._is_handing_over or self._next is not None
        return (
            (cia402.TARGET_REACHED if self._is_reached else 0)
            | (cia402.SETPOINT_ACKNOWLEDGED if taken else 0)
            | (cia402.LIMIT_ACTIVE if self._is_limited else 0)
        )


class ProfileVelocity:
    """Follows the target velocity by ramps. It is in force as soon as operation is enabled."""

    holds_position = False
    limit_a = float("inf")

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self._window = Dwell()
        self._is_reached = False
        self._is_limited = False

    def start(self) -> None:
        """Nothing to forget."""
        self._is_reached = False

    def command(self, controlword: int, before: int) -> None:
        """No bit of this mode acts by its edge."""

    def tick(self, controlword: int) -> None:
        """Ramps to the target, or stops while bit 8 stands."""
        axis, values = self._axis, self._axis.values
        if controlword & cia402.HALT:
            axis.stop(values[cia402.HALT_OPTION])
            self._is_reached = axis.is_standing and axis.reference.velocity == 0.0
            return
        target, bound = values[cia402.TARGET_VELOCITY], values[cia402.PROFILE_VELOCITY_MAX]
        within = min(max(target, -bound), bound)
        self._is_limited = within != target
        axis.ramp(within)
        is_near = abs(axis.velocity_rpm - within) <= values[cia402.VELOCITY_WINDOW]
        self._is_reached = self._window.lasts(is_near, values[cia402.VELOCITY_WINDOW_TIME])

    def status(self) -> int:
        """Target reached (standing, under halt), standing, limit."""
        return (
            (cia402.TARGET_REACHED if self._is_reached else 0)
            | (cia402.STANDING if self._axis.is_standing else 0)
            | (cia402.LIMIT_ACTIVE if self._is_limited else 0)
        )
