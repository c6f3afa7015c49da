"""What is wired to the brake-servo ECU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class BrakeSensors:
    """One reading of servo, brake pedal and rear wheel."""

    servo_position_ratio: Final[float]
    """0 released to 1 full; NaN: broken."""
    pedal_ratio: Final[float]
    """Brake pedal, 0 to 1, moved by driver or servo, whichever is further; NaN: broken."""
    wheel_count: Final[int]
    """Signed count of the rear-wheel encoder's edges since power-on."""
    wheel_edge_age_s: Final[float]
    """How long before this reading the latest edge came, at most 1.0."""
    slope_rad: Final[float]
    """Inclinometer, positive nose up; right while the car stands; NaN: broken, or none."""

    def __init__(
        self,
        *,
        servo_position_ratio: float,
        pedal_ratio: float,
        wheel_count: int,
        wheel_edge_age_s: float,
        slope_rad: float,
    ) -> None:
        self.servo_position_ratio = servo_position_ratio
        self.pedal_ratio = pedal_ratio
        self.wheel_count = wheel_count
        self.wheel_edge_age_s = wheel_edge_age_s
        self.slope_rad = slope_rad


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class BrakeActuator:
    """Command to the servo; unless refreshed for 50 ms it goes full while the relay is closed."""

    servo_position_ratio: Final[float]
    """0 released to 1 full."""
    servo_powered: Final[bool]
    """False: the pedal's spring returns it."""

    def __init__(self, *, servo_position_ratio: float, servo_powered: bool) -> None:
        self.servo_position_ratio = servo_position_ratio
        self.servo_powered = servo_powered


RELEASED: Final = BrakeActuator(servo_position_ratio=0.0, servo_powered=False)
