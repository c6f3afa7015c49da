"""The gains of our two loops for UAH's steps: `python -m experiments.uah.tuning` finds them again.

The ECUs' own loops run on the plant without bus and supervisor, every 10 ms, over a grid of gains.
Each candidate meets the same corners: two and four people, a fifth more and less of the motor's
torque and of the friction, a slope to either side, and for the steering a standing car. Of those
that keep the paper's overshoot in every corner, and a quarter of its steady-state error in the
steering and all of it in the speed, the one is taken that settles first on average.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from statistics import fmean
from typing import Final

from canbus.node import PERIOD_NS
from ecus.brake_servo.ports import BrakeActuator
from ecus.common.encoder import EncoderSpeed
from ecus.steering.control import SteeringLoop
from ecus.steering.params import SteeringParams
from ecus.steering.ports import SteeringActuator
from ecus.supervisor.ports import SupervisorActuator
from ecus.throttle.control import SpeedLoop
from ecus.throttle.params import ThrottleParams
from experiments.chance import generator
from experiments.response import StepFigures
from experiments.uah.baseline import PAPER_SPEED, PAPER_STEERING
from experiments.uah.paper_board import Run, Sample, sample
from experiments.uah.plant import (
    SPEED_BAND,
    SPEED_STEP_MPS,
    STEERING_BAND,
    UAH_PAPER,
    VEHICLE,
    WHEEL_STEP_RAD,
)
from simulation.plant.car import Car
from simulation.plant.params import PlantParams
from vehicles import Vehicle

PERIOD_S: Final = PERIOD_NS * 1e-9
STEERING_LIMITS: Final = replace(PAPER_STEERING, steady_error=0.25 * PAPER_STEERING.steady_error)
SPEED_LIMITS: Final = PAPER_SPEED[2]
"""What a candidate keeps in its worst corner: overshoot and steady-state error of these."""
SEED: Final = 0
BEFORE_S: Final = 4.0
"""In which the car comes to its speed before the wheel is turned."""
STEERING_S: Final = 3.0
SPEED_S: Final = 10.0
PATH: Final = Path("out") / "tuning.json"

Gains = dict[str, float]
"""By field of the vehicle file."""
Grid = dict[str, tuple[float, ...]]

# within the ranges of vehicle files: 50 1/s2 is the largest integral gain of the steering
STEERING_GRID: Final[Grid] = {
    "position_gain_per_s": (9.0, 16.0, 20.0, 24.0),
    "rate_gain": (0.6, 1.5, 2.0, 2.5),
    "integral_gain_per_s2": (15.0, 30.0, 50.0),
}
SPEED_GRID: Final[Grid] = {
    "speed_gain_per_s": (2.5, 3.0, 4.0, 5.0),
    "integral_gain_per_s2": (0.1, 0.2, 0.4, 0.8),
    "drive_lag_s": (0.30, 0.35, 0.40, 0.45),
}

TUNED_STEERING: Final[Gains] = {name: getattr(VEHICLE.steering, name) for name in STEERING_GRID}
TUNED_SPEED: Final[Gains] = {name: getattr(VEHICLE.traction, name) for name in SPEED_GRID}
"""The vehicle file's; a test asks their neighbours again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Corner:
    """A car that is not quite the one believed in."""

    name: str
    plant: PlantParams
    is_of_steering: bool = True
    """Whether it makes a difference to the steering, and the speed."""
    is_of_speed: bool = True


def corners(plant: PlantParams) -> tuple[Corner, ...]:
    """Load, slope, friction and 20 % of error in motor and inertia, one at a time."""
    steering, traction, chassis = plant.steering, plant.traction, plant.chassis

    def column(name: str, factor: float) -> PlantParams:
        changed = {name: factor * getattr(steering, name)}
        return replace(plant, steering=replace(steering, **changed))

    def drive(factor: float) -> PlantParams:
        torque_nm = factor * traction.motor_torque_nm_max
        return replace(plant, traction=replace(traction, motor_torque_nm_max=torque_nm))

    def slope(ratio: float) -> PlantParams:
        return replace(plant, chassis=replace(chassis, slope_rad=math.atan(ratio)))

    return (
        Corner(name="two people", plant=plant),
        Corner(name="four people", plant=plant.with_occupants(4)),
        Corner(name="steering motor 20 % weaker", is_of_speed=False,
               plant=column("motor_stall_torque_nm", 0.8)),
        Corner(name="steering motor 20 % stronger", is_of_speed=False,
               plant=column("motor_stall_torque_nm", 1.2)),
        Corner(name="column 20 % heavier", is_of_speed=False,
               plant=column("column_inertia_kgm2", 1.2)),
        Corner(name="column's friction 50 % more", is_of_speed=False,
               plant=column("coulomb_torque_nm", 1.5)),
        Corner(name="column's friction 50 % less", is_of_speed=False,
               plant=column("coulomb_torque_nm", 0.5)),
        Corner(name="drive motor 20 % weaker", is_of_steering=False, plant=drive(0.8)),
        Corner(name="drive motor 20 % stronger", is_of_steering=False, plant=drive(1.2)),
        Corner(name="4 % uphill", is_of_steering=False, plant=slope(0.04)),
        Corner(name="4 % downhill", is_of_steering=False, plant=slope(-0.04)),
        Corner(name="wet road, friction 0.4",
               plant=replace(plant, chassis=replace(chassis, friction_mu=0.4))),
    )  # fmt: skip


