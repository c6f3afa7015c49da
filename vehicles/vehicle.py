"""What the nodes believe about a vehicle: the sections of its file and the ranges of their values.

The plant's truth is elsewhere (`simulation/plant/params.py`): controllers must not be tested
against a perfect model of themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

STOP_MARGIN = 3
"""The servo's on-time limit is at least this many times the longest stop (design, ER3)."""


class VehicleError(ValueError):
    """A vehicle file that cannot be used; the text names file, field, value and allowed range."""


class DriverPolicy(StrEnum):
    """What a driver who acts against the system triggers besides the hand-over."""

    MANUAL = "manual"
    """UAH: the driver has the car, nothing more."""
    EMERGENCY = "emergency"
    """UWA: an emergency brake as well."""


def number(low: float, high: float) -> Any:
    """A required number within [low, high]; the unit is in the field's name."""
    return field(metadata={"low": low, "high": high})


def whole(low: int, high: int) -> Any:
    """A required whole number within [low, high]: a count or a name, without a unit."""
    return field(metadata={"low": low, "high": high, "whole": True})


def optional_number(low: float, high: float, default: float) -> Any:
    """A number within [low, high] that a file may leave out."""
    return field(default=default, metadata={"low": low, "high": high})


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry:
    """Dimensions of the bicycle model."""

    wheelbase_m: float = number(0.1, 6.0)
    track_m: float = number(0.1, 3.0)
    wheel_radius_m: float = number(0.02, 1.0)
    mass_kg: float = number(1.0, 5000.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Steering:
    """Steering column, its motor and its loop; "wheel" is the steering wheel."""

    ratio: float = number(0.5, 100.0)
    wheel_angle_rad_max: float = number(0.05, 16.0)
    wheel_rate_radps_max: float = number(0.1, 20.0)
    wheel_acceleration_radps2_max: float = number(1.0, 1000.0)
    motor_free_speed_radps: float = number(0.5, 50.0)
    motor_time_constant_s: float = number(0.005, 1.0)
    motor_friction_duty_ratio: float = number(0.0, 0.9)
    position_gain_per_s: float = number(1.0, 40.0)
    integral_gain_per_s2: float = number(0.0, 50.0)
    rate_gain: float = number(0.0, 5.0)
    wheel_inertia_kgm2: float = number(0.0, 1.0)
    driver_torque_nm_max: float = number(0.5, 10.0)
    sensor_angle_rad_max: float = number(0.05, 16.5)
    zero_rad: float = optional_number(-2.0, 2.0, 0.0)
    """What the angle sensor reads straight ahead; `dbw calibrate` measures it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Traction:
    """Traction motor, gearbox, encoder and the speed loop."""

    gear_ratio: float = number(0.1, 100.0)
    motor_torque_nm_max: float = number(0.01, 2000.0)
    regen_torque_nm_max: float = number(0.0, 2000.0)
    encoder_pulses_per_rev: float = number(1.0, 100000.0)
    speed_mps_max: float = number(0.2, 35.0)
    reverse_speed_mps_max: float = optional_number(0.0, 10.0, 0.0)
    """0: this car does not drive backwards by command."""
    acceleration_mps2_max: float = number(0.1, 10.0)
    deceleration_mps2_max: float = number(0.1, 10.0)
    speed_gain_per_s: float = number(0.0, 20.0)
    integral_gain_per_s2: float = number(0.0, 20.0)
    drive_lag_s: float = optional_number(0.0, 2.0, 0.0)
    """From a torque demand to the torque, dead time and time constant together; what the feedback
    compares the speed with comes so much later. 0: at once."""
    rolling_resistance_mps2: float = number(0.0, 2.0)
    pedal_ratio_max: float = number(0.01, 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Brake:
    """Brake servo, the rear-wheel encoder beside it, and ER3's numbers."""

    full_travel_s: float = number(0.01, 5.0)
    deceleration_mps2_full: float = number(0.5, 15.0)
    deceleration_mps2_min: float = number(0.1, 15.0)
    controlled_stop_ratio: float = number(0.05, 1.0)
    hold_ratio: float = number(0.05, 1.0)
    on_time_s_max: float = number(5.0, 300.0)
    wheel_encoder_pulses_per_rev: float = number(1.0, 100000.0)
    pedal_ratio_max: float = number(0.01, 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Envelope:
    """What the safety monitor permits."""

    speed_mps_max: float = number(0.2, 40.0)
    lateral_acceleration_mps2_max: float = number(0.1, 15.0)
    lateral_jerk_mps3_max: float = number(0.1, 100.0)
    wheel_angle_rad_max: float = number(0.05, 16.0)
    wheel_rate_radps_max: float = number(0.1, 30.0)
    wheel_angle_divergence_rad_max: float = number(0.01, 10.0)
    speed_divergence_mps_max: float = number(0.05, 20.0)
    brake_divergence_ratio_max: float = number(0.01, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """The vehicle's own time-outs."""

    command_timeout_s: float = number(0.06, 1.25)
    ready_timeout_s: float = number(5.0, 600.0)
    driver_debounce_s: float = number(0.01, 0.2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Policy:
    """What the vehicle's makers decided."""

    driver_steers_against: DriverPolicy
    driver_brakes_alone: DriverPolicy
    engage_speed_mps_max: float = number(0.0, 15.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class BusSettings:
    """The vehicle bus as wired."""

    bitrate_bps: float = number(10_000, 1_000_000)
    foreign_id_min: float = number(0, 0x7FF)
    foreign_id_max: float = number(0, 0x7FF)


DRIVE_NAMES: Final = ("SteeringDrive", "LeftWheelDrive", "RightWheelDrive")


@dataclass(frozen=True, slots=True, kw_only=True)
class Drives:
    """Motor drives of CiA 402 on the bus, in place of what is wired to steer and throttle ECU.

    The section is for such cars alone. The wheels' gear is `traction.gear_ratio`.
    """

    steering_node_id: int = whole(0x11, 0x7F)
    left_wheel_node_id: int = whole(0x11, 0x7F)
    right_wheel_node_id: int = whole(0x11, 0x7F)
    encoder_counts_per_rev: float = number(16.0, 1_000_000.0)
    steering_gear_ratio: float = number(0.5, 1000.0)

    @property
    def node_ids(self) -> tuple[int, ...]:
        """All of them: steering, left and right rear wheel."""
        return self.steering_node_id, self.left_wheel_node_id, self.right_wheel_node_id

    @property
    def names(self) -> dict[int, str]:
        """What people call them, by node id."""
        return dict(zip(self.node_ids, DRIVE_NAMES, strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """A whole vehicle file."""

    name: str
    text: str
    """The file's text, for the hash that every node compares at boot."""
    geometry: Geometry
    steering: Steering
    traction: Traction
    brake: Brake
    envelope: Envelope
    times: Times
    policy: Policy
    bus: BusSettings
    drives: Drives | None = None

    @property
    def drive_node_ids(self) -> tuple[int, ...]:
        """Node ids of the drives on the bus; none on most cars."""
        return () if self.drives is None else self.drives.node_ids

    @property
    def curvature_per_m_max(self) -> float:
        """Largest curvature the steering reaches (UAH Eq. 13), 1/m."""
        road_wheel_rad = self.steering.wheel_angle_rad_max / self.steering.ratio
        return math.tan(road_wheel_rad) / self.geometry.wheelbase_m

    @property
    def longest_stop_s(self) -> float:
        """Time of an emergency stop from top speed on the worst road, servo travel included."""
        return self.brake.full_travel_s + (
            self.traction.speed_mps_max / self.brake.deceleration_mps2_min
        )
