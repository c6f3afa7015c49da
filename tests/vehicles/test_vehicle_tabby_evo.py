"""TABBY EVO is the car of the papers: their figures, written a second time by hand."""

from __future__ import annotations

import math
import tomllib

import pytest

from vehicles import load_vehicle
from vehicles.vehicle import DriverPolicy

TABBY = load_vehicle("tabby_evo")


def test_the_dimensions_are_those_of_uahs_table() -> None:
    geometry = TABBY.geometry
    assert (geometry.wheelbase_m, geometry.track_m) == (2.360, 1.315)
    assert geometry.mass_kg == 730.0 + 2 * 75.0
    # Tyre 175/55R15: 15 inches, and 55 % of 175 mm twice.
    assert geometry.wheel_radius_m == pytest.approx((15 * 0.0254 + 2 * 0.55 * 0.175) / 2, abs=5e-4)


def test_the_drive_is_that_of_uahs_table() -> None:
    assert TABBY.traction.gear_ratio == 5.8
    assert TABBY.traction.motor_torque_nm_max == 128.0
    assert TABBY.traction.encoder_pulses_per_rev == 64.0
    assert TABBY.traction.speed_mps_max >= 25.0 / 3.6
    motor_rpm = TABBY.traction.speed_mps_max / TABBY.geometry.wheel_radius_m * 5.8 * 30 / math.pi
    assert motor_rpm < 5500.0


def test_the_smallest_radius_is_ten_metres() -> None:
    road_wheel_rad = TABBY.steering.wheel_angle_rad_max / TABBY.steering.ratio
    assert math.degrees(road_wheel_rad) == pytest.approx(13.25, abs=0.005)
    assert 1.0 / TABBY.curvature_per_m_max == pytest.approx(10.02, abs=0.01)


def test_the_column_turns_at_500_degrees_per_second() -> None:
    assert math.degrees(TABBY.steering.wheel_rate_radps_max) == pytest.approx(500.0, abs=0.5)


def test_the_brake_is_uwas_servo() -> None:
    assert TABBY.brake.full_travel_s == 0.29
    assert TABBY.longest_stop_s == pytest.approx(0.29 + 7.5 / 2.5)
    assert TABBY.brake.on_time_s_max >= 3 * TABBY.longest_stop_s


def test_the_envelope_is_iso_11270s() -> None:
    assert TABBY.envelope.lateral_acceleration_mps2_max == 3.0
    assert TABBY.envelope.lateral_jerk_mps3_max == 5.0


def test_the_monitor_has_room_above_what_the_nodes_may_do() -> None:
    envelope, steering = TABBY.envelope, TABBY.steering
    assert envelope.speed_mps_max > TABBY.traction.speed_mps_max
    assert envelope.wheel_angle_rad_max > steering.wheel_angle_rad_max
    assert envelope.wheel_rate_radps_max > 1.2 * steering.wheel_rate_radps_max


def test_times_policy_and_bus_are_uahs_and_the_designs() -> None:
    assert TABBY.times.command_timeout_s == 1.0
    assert TABBY.times.driver_debounce_s == 0.05
    assert TABBY.policy.driver_steers_against is DriverPolicy.MANUAL
    assert TABBY.policy.driver_brakes_alone is DriverPolicy.MANUAL
    assert TABBY.bus.bitrate_bps == 500_000
    assert (TABBY.bus.foreign_id_min, TABBY.bus.foreign_id_max) == (0x400, 0x4FF)


def test_every_number_tells_where_it_is_from() -> None:
    document = tomllib.loads(TABBY.text)
    assert document.pop("name") == TABBY.name == "tabby_evo"
    for section in document.values():
        for field, entry in section.items():
            first = entry["source"].split()[0].rstrip(":")
            assert first in ("UAH", "UWA", "ISO", "design", "assumption", "tuned"), field


def test_a_vehicle_is_frozen() -> None:
    with pytest.raises(AttributeError):
        TABBY.geometry.mass_kg = 1.0  # type: ignore[misc]
