"""The other two papers' cars: what each paper gives, written a second time by hand."""

from __future__ import annotations

import math
import tomllib

import pytest

from vehicles import known_vehicles, load_vehicle
from vehicles.vehicle import DriverPolicy

UWA = load_vehicle("fsae_electric")
UNICAMP = load_vehicle("baja_5b")


def test_each_papers_car_is_shipped() -> None:
    assert known_vehicles() == ["baja_5b", "fsae_electric", "tabby_evo"]


@pytest.mark.parametrize("name", known_vehicles())
def test_every_number_tells_the_paper_or_that_it_is_an_assumption(name: str) -> None:
    sections = tomllib.loads(load_vehicle(name).text)
    sections.pop("name")
    known = ("assumption", "UAH ", "UWA ", "UNICAMP ", "HPI:", "ISO ", "design", "tuned on")
    for section in sections.values():
        for field, entry in section.items():
            assert entry["source"].startswith(known), (name, field)


def test_uwas_commands_time_out_after_300_ms() -> None:
    assert UWA.times.command_timeout_s == 0.3


def test_uwas_column_turns_at_190_degrees_per_second_at_most() -> None:
    steering = UWA.steering
    assert math.degrees(steering.wheel_rate_radps_max) < 190.0
    assert math.degrees(steering.motor_free_speed_radps) > 190.0
    assert UWA.envelope.wheel_rate_radps_max > math.radians(190.0)


def test_uwas_road_wheels_reach_the_15_degrees_that_it_measured() -> None:
    assert math.degrees(UWA.steering.wheel_angle_rad_max / UWA.steering.ratio) > 15.0


def test_uwas_servo_takes_0_29_s() -> None:
    assert UWA.brake.full_travel_s == 0.29


def test_uwas_driver_against_the_system_brakes() -> None:
    policy = UWA.policy
    assert policy.driver_steers_against is DriverPolicy.EMERGENCY
    assert policy.driver_brakes_alone is DriverPolicy.EMERGENCY


def test_unicamps_car_can_drive_its_circles() -> None:
    assert 1.0 / UNICAMP.curvature_per_m_max < 1.6
    assert UNICAMP.traction.speed_mps_max > 0.4