class BareLoops:
    """Both loops on a car, without anything between."""

    def __init__(self, vehicle: Vehicle, plant: PlantParams) -> None:
        self._car = Car(plant, generator(SEED))
        self._car.actuate_supervisor(0, SupervisorActuator(automatic_relay_closed=True))
        self._steering, self._speed = SteeringLoop(), SpeedLoop()
        self._steering_params = SteeringParams.of(vehicle)
        self._speed_params = ThrottleParams.of(vehicle)
        self._encoder = EncoderSpeed(self._speed_params.encoder_pulses_per_rev)
        self._now_ns = 0
        self._samples: list[Sample] = []

    def run_for(self, span_s: float, speed_mps: float, wheel_rad: float) -> None:
        """Drives on with these setpoints."""
        car = self._car
        for _ in range(round(span_s / PERIOD_S)):
            now_ns = self._now_ns
            self._steering.measure(car.sense_steering(now_ns).column_angle_rad, PERIOD_S)
            duty = self._steering.update(wheel_rad, PERIOD_S, self._steering_params)
            car.actuate_steering(
                now_ns, SteeringActuator(motor_duty_ratio=duty, motor_enabled=True)
            )
            read = car.sense_throttle(now_ns)
            motor_radps = self._encoder.update(now_ns, read.encoder_count, read.encoder_edge_age_s)
            params = self._speed_params
            measured_mps = motor_radps / params.gear_ratio * params.wheel_radius_m
            car.actuate_throttle(now_ns, self._speed.update(
                speed_mps, measured_mps, PERIOD_S, params, is_servo_braking=False))
            car.actuate_brake(now_ns, BrakeActuator(servo_position_ratio=0.0, servo_powered=False))
            self._now_ns = now_ns + PERIOD_NS
            car.advance(self._now_ns)
            self._samples.append(sample(car.truth))

    @property
    def run(self) -> Run:
        """All that happened so far."""
        return Run.of(self._samples)


def steering_figures(vehicle: Vehicle, plant: PlantParams, *, is_rolling: bool) -> StepFigures:
    """A step of the steering wheel, degrees."""
    loops = BareLoops(vehicle, plant)
    speed_mps = SPEED_STEP_MPS if is_rolling else 0.0
    loops.run_for(BEFORE_S, speed_mps, 0.0)
    loops.run_for(STEERING_S, speed_mps, WHEEL_STEP_RAD)
    return loops.run.steering(BEFORE_S, WHEEL_STEP_RAD, STEERING_BAND)


def speed_figures(vehicle: Vehicle, plant: PlantParams) -> StepFigures:
    """A step of the speed from standstill, m/s."""
    loops = BareLoops(vehicle, plant)
    loops.run_for(1.0, 0.0, 0.0)
    loops.run_for(SPEED_S, SPEED_STEP_MPS, 0.0)
    return loops.run.speed(1.0, SPEED_STEP_MPS, SPEED_BAND)


def judged_steering(gains: Gains) -> StepFigures:
    """A candidate in every corner, rolling and standing."""
    vehicle = with_steering(VEHICLE, gains)
    return together(
        steering_figures(vehicle, corner.plant, is_rolling=is_rolling)
        for corner in corners(UAH_PAPER)
        if corner.is_of_steering
        for is_rolling in (True, False)
    )


def judged_speed(gains: Gains) -> StepFigures:
    """A candidate in every corner."""
    vehicle = replace(VEHICLE, traction=replace(VEHICLE.traction, **gains))
    return together(
        speed_figures(vehicle, corner.plant)
        for corner in corners(UAH_PAPER)
        if corner.is_of_speed
    )


def with_steering(vehicle: Vehicle, gains: Gains) -> Vehicle:
    """A vehicle with other gains of its steering loop."""
    return replace(vehicle, steering=replace(vehicle.steering, **gains))


def worst(figures: Iterable[StepFigures]) -> StepFigures:
    """The worst of each figure, whichever corner it is from."""
    listed = list(figures)
    return StepFigures(
        **{field.name: max(getattr(one, field.name) for one in listed)
           for field in fields(StepFigures)}
    )  # fmt: skip


def together(figures: Iterable[StepFigures]) -> StepFigures:
    """What a candidate is judged by: its mean settling time, and the worst of all else."""
    listed = list(figures)
    return replace(worst(listed), settling_s=fmean(one.settling_s for one in listed))


def candidates(grid: Grid, around: Gains | None = None) -> Iterator[Gains]:
    """All of a grid, or a point of it and its neighbours along each axis."""
    if around is None:
        for values in itertools.product(*grid.values()):
            yield dict(zip(grid, values, strict=True))
        return
    yield around
    for name, values in grid.items():
        place = values.index(around[name])
        for other in (place - 1, place + 1):
            if 0 <= other < len(values):
                yield {**around, name: values[other]}


def best(found: Iterable[tuple[Gains, StepFigures]], limits: StepFigures) -> Gains:
    """The gains that settle first, of those within the limits."""
    allowed = [
        pair
        for pair in found
        if pair[1].overshoot_percent <= limits.overshoot_percent
        and pair[1].steady_error <= limits.steady_error
    ]
    return min(allowed, key=lambda pair: pair[1].settling_s)[0]


def main() -> int:
    """Goes over both grids and writes what it found to `out/tuning.json`."""
    found = {}
    for name, grid, judge, limits in (
        ("steering", STEERING_GRID, judged_steering, STEERING_LIMITS),
        ("speed", SPEED_GRID, judged_speed, SPEED_LIMITS),
    ):
        judged = [(gains, judge(gains)) for gains in candidates(grid)]
        found[name] = {
            "best": best(judged, limits),
            "candidates": [{**gains, **asdict(figures)} for gains, figures in judged],
        }
    PATH.parent.mkdir(exist_ok=True)
    PATH.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
