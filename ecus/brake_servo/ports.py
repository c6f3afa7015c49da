"""What is wired to the brake-servo ECU."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class BrakeSensors:
    """One reading of servo, brake pedal and rear wheel."""

    servo_position_ratio: float
    """0 released to 1 full; NaN: broken."""
    pedal_ratio: float
    """Brake pedal, 0 to 1, moved by driver or servo, whichever is further; NaN: broken."""
    wheel_count: int
    """Signed count of the rear-wheel encoder's edges since power-on."""
    wheel_edge_age_s: float
    """How long before this reading the latest edge came, at most 1.0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BrakeActuator:
    """Command to the servo; unless refreshed for 50 ms it goes full while the relay is closed."""

    servo_position_ratio: float
    """0 released to 1 full."""
    servo_powered: bool
    """False: the pedal's spring returns it."""


RELEASED = BrakeActuator(servo_position_ratio=0.0, servo_powered=False)
