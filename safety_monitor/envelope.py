"""What the safety monitor permits, in numbers of its own.

The vehicle file is its only source; nothing here is shared with an ECU or with the gateway.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from vehicles import Vehicle

EXPOSED: Final = (
    "speed_mps_max",
    "lateral_acceleration_mps2_max",
    "lateral_jerk_mps3_max",
    "wheel_angle_rad_max",
    "wheel_rate_radps_max",
)
"""Readable by SDO, never writable (object 0x2100)."""


FOLLOW_MARGIN: Final = 1.25
"""Times in which a command must have been followed, over what the vehicle file needs for it."""
FOLLOW_LAG_NS: Final = 500_000_000
"""On top: dead time, the last bit of approach, and the divergence limit's own persistence."""

NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """One vehicle's envelope; sources are in its file."""

    speed_mps_max: float
    reverse_speed_mps_max: float
    """Backwards; the same as forwards on a car that has no reverse, and only rolls so."""
    lateral_acceleration_mps2_max: float
    lateral_jerk_mps3_max: float
    wheel_angle_rad_max: float
    wheel_rate_radps_max: float
    wheel_angle_divergence_rad_max: float
    speed_divergence_mps_max: float
    brake_divergence_ratio_max: float
    wheelbase_m: float
    wheel_radius_m: float
    steering_ratio: float
    command_timeout_s: float
    steering_follow_ns: int
    speed_follow_ns: int
    brake_follow_ns: int
    foreign_id_min: int
    foreign_id_max: int

    @classmethod
    def of(cls, vehicle: Vehicle) -> Limits:
        """Limits of one vehicle."""
        envelope, steering, traction = vehicle.envelope, vehicle.steering, vehicle.traction
        acceleration_mps2 = min(traction.acceleration_mps2_max, traction.deceleration_mps2_max)
        reverse_mps = envelope.speed_mps_max
        if traction.reverse_speed_mps_max > 0.0:  # with the margin that it has forwards
            reverse_mps += traction.reverse_speed_mps_max - traction.speed_mps_max
        return cls(
            speed_mps_max=envelope.speed_mps_max,
            reverse_speed_mps_max=reverse_mps,
            lateral_acceleration_mps2_max=envelope.lateral_acceleration_mps2_max,
            lateral_jerk_mps3_max=envelope.lateral_jerk_mps3_max,
            wheel_angle_rad_max=envelope.wheel_angle_rad_max,
            wheel_rate_radps_max=envelope.wheel_rate_radps_max,
            wheel_angle_divergence_rad_max=envelope.wheel_angle_divergence_rad_max,
            speed_divergence_mps_max=envelope.speed_divergence_mps_max,
            brake_divergence_ratio_max=envelope.brake_divergence_ratio_max,
            wheelbase_m=vehicle.geometry.wheelbase_m,
            wheel_radius_m=vehicle.geometry.wheel_radius_m,
            steering_ratio=vehicle.steering.ratio,
            command_timeout_s=vehicle.times.command_timeout_s,
            steering_follow_ns=_follow_ns(
                2.0 * steering.wheel_angle_rad_max / steering.wheel_rate_radps_max
            ),
            speed_follow_ns=_follow_ns(traction.speed_mps_max / acceleration_mps2),
            brake_follow_ns=_follow_ns(vehicle.brake.full_travel_s),
            foreign_id_min=round(vehicle.bus.foreign_id_min),
            foreign_id_max=round(vehicle.bus.foreign_id_max),
        )


def _follow_ns(travel_s: float) -> int:
    return round(FOLLOW_MARGIN * travel_s * NS_PER_S) + FOLLOW_LAG_NS
