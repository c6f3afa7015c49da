"""UWA's safety circuits in a whole car, with every ECU's software stopped.

The worst that stopped software can do: its outputs stay as they were, as timers that go on with
their pulses do. So the watchdogs, which would brake after 50 ms, are taken away here.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from dbc.messages import ErrorCode, Mode, Reason, Request
from simulation.plant.derived import plant_of
from simulation.plant.params import PlantParams
from tests.scenarios.driving import Drive
from vehicles import load_vehicle

pytestmark = pytest.mark.whole_car

UWA = load_vehicle("fsae_electric")
PLANT = plant_of(UWA)
HUNG_NS = 3_600_000_000_000
FOOT = {"brake_pedal_ratio": 0.3}
HANDS = {"steering_torque_nm": -8.0}
BUTTON = {"emergency_stop_pressed": True}


def driving(plant: PlantParams) -> Drive:
    """At 4 m/s, the motor turning the wheel to the left."""
    drive = Drive(vehicle=UWA, plant=plant).go(4.0)
    drive.curvature_per_m = 0.1
    drive.run(0.12)
    assert drive.car.parts.hardware.duty_ratio > 0.2
    return drive


def without_watchdogs(plant: PlantParams) -> PlantParams:
    return replace(plant, hardware=replace(plant.hardware, watchdog_ns=HUNG_NS))


def stop_all(drive: Drive, how: str) -> None:
    """Every node's software ends or hangs in one instant, the car driving."""
    for station in drive.world.stations.values():
        setattr(station, how, how == "is_frozen")


@pytest.mark.parametrize("how", ["is_alive", "is_frozen"])
@pytest.mark.parametrize("hands", [FOOT, HANDS, BUTTON], ids=["foot", "hands", "button"])
def test_with_all_software_stopped_the_circuits_stop_the_car(
    hands: dict[str, float], how: str
) -> None:
    drive = driving(without_watchdogs(PLANT))
    stop_all(drive, how)
    drive.world.run_for(0.2)
    assert drive.car.truth.servo_position_ratio == 0.0, "nothing else brakes"
    for name, value in hands.items():
        setattr(drive.car.driver, name, value)
    drive.world.run_for(0.11)
    hardware = drive.car.parts.hardware
    assert (hardware.motor_powered, hardware.drive_ratio) == (False, 0.0)
    drive.world.run_for(0.3)
    assert drive.car.truth.servo_position_ratio == 1.0
    drive.world.run_for(3.0)
    assert drive.car.truth.speed_mps == 0.0


def test_without_the_circuits_stopped_software_lets_the_car_go_on() -> None:
    plant = without_watchdogs(PLANT)
    drive = driving(replace(plant, hardware=replace(plant.hardware, circuits=None)))
    stop_all(drive, "is_alive")
    drive.car.driver.steering_torque_nm = HANDS["steering_torque_nm"]
    drive.car.driver.emergency_stop_pressed = True
    drive.world.run_for(1.0)
    assert drive.car.truth.servo_position_ratio == 0.0 and drive.car.parts.hardware.motor_powered


@pytest.mark.parametrize("how", ["is_alive", "is_frozen"])
def test_with_the_watchdogs_a_car_whose_software_stops_needs_no_driver(how: str) -> None:
    drive = driving(PLANT)
    stop_all(drive, how)
    drive.world.run_for(0.4)
    assert drive.car.truth.servo_position_ratio == 1.0
    assert not drive.car.emergency_line


@pytest.mark.parametrize("hands", [FOOT, HANDS], ids=["foot", "hands"])
def test_living_nodes_act_before_the_circuits_and_tell_why(hands: dict[str, float]) -> None:
    drive = driving(PLANT)
    for name, value in hands.items():
        setattr(drive.car.driver, name, value)
    raised = []
    for _ in range(50):
        drive.run(0.02)
        raised.append(drive.car.emergency_line)
    assert drive.first_emergency() == (ErrorCode.ER1, Reason.DRIVER_AGAINST_SYSTEM)
    assert not any(raised)


def test_a_pedal_sensor_that_lies_to_the_nodes_is_made_up_for_and_the_nodes_hear_of_it() -> None:
    drive = driving(PLANT)
    drive.car.faults.brake_pedal_override_ratio = 0.0
    drive.car.driver.brake_pedal_ratio = 0.3
    assert drive.run(0.2, until=lambda: drive.mode is Mode.EMERGENCY)
    assert drive.first_emergency() == (ErrorCode.ER1, Reason.EMERGENCY_STOP_INPUT)
    drive.car.driver.brake_pedal_ratio = 0.0
    assert drive.brakes_to_standstill()
    drive.request(Request.RESET, 1.0)
    assert drive.mode is Mode.MANUAL and not drive.car.truth.relay_closed
