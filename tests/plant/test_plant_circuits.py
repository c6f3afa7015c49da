"""UWA's safety circuits: what they do whatever the ECUs' outputs say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from ecus.supervisor.ports import SupervisorActuator
from simulation.plant.car import Car
from simulation.plant.derived import plant_of
from simulation.plant.fsae_electric import CIRCUITS
from simulation.plant.params import TABBY_EVO
from vehicles import load_vehicle

Drive = Callable[..., None]
PLANT = plant_of(load_vehicle("fsae_electric"))
WITHOUT = replace(PLANT, hardware=replace(PLANT.hardware, circuits=None))
OPEN = SupervisorActuator(automatic_relay_closed=False)


def moving(make_car: Callable[..., Car], drive: Drive, params: object = PLANT) -> Car:
    """A car whose ECUs ask for torque, a left turn and no brake."""
    car = make_car(params=params)
    drive(car, 2.5, throttle=0.4, duty=0.4)
    assert car.truth.motor_torque_nm > 20.0 and car.truth.speed_mps > 2.0
    return car


def on(car: Car, drive: Drive, span_s: float) -> None:
    """The ECUs' outputs go on as they were."""
    drive(car, span_s, throttle=0.4, duty=0.4)


def hardware(car: Car) -> tuple[bool, float, float]:
    """Steering motor's power, share of drive torque, where the servo is sent."""
    parts = car.parts.hardware
    return parts.motor_powered, parts.drive_ratio, parts.servo_target_ratio


def test_only_uwas_car_has_them() -> None:
    assert PLANT.hardware.circuits == CIRCUITS
    assert TABBY_EVO.hardware.circuits is None
    assert plant_of(load_vehicle("baja_5b")).hardware.circuits is None


def test_a_foot_on_the_brake_takes_the_drive_away_at_once_and_gives_it_back(
    make_car: Callable[..., Car], drive: Drive
) -> None:
    car = moving(make_car, drive)
    car.driver.brake_pedal_ratio = 0.1
    on(car, drive, 0.01)
    assert hardware(car) == (True, 0.0, 0.0)
    on(car, drive, 0.06)
    car.driver.brake_pedal_ratio = 0.0
    on(car, drive, 0.2)
    assert hardware(car)[1] > 0.3 and not car.emergency_line


def test_a_foot_while_the_servo_does_not_brake_raises_the_line(
    make_car: Callable[..., Car], drive: Drive
) -> None:
    car = moving(make_car, drive)
    car.driver.brake_pedal_ratio = 0.3
    on(car, drive, 0.09)
    assert hardware(car)[0] and not car.emergency_line
    on(car, drive, 0.02)
    assert hardware(car) == (False, 0.0, 1.0) and car.emergency_line
    assert car.sense_supervisor(car.truth.time_ns).emergency_stop_pressed
    car.driver.brake_pedal_ratio = 0.0
    on(car, drive, 0.35)
    assert car.truth.servo_position_ratio == 1.0
    assert not car.emergency_line, "the nodes have had their time to see it"
    on(car, drive, 3.0)
    assert car.truth.speed_mps == 0.0


def test_a_foot_that_helps_the_servo_raises_nothing(
    make_car: Callable[..., Car], drive: Drive
) -> None:
    car = moving(make_car, drive)
    drive(car, 0.3, brake=0.3)
    car.driver.brake_pedal_ratio = 0.8
    drive(car, 0.3, brake=0.3)
    assert not car.emergency_line and hardware(car)[2] == 0.3


@pytest.mark.parametrize(
    ("torque_nm", "duty", "is_raised"),
    [
        (-4.5, 0.4, True), (4.5, -0.4, True),
        (4.5, 0.4, False), (-4.5, -0.4, False),  # with the motor
        (-3.5, 0.4, False),  # a light hand
        (-4.5, 0.02, False),  # the motor pulls no way
    ],
)  # fmt: skip
def test_hands_against_the_motor_cut_it_and_brake(
    make_car: Callable[..., Car], drive: Drive, torque_nm: float, duty: float, is_raised: bool
) -> None:
    car = make_car(params=PLANT)
    car.driver.steering_torque_nm = torque_nm
    drive(car, 0.12, duty=duty, throttle=0.3)
    assert car.emergency_line == is_raised
    assert hardware(car)[0] != is_raised
    assert (hardware(car)[2] == 1.0) == is_raised


def test_hands_on_a_coasting_motor_raise_nothing(
    make_car: Callable[..., Car], drive: Drive
) -> None:
    car = make_car(params=PLANT)
    car.driver.steering_torque_nm = -8.0
    drive(car, 0.3, duty=0.4, coast=True)
    assert not car.emergency_line


def test_the_filter_begins_anew_when_the_hands_let_go(
    make_car: Callable[..., Car], drive: Drive
) -> None:
    car = make_car(params=PLANT)
    for _ in range(4):
        car.driver.steering_torque_nm = -8.0
        drive(car, 0.08, duty=0.4)
        car.driver.steering_torque_nm = 0.0
        drive(car, 0.02, duty=0.4)
    assert not car.emergency_line and hardware(car)[0]


def test_the_button_raises_the_line_at_once(make_car: Callable[..., Car], drive: Drive) -> None:
    car = moving(make_car, drive)
    car.driver.emergency_stop_pressed = True
    on(car, drive, 0.01)
    assert hardware(car) == (False, 0.0, 1.0)


def test_the_servo_is_given_back_before_it_burns_motor_and_drive_with_the_relay(
    make_car: Callable[..., Car], drive: Drive
) -> None:
    car = moving(make_car, drive)
    car.driver.emergency_stop_pressed = True
    on(car, drive, 0.05)
    car.driver.emergency_stop_pressed = False
    on(car, drive, CIRCUITS.brake_ns * 1e-9 - 0.1)
    assert hardware(car) == (False, 0.0, 1.0)
    on(car, drive, 0.2)
    assert hardware(car) == (False, 0.0, 0.0)
    car.actuate_supervisor(car.truth.time_ns, OPEN)
    on(car, drive, 0.05)
    car.actuate_supervisor(
        car.truth.time_ns, SupervisorActuator(automatic_relay_closed=True)
    )
    on(car, drive, 0.05)
    assert hardware(car)[0] and hardware(car)[1] > 0.3


def test_a_driver_with_the_relay_open_is_left_alone(
    make_car: Callable[..., Car], drive: Drive
) -> None:
    car = make_car(params=PLANT, automatic=False)
    car.driver.throttle_pedal_ratio = 0.5
    car.driver.brake_pedal_ratio = 0.2
    car.driver.steering_torque_nm = -8.0
    drive(car, 0.5, duty=0.5)
    assert not car.emergency_line
    assert hardware(car) == pytest.approx((False, 0.5, 0.0), abs=0.01)


def test_without_circuits_the_outputs_go_on_whatever_the_driver_does(
    make_car: Callable[..., Car], drive: Drive
) -> None:
    car = moving(make_car, drive, WITHOUT)
    car.driver.brake_pedal_ratio = 0.3
    car.driver.steering_torque_nm = -8.0
    on(car, drive, 0.5)
    assert hardware(car) == pytest.approx((True, 0.4, 0.0), abs=0.01) and not car.emergency_line
