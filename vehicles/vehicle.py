"""What the nodes believe about a vehicle: one TOML file, every number with its source, checked.

The plant's truth is elsewhere (`simulation/plant/params.py`): controllers must not be tested
against a perfect model of themselves.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, field, fields
from enum import StrEnum
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Traction:
    """Traction motor, gearbox, encoder and the speed loop."""

    gear_ratio: float = number(0.1, 100.0)
    motor_torque_nm_max: float = number(0.01, 2000.0)
    regen_torque_nm_max: float = number(0.0, 2000.0)
    encoder_pulses_per_rev: float = number(1.0, 100000.0)
    speed_mps_max: float = number(0.2, 35.0)
    acceleration_mps2_max: float = number(0.1, 10.0)
    deceleration_mps2_max: float = number(0.1, 10.0)
    speed_gain_per_s: float = number(0.0, 20.0)
    integral_gain_per_s2: float = number(0.0, 20.0)
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


_SECTIONS: dict[str, type[Any]] = {
    "geometry": Geometry,
    "steering": Steering,
    "traction": Traction,
    "brake": Brake,
    "envelope": Envelope,
    "times": Times,
    "policy": Policy,
    "bus": BusSettings,
}

SectionT = TypeVar("SectionT")


def known_vehicles() -> list[str]:
    """Names of the vehicles shipped with the package."""
    return sorted(
        item.name.removesuffix(".toml")
        for item in files("vehicles").iterdir()
        if item.name.endswith(".toml")
    )


def load_vehicle(name_or_path: str) -> Vehicle:
    """A shipped vehicle by name, or a file by path (anything ending in `.toml`).

    Raises:
        VehicleError: The file is missing or holds something that cannot be used.
    """
    if name_or_path.endswith(".toml"):
        try:
            text = Path(name_or_path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise VehicleError(f"{name_or_path}: cannot be read: {error}") from error
        return parse_vehicle(text, name_or_path)
    if name_or_path not in known_vehicles():
        known = ", ".join(known_vehicles())
        raise VehicleError(
            f"vehicle {name_or_path!r} is not known: allowed {known}, or a path ending in .toml"
        )
    resource = files("vehicles").joinpath(f"{name_or_path}.toml")
    return parse_vehicle(resource.read_text(encoding="utf-8"), f"{name_or_path}.toml")


def parse_vehicle(text: str, origin: str) -> Vehicle:
    """A vehicle from TOML text; `origin` names it in errors.

    Raises:
        VehicleError: Naming origin, field, value and allowed range.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise VehicleError(f"{origin}: not valid TOML: {error}") from error
    name = document.pop("name", None)
    if not isinstance(name, str) or not name:
        raise VehicleError(f"{origin}: name = {name!r}: a non-empty text is wanted")
    for section in document.keys() - _SECTIONS.keys():
        raise VehicleError(f"{origin}: [{section}] is not known: allowed {', '.join(_SECTIONS)}")
    sections = {
        section: _parse_section(document.get(section), kind, f"{origin}: {section}")
        for section, kind in _SECTIONS.items()
    }
    vehicle = Vehicle(name=name, text=text, **sections)
    _check_relations(vehicle, origin)
    return vehicle


def _parse_section(table: object, kind: type[SectionT], where: str) -> SectionT:
    if not isinstance(table, dict):
        raise VehicleError(f"{where}: the section is missing")
    wanted = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
    for unknown in table.keys() - wanted.keys():
        raise VehicleError(f"{where}.{unknown} is not known: allowed {', '.join(wanted)}")
    values: dict[str, Any] = {}
    for name, spec in wanted.items():
        entry = table.get(name)
        if not isinstance(entry, dict) or entry.keys() != {"value", "source"}:
            raise VehicleError(
                f"{where}.{name} is missing: wanted {{ value = ..., source = \"...\" }}"
            )
        if not isinstance(entry["source"], str) or not entry["source"].strip():
            raise VehicleError(f"{where}.{name}: the source is missing: where is it from?")
        values[name] = _parse_value(entry["value"], dict(spec.metadata), f"{where}.{name}")
    return kind(**values)


def _parse_value(value: object, metadata: dict[str, float], where: str) -> float | DriverPolicy:
    if not metadata:
        if value not in list(DriverPolicy):
            raise VehicleError(f"{where} = {value!r}: allowed {', '.join(DriverPolicy)}")
        return DriverPolicy(str(value))
    low, high = metadata["low"], metadata["high"]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:  # type: ignore[operator]
        raise VehicleError(f"{where} = {value!r}: allowed {low:g} to {high:g}")
    return float(value)  # type: ignore[arg-type]


def _check_relations(vehicle: Vehicle, origin: str) -> None:
    steering, brake, envelope = vehicle.steering, vehicle.brake, vehicle.envelope
    rules = (
        ("brake.on_time_s_max", brake.on_time_s_max, STOP_MARGIN * vehicle.longest_stop_s,
         "at least three times the longest stop"),
        ("steering.sensor_angle_rad_max", steering.sensor_angle_rad_max,
         steering.wheel_angle_rad_max, "at least steering.wheel_angle_rad_max"),
        ("envelope.speed_mps_max", envelope.speed_mps_max, vehicle.traction.speed_mps_max,
         "at least traction.speed_mps_max"),
        ("envelope.wheel_angle_rad_max", envelope.wheel_angle_rad_max,
         steering.wheel_angle_rad_max, "at least steering.wheel_angle_rad_max"),
        ("envelope.wheel_rate_radps_max", envelope.wheel_rate_radps_max,
         steering.wheel_rate_radps_max, "at least steering.wheel_rate_radps_max"),
        ("brake.deceleration_mps2_full", brake.deceleration_mps2_full,
         brake.deceleration_mps2_min, "at least brake.deceleration_mps2_min"),
        ("bus.foreign_id_max", vehicle.bus.foreign_id_max, vehicle.bus.foreign_id_min,
         "at least bus.foreign_id_min"),
    )
    for name, value, low, why in rules:
        if value < low:
            raise VehicleError(f"{origin}: {name} = {value:g}: must be {why} ({low:g})")
