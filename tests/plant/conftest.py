"""A car in automatic, and a hand that feeds all its actuators every 10 ms."""

from collections.abc import Callable

import numpy as np
import pytest

from ecus.brake_servo.ports import BrakeActuator
from ecus.steering.ports import SteeringActuator
from ecus.supervisor.ports import SupervisorActuator
from ecus.throttle.ports import ThrottleActuator
from simulation.plant.car import ORIGIN, Car
from simulation.plant.params import TABBY_EVO, PlantParams
from simulation.plant.state import Pose

PERIOD_NS = 10_000_000
IDLE_CODE = 410
FULL_CODE = 3686


def build(
    params: PlantParams = TABBY_EVO,
    seed: int = 1,
    automatic: bool = True,
    start_pose: Pose = ORIGIN,
) -> Car:
    """A parked car; automatic closes its relay."""
    car = Car(params, np.random.default_rng(seed), start_pose)
    if automatic:
        car.actuate_supervisor(0, SupervisorActuator(automatic_relay_closed=True))
    return car


def feed(
    car: Car,
    duration_s: float,
    *,
    duty: float = 0.0,
    throttle: float = 0.0,
    regen: float = 0.0,
    brake: float = 0.0,
    hold_angle_rad: float | None = None,
    coast: bool = False,
) -> None:
    """Refreshes every actuator each 10 ms; an angle to hold replaces the duty."""
    begin_ns = car.truth.time_ns
    code = round(IDLE_CODE + throttle * (FULL_CODE - IDLE_CODE))
    regen_code = round(IDLE_CODE + regen * (FULL_CODE - IDLE_CODE))
    for now_ns in range(begin_ns, begin_ns + round(duration_s * 1e9), PERIOD_NS):
        car.advance(now_ns)
        if hold_angle_rad is not None:
            truth = car.truth
            error = hold_angle_rad - truth.column_angle_rad
            duty = min(1.0, max(-1.0, 0.6 * error - 0.02 * truth.column_rate_radps))
        car.actuate_steering(
            now_ns, SteeringActuator(motor_duty_ratio=duty, motor_enabled=not coast)
        )
        car.actuate_throttle(
            now_ns, ThrottleActuator(throttle_dac_code=code, regen_dac_code=regen_code)
        )
        car.actuate_brake(now_ns, BrakeActuator(servo_position_ratio=brake, servo_powered=True))
    car.advance(begin_ns + round(duration_s * 1e9))


@pytest.fixture
def make_car() -> Callable[..., Car]:
    """`make_car(params=, seed=, automatic=, start_pose=)`: a parked car."""
    return build


@pytest.fixture
def car() -> Car:
    """A parked TABBY EVO in automatic."""
    return build()


@pytest.fixture
def drive() -> Callable[..., None]:
    """`drive(car, duration_s, duty=, throttle=, regen=, brake=, hold_angle_rad=, coast=)`."""
    return feed
