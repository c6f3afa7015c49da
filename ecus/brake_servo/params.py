"""What the brake-servo ECU believes about servo, pedal and rear wheel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from vehicles import Vehicle
from vehicles.vehicle import STOP_MARGIN

EXPOSED: Final = (
    "on_time_s_max",
    "driver_pedal_ratio_max",
    "position_rate_per_s_max",
    "command_timeout_s",
)
"""Readable by SDO, writable in MANUAL within the EDS's limits (object 0x2100)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BrakeParams:
    """From the vehicle file; sources are there."""

    on_time_s_max: float
    driver_pedal_ratio_max: float
    position_rate_per_s_max: float
    command_timeout_s: float
    full_travel_s: float
    controlled_stop_ratio: float
    controlled_stop_s: float
    """How long that takes from top speed on the level, by the servo alone."""
    hold_ratio: float
    wheel_radius_m: float
    wheel_encoder_pulses_per_rev: float
    on_time_s_min: float
    """Three times the longest stop: no shorter on-time is accepted (design, ER3)."""

    def __post_init__(self) -> None:
        assert self.on_time_s_max >= self.on_time_s_min

    @classmethod
    def of(cls, vehicle: Vehicle) -> BrakeParams:
        """Parameters of one vehicle."""
        brake = vehicle.brake
        return cls(
            on_time_s_max=brake.on_time_s_max,
            driver_pedal_ratio_max=brake.pedal_ratio_max,
            position_rate_per_s_max=1.0 / brake.full_travel_s,
            command_timeout_s=vehicle.times.command_timeout_s,
            full_travel_s=brake.full_travel_s,
            controlled_stop_ratio=brake.controlled_stop_ratio,
            controlled_stop_s=vehicle.traction.speed_mps_max
            / (brake.controlled_stop_ratio * brake.deceleration_mps2_full),
            hold_ratio=brake.hold_ratio,
            wheel_radius_m=vehicle.geometry.wheel_radius_m,
            wheel_encoder_pulses_per_rev=brake.wheel_encoder_pulses_per_rev,
            on_time_s_min=STOP_MARGIN * vehicle.longest_stop_s,
        )
