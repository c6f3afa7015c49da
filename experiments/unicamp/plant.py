"""UNICAMP's Baja 5B for its experiments: three motors, a worn linkage, two driven wheels, an IMU.

The paper prints no dimension of its car but the encoder's 4096 units, and of linkage and tyres
only that there is dead zone and hysteresis. Dimensions are those of `vehicles/baja_5b.toml`, motors
those of `simulation/drives/motor.py`; everything else is an assumption, stated beside its number. A
test pins them: no controller may get a kinder car.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Self

from numpy.random import Generator

from experiments.unicamp.gyroscope import Gyroscope, Imu
from simulation.drives.motor import EC45, RE50, Motor, MotorParams
from simulation.plant.linkage import Linkage
from simulation.plant.params import LinkageParams
from vehicles import load_vehicle
from vehicles.vehicle import Vehicle

BAJA: Final[Vehicle] = load_vehicle("baja_5b")
assert BAJA.drives is not None, "three drives"
STEERING_GEAR_RATIO: Final = BAJA.drives.steering_gear_ratio
"""Turns of the motor for one of its gear's shaft, which is the "wheel" of the vehicle file."""
GRAVITY_MPS2: Final = 9.81
SLIP_SPEED_MPS_MIN: Final = 0.1
"""Slip is a share of the speed, and below this one of this speed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tyres:
    """Linear tyres, by the load that they carry, and no further than friction goes."""

    rolling_ratio: float
    """Rolling radius to the vehicle file's wheel radius."""
    slip_stiffness_ratio: float
    """Drive force per slip, to the load."""
    cornering_stiffness_ratio: float
    """Side force per rad, to the load."""
    friction_ratio: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantParams:
    """A car."""

    name: str
    linkage: LinkageParams
    tyres: Tyres
    imu: Imu
    steering_motor: MotorParams
    wheel_motor: MotorParams
    mass_kg: float

    def with_load(self, load_kg: float) -> Self:
        """With more on it: half of it goes with each wheel's motor, as in RE50's own inertia."""
        wheel_m = BAJA.geometry.wheel_radius_m / BAJA.traction.gear_ratio
        inertia_kgm2 = self.wheel_motor.inertia_kgm2 + 0.5 * load_kg * wheel_m**2
        return replace(
            self, mass_kg=self.mass_kg + load_kg,
            wheel_motor=replace(self.wheel_motor, inertia_kgm2=inertia_kgm2),
        )  # fmt: skip


UNICAMP_PLANT: Final = PlantParams(
    name="unicamp",
    linkage=LinkageParams(
        transmission_ratio=1.0,
        play_rad=math.radians(1.0),  # assumption: servo saver and ball joints of a 1:5 car
        dead_zone_rad=math.radians(0.5),  # assumption
    ),
    tyres=Tyres(
        rolling_ratio=0.995,  # assumption: a soft tyre's flattening
        slip_stiffness_ratio=3.0,  # assumption: pins on a smooth floor; a road tyre has 10 to 30
        cornering_stiffness_ratio=10.0,  # assumption, per rad
        friction_ratio=0.8,  # assumption: dry floor
    ),
    imu=Imu(
        period_ns=10_000_000,  # XSens MTi-G-700 at 100 Hz
        latency_ns=10_000_000,  # assumption: fusion and USB
        bias_radps=math.radians(0.2),  # MTi 100 series: 0.2 deg/s bias repeatability
        noise_radps=math.radians(0.1),  # 0.01 deg/s per root Hz over 100 Hz
        vibration_radps=0.01,  # assumption
    ),
    steering_motor=EC45,
    wheel_motor=RE50,
    mass_kg=BAJA.geometry.mass_kg,
)


