"""The supervisor's numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from vehicles import Vehicle
from vehicles.vehicle import DriverPolicy

EXPOSED: Final = ("ready_timeout_s", "engage_speed_mps_max")
"""Readable by SDO, writable in MANUAL within the EDS's limits (object 0x2100)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisorParams:
    """From the vehicle file; sources are there."""

    ready_timeout_s: float
    engage_speed_mps_max: float
    command_timeout_s: float
    wheel_radius_m: float
    deceleration_mps2_full: float
    deceleration_mps2_min: float
    driver_steers_against: DriverPolicy
    driver_brakes_alone: DriverPolicy
    foreign_id_min: int
    foreign_id_max: int

    @classmethod
    def of(cls, vehicle: Vehicle) -> SupervisorParams:
        """Parameters of one vehicle."""
        return cls(
            ready_timeout_s=vehicle.times.ready_timeout_s,
            engage_speed_mps_max=vehicle.policy.engage_speed_mps_max,
            command_timeout_s=vehicle.times.command_timeout_s,
            wheel_radius_m=vehicle.geometry.wheel_radius_m,
            deceleration_mps2_full=vehicle.brake.deceleration_mps2_full,
            deceleration_mps2_min=vehicle.brake.deceleration_mps2_min,
            driver_steers_against=vehicle.policy.driver_steers_against,
            driver_brakes_alone=vehicle.policy.driver_brakes_alone,
            foreign_id_min=round(vehicle.bus.foreign_id_min),
            foreign_id_max=round(vehicle.bus.foreign_id_max),
        )
