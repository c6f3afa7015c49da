"""What the throttle ECU believes about the drive train, and the gains of its loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from vehicles import Vehicle

EXPOSED: Final = (
    "speed_gain",
    "integral_gain_per_s",
    "feed_forward_gain",
    "acceleration_mps2_max",
    "deceleration_mps2_max",
    "speed_mps_max",
    "driver_pedal_ratio_max",
    "command_timeout_s",
)
"""Readable by SDO, writable in MANUAL within the EDS's limits (object 0x2100)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThrottleParams:
    """From the vehicle file; sources are there."""

    speed_gain: float
    """m/s2 per m/s of speed error."""
    integral_gain_per_s: float
    """m/s2 per m of accumulated error."""
    feed_forward_gain: float
    acceleration_mps2_max: float
    deceleration_mps2_max: float
    speed_mps_max: float
    reverse_speed_mps_max: float
    """0: no reverse."""
    driver_pedal_ratio_max: float
    command_timeout_s: float
    wheel_radius_m: float
    gear_ratio: float
    encoder_pulses_per_rev: float
    rolling_resistance_mps2: float
    drive_acceleration_mps2_full: float
    """Acceleration at full drive torque."""
    regen_deceleration_mps2_full: float
    """Deceleration at full regeneration."""
    brake_travel_s: float
    hold_mps2: float
    """Deceleration of a brake that holds the standing car."""
    brake_mps2_full: float
    drive_lag_s: float

    def __post_init__(self) -> None:
        assert self.drive_acceleration_mps2_full > 0.0
        assert self.drive_lag_s >= 0.0

    @classmethod
    def of(cls, vehicle: Vehicle) -> ThrottleParams:
        """Parameters of one vehicle."""
        traction, geometry = vehicle.traction, vehicle.geometry
        mps2_per_nm = traction.gear_ratio / (geometry.wheel_radius_m * geometry.mass_kg)
        return cls(
            speed_gain=traction.speed_gain_per_s,
            integral_gain_per_s=traction.integral_gain_per_s2,
            feed_forward_gain=1.0,
            acceleration_mps2_max=traction.acceleration_mps2_max,
            deceleration_mps2_max=traction.deceleration_mps2_max,
            speed_mps_max=traction.speed_mps_max,
            reverse_speed_mps_max=traction.reverse_speed_mps_max,
            driver_pedal_ratio_max=traction.pedal_ratio_max,
            command_timeout_s=vehicle.times.command_timeout_s,
            wheel_radius_m=geometry.wheel_radius_m,
            gear_ratio=traction.gear_ratio,
            encoder_pulses_per_rev=traction.encoder_pulses_per_rev,
            drive_lag_s=traction.drive_lag_s,
            rolling_resistance_mps2=traction.rolling_resistance_mps2,
            drive_acceleration_mps2_full=traction.motor_torque_nm_max * mps2_per_nm,
            regen_deceleration_mps2_full=traction.regen_torque_nm_max * mps2_per_nm,
            brake_travel_s=vehicle.brake.full_travel_s,
            brake_mps2_full=vehicle.brake.deceleration_mps2_full,
            hold_mps2=vehicle.brake.hold_ratio * vehicle.brake.deceleration_mps2_full,
        )