class Baja:
    """The car: where it is, and what its motors, linkage and tyres do. The caller's drives turn the
    motors; then `advance`.

    Attributes:
        steering, left, right: motors, at rest and centred.
        gyroscope: the IMU's.
        x_m, y_m, heading_rad: of the rear axle's centre.
        speed_mps, yaw_rate_radps: of it; positive left.
        road_wheel_rad: angle of the imagined middle front wheel.
    """

    def __init__(self, params: PlantParams, rng: Generator) -> None:
        self.params = params
        self.steering = Motor(params.steering_motor)
        self.left, self.right = Motor(params.wheel_motor), Motor(params.wheel_motor)
        self.x_m = self.y_m = self.heading_rad = 0.0
        self.speed_mps = self.yaw_rate_radps = 0.0
        self.road_wheel_rad = 0.0
        self._linkage = Linkage(params.linkage)
        self.gyroscope = Gyroscope(params.imu, rng)

    def wheel_mps(self, motor: Motor) -> float:
        """What a rear wheel's tread does."""
        rolling_m = BAJA.geometry.wheel_radius_m * self.params.tyres.rolling_ratio
        return motor.speed_radps / BAJA.traction.gear_ratio * rolling_m

    def advance(self, dt_s: float) -> None:
        """Moves the car by what its motors have turned."""
        self._steer()
        self._roll(dt_s)

    def read_imu(self, now_ns: int) -> None:
        """The gyroscope takes a reading."""
        self.gyroscope.read(now_ns, self.yaw_rate_radps, self.speed_mps)

    def _steer(self) -> None:
        shaft_rad = self.steering.angle_rad / STEERING_GEAR_RATIO
        self.road_wheel_rad = self._linkage.follow(shaft_rad / BAJA.steering.ratio)

    def _roll(self, dt_s: float) -> None:
        """Tyres in balance at every instant: at walking speed they settle within milliseconds.

        Rear wheels slip lengthwise by what the differential leaves, front wheels sideways by `slip`
        (m/s), which both axles' side forces and the rear wheels' drive forces balance.
        """
        tyres, base_m, track_m = self.params.tyres, BAJA.geometry.wheelbase_m, BAJA.geometry.track_m
        sin, cos = math.sin(self.road_wheel_rad), math.cos(self.road_wheel_rad)
        left, right = self.wheel_mps(self.left), self.wheel_mps(self.right)
        mean, turning = 0.5 * (left + right), (right - left) / track_m
        # an axle's cornering stiffness to a wheel's slip stiffness: an axle bears two wheels' load
        softness = 2.0 * tyres.cornering_stiffness_ratio / tyres.slip_stiffness_ratio
        lever = 2.0 * base_m * cos * softness / track_m**2
        slip = (base_m * cos * turning - sin * mean) / (
            1.0 + 0.5 * softness * sin**2 + cos**2 + base_m * cos * lever
        )
        self.speed_mps = mean + 0.5 * softness * sin * slip
        sideways = -cos * slip
        before, self.yaw_rate_radps = self.yaw_rate_radps, turning - lever * slip
        half_m = 0.5 * track_m * self.yaw_rate_radps
        self._load(self.left, left - (self.speed_mps - half_m))
        self._load(self.right, right - (self.speed_mps + half_m))
        heading = self.heading_rad + 0.5 * dt_s * 0.5 * (before + self.yaw_rate_radps)
        self.heading_rad += dt_s * 0.5 * (before + self.yaw_rate_radps)
        self.x_m += dt_s * (self.speed_mps * math.cos(heading) - sideways * math.sin(heading))
        self.y_m += dt_s * (self.speed_mps * math.sin(heading) + sideways * math.cos(heading))

    def _load(self, motor: Motor, slip_mps: float) -> None:
        """The drive force of a wheel acts on its motor."""
        tyres, geometry = self.params.tyres, BAJA.geometry
        bears_n = 0.25 * self.params.mass_kg * GRAVITY_MPS2
        share = slip_mps / max(abs(self.speed_mps), SLIP_SPEED_MPS_MIN)
        bound = tyres.friction_ratio
        force_n = bears_n * min(max(tyres.slip_stiffness_ratio * share, -bound), bound)
        motor.load_torque_nm = -force_n * geometry.wheel_radius_m / BAJA.traction.gear_ratio
