"""UWA's Table 2 on UWA's car: each code, and the action that the paper gives it."""

from __future__ import annotations

import math

import pytest

from canbus.frame import Frame
from dbc.messages import ErrorCode, Mode, Reason, Request
from ecus.steering.ports import SteeringActuator
from simulation.plant.fsae_electric import column_angle_rad
from simulation.world import in_time
from tests.scenarios.driving import Drive
from vehicles import load_vehicle

pytestmark = pytest.mark.whole_car

UWA = load_vehicle("fsae_electric")
SERVO_ON_S = UWA.brake.on_time_s_max


def driving(curvature_per_m: float = 0.0) -> Drive:
    return Drive(vehicle=UWA).go(4.0, curvature_per_m)


def assert_braked_and_steering_coasts(drive: Drive) -> None:
    """The paper's "emergency brake engaged, steering motor set to coast"."""
    commands: list[SteeringActuator] = []
    station = drive.world.stations["Steering"]

    def note(true_ns: int, command: SteeringActuator) -> SteeringActuator:
        commands.append(command)
        return command

    station.acts.append(note)
    assert drive.brakes_to_standstill()
    assert drive.brake > 0.99
    assert commands and not any(command.motor_enabled for command in commands)
    assert not drive.car.parts.hardware.motor_powered


def test_er0_a_command_too_long_is_ignored() -> None:
    drive = driving()
    drive.world.inject(Frame(0x202, bytes(7)))
    drive.run(0.1)
    assert ErrorCode.ER0 in drive.codes and drive.is_in(Mode.AUTOMATIC)


def test_er1_is_there_while_an_emergency_brake_is() -> None:
    drive = driving()
    drive.request(Request.EMERGENCY_STOP)
    assert ErrorCode.ER1 in drive.codes and drive.brakes_to_standstill()


def test_er2_a_controller_that_locks_up_brakes() -> None:
    drive = driving()
    drive.world.stations["Steering"].lateness_ns = lambda: 56_000_000
    drive.run(0.02)
    drive.world.stations["Steering"].lateness_ns = in_time
    drive.run(0.2)
    assert ErrorCode.ER2 in drive.codes and drive.brakes_to_standstill()


def test_er3_the_servo_is_released_at_standstill_before_its_poles_burn() -> None:
    drive = driving()
    drive.request(Request.EMERGENCY_STOP)
    drive.run(SERVO_ON_S + 4.0)
    heat = drive.car.parts.brakes.heat
    assert heat is not None and not heat.is_burnt
    assert ErrorCode.ER3 in drive.codes and drive.brake < 0.05


def test_er4_a_fault_of_the_motor_driver_brakes_and_lets_the_steering_coast() -> None:
    drive = driving(0.08)
    drive.car.faults.steering_motor_fault = True
    drive.run(0.06)
    assert drive.first_emergency() == (ErrorCode.ER4, Reason.MOTOR_FAULT)
    assert_braked_and_steering_coasts(drive)


def test_er5_no_command_within_300_ms_brakes() -> None:
    drive = driving()
    drive.is_planner_silent = True
    drive.run(0.3)
    assert drive.first_emergency()[0] is ErrorCode.ER5
    assert drive.brakes_to_standstill()


@pytest.mark.parametrize("volts", [0.0, 5.0, math.nan], ids=["torn", "shorted", "unreadable"])
def test_er6_a_hall_sensor_out_of_bounds_brakes_and_lets_the_steering_coast(volts: float) -> None:
    drive = driving(0.08)
    drive.car.faults.steering_angle_override_rad = column_angle_rad(volts)
    drive.run(0.06)
    assert drive.first_emergency() == (ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS)
    assert_braked_and_steering_coasts(drive)


def test_the_hall_sensors_whole_range_is_that_of_the_column() -> None:
    assert column_angle_rad(2.5) == 0.0
    assert column_angle_rad(4.5) == pytest.approx(UWA.steering.sensor_angle_rad_max)
    assert column_angle_rad(0.5) == pytest.approx(-UWA.steering.sensor_angle_rad_max)
