"""What is wired to the steering ECU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class SteeringSensors:
    """One reading of the steering column."""

    column_angle_rad: Final[float]
    """Steering-wheel angle as the sensor reads it, its zero not yet taken off; positive left;
    NaN when it cannot be read."""
    driver_torque_nm: Final[float]
    """Torsion bar between steering wheel and motor: driver and the wheel's inertia; NaN: broken."""
    motor_fault: Final[bool]
    """The motor driver's fault line (ER4)."""

    def __init__(
        self,
        *,
        column_angle_rad: float,
        driver_torque_nm: float,
        motor_fault: bool,
    ) -> None:
        self.column_angle_rad = column_angle_rad
        self.driver_torque_nm = driver_torque_nm
        self.motor_fault = motor_fault


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class SteeringActuator:
    """Command to the motor driver; unless refreshed, its 50 ms watchdog opens the outputs."""

    motor_duty_ratio: Final[float]
    """-1 to 1, positive turns left."""
    motor_enabled: Final[bool]
    """False: outputs open, the motor coasts."""

    def __init__(self, *, motor_duty_ratio: float, motor_enabled: bool) -> None:
        self.motor_duty_ratio = motor_duty_ratio
        self.motor_enabled = motor_enabled


COAST: Final = SteeringActuator(motor_duty_ratio=0.0, motor_enabled=False)
