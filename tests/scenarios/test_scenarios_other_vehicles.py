"""Vehicles without a plant of their own, each a file and nothing else: they follow, and stop."""

from __future__ import annotations

import re
from functools import partial

import pytest

from dbc.messages import ErrorCode, Mode, Reason, Request
from tests.scenarios.driving import TABBY, Drive
from vehicles import Vehicle, load_vehicle, parse_vehicle

pytestmark = pytest.mark.whole_car

VAN: dict[str, dict[str, float]] = {
    "geometry": {"wheelbase_m": 3.2, "track_m": 1.7, "wheel_radius_m": 0.34, "mass_kg": 2100.0},
    "traction": {"motor_torque_nm_max": 280.0, "regen_torque_nm_max": 120.0, "gear_ratio": 7.0},
    "steering": {"ratio": 16.0, "wheel_angle_rad_max": 8.0, "sensor_angle_rad_max": 8.3},
}
BUGGY: dict[str, dict[str, float]] = {
    "geometry": {"wheelbase_m": 0.57, "track_m": 0.4, "wheel_radius_m": 0.085, "mass_kg": 14.0},
    "traction": {
        "motor_torque_nm_max": 0.6, "regen_torque_nm_max": 0.3, "gear_ratio": 12.0,
        "speed_mps_max": 3.0,
    },
    "steering": {
        "ratio": 2.0, "wheel_angle_rad_max": 0.8, "sensor_angle_rad_max": 0.85,
        "wheel_inertia_kgm2": 0.002, "wheel_rate_radps_max": 6.0,
    },
    "envelope": {
        "wheel_angle_rad_max": 0.83, "wheel_angle_divergence_rad_max": 0.2,
        "wheel_rate_radps_max": 8.0,
    },
}


def vehicle_of(name: str, changes: dict[str, dict[str, float]]) -> Vehicle:
    """TABBY's file with another name and other numbers."""
    text = TABBY.text.replace('"tabby_evo"', f'"{name}"')
    for section, values in changes.items():
        head, tail = text.split(f"\n[{section}]\n", 1)
        for field, value in values.items():
            pattern = rf"^{field} = {{ value = [^,]+,"
            entry = f"{field} = {{ value = {value},"
            tail, count = re.subn(pattern, entry, tail, count=1, flags=re.M)
            assert count == 1, field
        text = f"{head}\n[{section}]\n{tail}"
    return parse_vehicle(text, f"{name}.toml")


@pytest.mark.parametrize(
    ("make", "curvature_per_m"),
    [
        (partial(vehicle_of, "van", VAN), 0.12),
        (partial(vehicle_of, "buggy", BUGGY), 0.4),
        (partial(load_vehicle, "fsae_electric"), 0.2),
        (partial(load_vehicle, "baja_5b"), 0.5),
    ],
    ids=["van", "buggy", "fsae_electric", "baja_5b"],
)
def test_a_vehicle_of_another_size_follows_and_stops(
    make: partial[Vehicle], curvature_per_m: float
) -> None:
    drive = Drive(vehicle=make()).go(2.0, curvature_per_m)
    yaw_rate = drive.car.truth.yaw_rate_radps
    assert yaw_rate / drive.speed == pytest.approx(curvature_per_m, rel=0.1)
    drive.request(Request.EMERGENCY_STOP, 0.5)
    assert drive.brake > 0.9
    assert drive.brakes_to_standstill()


@pytest.mark.parametrize("hands", [{"steering_torque_nm": -6.0}, {"brake_pedal_ratio": 0.5}])
def test_uwas_driver_who_acts_against_the_system_stops_the_car(hands: dict[str, float]) -> None:
    drive = Drive(vehicle=load_vehicle("fsae_electric")).go(4.0, 0.05)
    for name, value in hands.items():
        setattr(drive.car.driver, name, value)
    drive.run(0.15)
    assert drive.first_emergency() == (ErrorCode.ER1, Reason.DRIVER_AGAINST_SYSTEM)
    assert drive.is_in(Mode.EMERGENCY)


def test_uwas_planner_may_be_silent_for_no_more_than_300_ms() -> None:
    drive = Drive(vehicle=load_vehicle("fsae_electric")).go(4.0)
    drive.is_planner_silent = True
    drive.run(0.31)
    assert drive.first_emergency()[0] is ErrorCode.ER5
