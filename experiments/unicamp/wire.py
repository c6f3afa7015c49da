"""The car's three drives on one bus, and who decides what they are told.

Who decides the targets is a driver: at its own period, with what it may know.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Protocol, Self

import numpy as np

from canbus import cia402
from canbus.cia402 import RPM_PER_RADPS
from canbus.drive_client import Setting
from experiments.chance import generator
from experiments.response import FloatArray
from experiments.unicamp.drive_bus import (
    DRIVE_PERIOD_NS,
    DRIVER_PRIORITY,
    LEFT,
    PLANT_PRIORITY,
    RIGHT,
    STEER,
    DriveBus,
)
from experiments.unicamp.plant import BAJA, STEERING_GEAR_RATIO, Baja, PlantParams
from gateway.curvature_control import YawReading
from simulation.drives.motor import COUNTS_PER_REV

SAMPLE_NS: Final = 20_000_000

UNITS_PER_ROAD_RAD: Final = COUNTS_PER_REV / math.tau * STEERING_GEAR_RATIO * BAJA.steering.ratio
"""Encoder units of the steering motor for an angle of the road wheel."""
RPM_PER_MPS: Final = BAJA.traction.gear_ratio / BAJA.geometry.wheel_radius_m * RPM_PER_RADPS
"""Of a rear wheel's motor, as the vehicle file has it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What a driver may know of the car."""

    now_ns: int
    left_mps: float
    right_mps: float
    """As the drives tell it."""
    yaw: YawReading | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """What the drives are to do: UNICAMP's CarCommand."""

    road_wheel_rad: float
    left_mps: float
    right_mps: float


class Driver(Protocol):
    """Who decides.

    Attributes:
        period_ns: of its decisions.
        speed_mps, curvature_per_m: what it is to drive.
    """

    period_ns: int
    speed_mps: float
    curvature_per_m: float

    def decide(self, known: Known) -> Targets:
        """The targets from now on."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """What happened, each of shape (N,): the truth, and what the paper plots."""

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    speed_mps: FloatArray
    yaw_rate_radps: FloatArray
    left_mps: FloatArray
    right_mps: FloatArray
    imu_radps: FloatArray
    wanted_left_mps: FloatArray
    wanted_right_mps: FloatArray
    steering_units: FloatArray
    """Position asked of the steering drive, encoder units."""

    def between(self, start_s: float, end_s: float) -> Self:
        """A part of it."""
        kept = (self.time_s > start_s + 1e-9) & (self.time_s <= end_s + 1e-9)
        return type(self)(**{name: getattr(self, name)[kept] for name in self.__slots__})

    def since(self, start_s: float) -> Self:
        """The same with times that count from there."""
        return replace(self, time_s=self.time_s - start_s)


class ThreeDrives(DriveBus):
    """The bus and everybody on it, enabled and standing.

    Args:
        params: The car.
        driver: Who decides.
        seed: Of the IMU's noise.
    """

    def __init__(self, params: PlantParams, driver: Driver, seed: int) -> None:
        self.driver = driver
        self.car = car = Baja(params, generator(seed, "imu"))
        shaft_rpm = STEERING_GEAR_RATIO * RPM_PER_RADPS
        turning = _settings(
            shaft_rpm * BAJA.steering.wheel_rate_radps_max,
            shaft_rpm * BAJA.steering.wheel_acceleration_radps2_max,
            shaft_rpm * BAJA.steering.wheel_acceleration_radps2_max,
        )
        rolling = _settings(
            RPM_PER_MPS * BAJA.traction.speed_mps_max,
            RPM_PER_MPS * BAJA.traction.acceleration_mps2_max,
            RPM_PER_MPS * BAJA.traction.deceleration_mps2_max,
        )
        super().__init__(
            {STEER: car.steering, LEFT: car.left, RIGHT: car.right},
            {STEER: turning, LEFT: rolling, RIGHT: rolling},
        )
        self.targets = Targets(road_wheel_rad=0.0, left_mps=0.0, right_mps=0.0)
        self._samples: list[tuple[float, ...]] = []
        self.every(DRIVE_PERIOD_NS, PLANT_PRIORITY, self._move)
        self.every(params.imu.period_ns, PLANT_PRIORITY, car.read_imu)
        self.start()
        self.every(driver.period_ns, DRIVER_PRIORITY, self._decide)
        self.every(SAMPLE_NS, DRIVER_PRIORITY, self._sample)

    @property
    def now_s(self) -> float:
        """Time since power-on."""
        return self.kernel.now_ns * 1e-9

    @property
    def heading_rad(self) -> float:
        """The car's."""
        return self.car.heading_rad

    @property
    def run(self) -> Run:
        """All samples so far."""
        return Run(**dict(zip(Run.__slots__, np.array(self._samples).T, strict=True)))

    def _move(self, _now_ns: int) -> None:
        self.car.advance(DRIVE_PERIOD_NS * 1e-9)

    def _decide(self, now_ns: int) -> None:
        known = Known(
            now_ns=now_ns,
            left_mps=self.clients[LEFT].velocity_rpm / RPM_PER_MPS,
            right_mps=self.clients[RIGHT].velocity_rpm / RPM_PER_MPS,
            yaw=self.car.gyroscope.shown(now_ns),
        )
        self.targets = targets = self.driver.decide(known)
        self.values = {
            STEER: round(targets.road_wheel_rad * UNITS_PER_ROAD_RAD),
            LEFT: round(targets.left_mps * RPM_PER_MPS),
            RIGHT: round(targets.right_mps * RPM_PER_MPS),
        }

    def _sample(self, now_ns: int) -> None:
        car, yaw = self.car, self.car.gyroscope.shown(now_ns)
        self._samples.append((
            now_ns * 1e-9, car.x_m, car.y_m, car.heading_rad, car.speed_mps, car.yaw_rate_radps,
            self.clients[LEFT].velocity_rpm / RPM_PER_MPS,
            self.clients[RIGHT].velocity_rpm / RPM_PER_MPS,
            math.nan if yaw is None else yaw.yaw_rate_radps,
            self.targets.left_mps, self.targets.right_mps, self.values[STEER],
        ))  # fmt: skip


def _settings(speed_rpm: float, up_rpmps: float, down_rpmps: float) -> tuple[Setting, ...]:
    """How fast a drive goes and changes, each object of four bytes."""
    values = {
        cia402.PROFILE_VELOCITY_MAX: speed_rpm,
        cia402.PROFILE_VELOCITY: speed_rpm,
        cia402.PROFILE_ACCELERATION: up_rpmps,
        cia402.PROFILE_DECELERATION: down_rpmps,
    }
    return tuple(
        Setting(key=key, value=round(value), byte_count=4) for key, value in values.items()
    )
