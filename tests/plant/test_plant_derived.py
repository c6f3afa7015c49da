"""A plant for a vehicle file that has none of its own."""

from __future__ import annotations

import re
from dataclasses import asdict
from typing import Any

import pytest

from simulation.plant.derived import derived, plant_of
from simulation.plant.params import TABBY_EVO
from vehicles import Vehicle, load_vehicle, parse_vehicle

TABBY = load_vehicle("tabby_evo")


def car(**changes: float) -> Vehicle:
    """TABBY's file under another name, some values changed."""
    text = TABBY.text.replace('"tabby_evo"', '"mine"')
    for name, value in changes.items():
        text, count = re.subn(
            rf"^{name} = {{ value = [^,]+,", f"{name} = {{ value = {value},", text,
            count=1, flags=re.M,
        )
        assert count == 1, name
    return parse_vehicle(text, "mine.toml")


def flat(params: Any) -> dict[str, Any]:
    """`section.field` to value."""
    return {
        f"{section}.{name}": value
        for section, values in asdict(params).items() if isinstance(values, dict)
        for name, value in values.items()
    }


def test_a_vehicle_with_a_plant_of_its_own_gets_it() -> None:
    assert plant_of(TABBY) is TABBY_EVO


def test_tabbys_numbers_under_another_name_give_tabbys_plant() -> None:
    plant = plant_of(car())
    assert plant.name == "mine"
    assert flat(plant) == pytest.approx(flat(TABBY_EVO))


def test_what_the_file_says_is_true_but_for_tabbys_deviations() -> None:
    plant = derived(car(
        mass_kg=1760.0, wheelbase_m=3.0, wheel_radius_m=0.35, ratio=16.0, full_travel_s=0.58,
        deceleration_mps2_full=3.5, motor_torque_nm_max=256.0,
    ))
    chassis = plant.chassis
    assert plant.mass_kg == pytest.approx(1760.0)
    assert chassis.wheelbase_m == 3.0
    assert chassis.wheel_radius_m == pytest.approx(0.35 * 0.284 / 0.287)
    assert chassis.front_cornering_stiffness_n_per_rad == pytest.approx(110_000.0)
    assert plant.steering.column_to_road_wheel_ratio == 16.0
    assert plant.brakes.servo_travel_s == 0.58
    assert plant.brakes.servo_return_s == pytest.approx(0.5)
    assert plant.brakes.force_full_n == pytest.approx(6160.0)  # twice the mass, half as hard
    assert plant.traction.motor_torque_nm_max == 256.0


def test_end_stops_lie_between_the_largest_angle_and_what_the_sensor_shows() -> None:
    plant = derived(car(wheel_angle_rad_max=0.8, sensor_angle_rad_max=0.9))
    assert 0.8 < plant.steering.end_stop_rad < 0.9


def test_the_steering_motor_has_the_free_speed_and_time_constant_of_the_file_nearly() -> None:
    steering = derived(car(motor_free_speed_radps=6.0, motor_time_constant_s=0.2)).steering
    assert steering.motor_no_load_speed_radps == pytest.approx(7.0)
    inertia = steering.hand_wheel_inertia_kgm2 + steering.column_inertia_kgm2
    time_constant_s = inertia * steering.motor_no_load_speed_radps / steering.motor_stall_torque_nm
    assert time_constant_s == pytest.approx(0.2, rel=0.01)


def test_a_small_vehicle_carries_nobody() -> None:
    assert derived(car(mass_kg=14.0)).chassis.occupants_count == 0
    assert derived(car(mass_kg=14.0)).mass_kg == pytest.approx(14.0)
