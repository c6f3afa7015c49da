"""What a browser may ask for, and the dead-man that ends what it holds.

Sans-I/O: the hub is told, whoever owns the car's controls acts.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final, Protocol

DEAD_MAN_NS: Final = 500_000_000
"""What a browser holds is let go when it has not repeated that for so long."""


class Action(StrEnum):
    """What can be asked for; what a dashboard stands beside decides which of them there are."""

    EMERGENCY_BRAKE = "emergency_brake"
    BUTTON = "button"
    ENGAGE = "engage"
    DISENGAGE = "disengage"
    RESET = "reset"
    HOLD = "hold"
    """Keeps a wish in force; without it the wish ends."""


class Refused(Exception):
    """An action that the car, or its state, does not allow; one line for a person."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What is held: where to drive, and the driver's own pedals and hands."""

    speed_mps: float = 0.0
    curvature_per_m: float = 0.0
    throttle_pedal_ratio: float = 0.0
    brake_pedal_ratio: float = 0.0
    steering_torque_nm: float = 0.0


NO_WISH: Final = Wish()


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Largest values of a wish; 0 for what this dashboard cannot do."""

    speed_mps: float = 0.0
    curvature_per_m: float = 0.0
    pedal_ratio: float = 0.0
    steering_torque_nm: float = 0.0

    def wish(self, given: dict[str, Any]) -> Wish:
        """A wish from a browser's message, each value cut to what is allowed.

        Raises:
            Refused: A value that is no number.
        """
        return Wish(
            speed_mps=_number(given, "speed_mps", 0.0, self.speed_mps),
            curvature_per_m=_number(
                given, "curvature_per_m", -self.curvature_per_m, self.curvature_per_m
            ),
            throttle_pedal_ratio=_number(given, "throttle_pedal_ratio", 0.0, self.pedal_ratio),
            brake_pedal_ratio=_number(given, "brake_pedal_ratio", 0.0, self.pedal_ratio),
            steering_torque_nm=_number(
                given, "steering_torque_nm", -self.steering_torque_nm, self.steering_torque_nm
            ),
        )


def _number(given: dict[str, Any], name: str, low: float, high: float) -> float:
    value = given.get(name, 0.0)  # an integer of a thousand digits is one too; only NaN != NaN
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        raise Refused(f"{name}: a number is wanted")
    return float(min(max(value, low), high))


class Controls(Protocol):
    """Whoever can reach the car."""

    @property
    def actions(self) -> frozenset[Action]:
        """What is possible here."""
        ...

    @property
    def limits(self) -> Limits:
        """Of what can be held."""
        ...

    def emergency_brake(self) -> None:
        """At once, without waiting. Raises `Refused` when it could not be sent."""
        ...

    def act(self, action: Action) -> None:
        """Any other action but HOLD; may take seconds. Raises `Refused` with the reason."""
        ...

    def hold(self, wish: Wish) -> None:
        """The wish in force from now on; does not wait."""
        ...


class DeadMan:
    """One wish at a time, of one browser, for as long as that repeats it."""

    def __init__(self) -> None:
        self._holder: object | None = None
        self._until_ns = 0
        self.wish = NO_WISH

    def hold(self, holder: object, wish: Wish, now_ns: int) -> None:
        """A browser holds a wish.

        Raises:
            Refused: Another one holds one.
        """
        if self._holder is not None and holder is not self._holder:
            raise Refused("another browser has the controls: wait until it lets go")
        self._holder, self.wish, self._until_ns = holder, wish, now_ns + DEAD_MAN_NS

    def release(self, holder: object) -> None:
        """It lets go, or is gone; what another one holds stays."""
        if holder is self._holder:
            self._holder, self.wish = None, NO_WISH

    def is_held(self) -> bool:
        """Whether anybody holds a wish."""
        return self._holder is not None

    def elapse(self, now_ns: int) -> bool:
        """Ends a wish that was not repeated in time; whether it did."""
        if self._holder is None or now_ns < self._until_ns:
            return False
        self.release(self._holder)
        return True
