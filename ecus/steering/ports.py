"""What is wired to the steering ECU."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SteeringSensors:
    """One reading of the steering column."""

    column_angle_rad: float
    """Steering-wheel angle, positive left; NaN when the sensor cannot be read."""
    driver_torque_nm: float
    """Torsion bar between steering wheel and motor: driver and the wheel's inertia; NaN: broken."""
    motor_fault: bool
    """The motor driver's fault line (ER4)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SteeringActuator:
    """Command to the motor driver; unless refreshed, its 50 ms watchdog opens the outputs."""

    motor_duty_ratio: float
    """-1 to 1, positive turns left."""
    motor_enabled: bool
    """False: outputs open, the motor coasts."""


COAST = SteeringActuator(motor_duty_ratio=0.0, motor_enabled=False)
