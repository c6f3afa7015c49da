"""What the steering ECU believes about its column, and the gains of its loop."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

from vehicles import Vehicle

EXPOSED: Final = (
    "position_gain_per_s",
    "rate_gain",
    "integral_gain_per_s2",
    "wheel_rate_radps_max",
    "wheel_angle_rad_max",
    "driver_torque_nm_max",
    "command_timeout_s",
)
"""Readable by SDO, writable in MANUAL within the EDS's limits (object 0x2100)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SteeringParams:
    """From the vehicle file; sources are there."""

    position_gain_per_s: float
    rate_gain: float
    integral_gain_per_s2: float
    wheel_rate_radps_max: float
    wheel_acceleration_radps2_max: float
    wheel_angle_rad_max: float
    sensor_angle_rad_max: float
    zero_rad: float
    """What the sensor reads straight ahead."""
    motor_free_speed_radps: float
    motor_time_constant_s: float
    motor_friction_duty_ratio: float
    wheel_inertia_kgm2: float
    driver_torque_nm_max: float
    command_timeout_s: float
    wheel_radius_m: float
    hold_s_max: float

    def __post_init__(self) -> None:
        # or ER6 at full lock
        assert self.sensor_angle_rad_max >= self.wheel_angle_rad_max + abs(self.zero_rad)
        assert self.motor_free_speed_radps > 0.0

    @classmethod
    def of(cls, vehicle: Vehicle) -> SteeringParams:
        """Parameters of one vehicle."""
        steering = vehicle.steering
        shared = {f.name for f in fields(cls)} & {f.name for f in fields(steering)}
        return cls(
            **{name: getattr(steering, name) for name in shared},
            command_timeout_s=vehicle.times.command_timeout_s,
            wheel_radius_m=vehicle.geometry.wheel_radius_m,
            hold_s_max=vehicle.longest_stop_s,
        )
