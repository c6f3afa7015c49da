"""The car's three drives on one simulated CAN bus, and the two nodes that command them.

The nodes tell their drives a target each by `canbus/drive_client.py` every 10 ms. Who decides the
targets is a driver: at its own period, with what it may know.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Protocol, Self

import numpy as np

from canbus import cia402
from canbus.canopen_protocol import HEARTBEAT_ID, NmtCommand, NmtState, nmt_frame
from canbus.cia402 import RPM_PER_RADPS, OperationMode
from canbus.drive_client import DriveClient, DriveWish, Setting
from canbus.frame import Frame, ReceivedFrame
from canbus.node import NODE_IDS, PERIOD_NS
from experiments.chance import generator
from experiments.response import FloatArray
from experiments.unicamp.plant import BAJA, STEERING_GEAR_RATIO, Baja, PlantParams
from gateway.curvature_control import YawReading
from simulation.drives.drive import EposDrive
from simulation.drives.motor import COUNTS_PER_REV
from simulation.kernel import Action, Kernel
from simulation.wire import Receiver, Wire

STEER, LEFT, RIGHT = 0x11, 0x12, 0x13
DRIVE_PERIOD_NS: Final = 5_000_000
"""The drives hear the bus so often; their loops go every millisecond of it."""
HEARTBEAT_NS: Final = 50_000_000
SAMPLE_NS: Final = 20_000_000
BOOT_S: Final = 0.3
ENABLE_S: Final = 0.2
NODE_PRIORITY, DRIVE_PRIORITY, PLANT_PRIORITY, DRIVER_PRIORITY = 1, 2, 3, 4
"""Of what happens at one instant: who decides comes last, so nothing is known before its time."""

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


class ThreeDrives:
    """The bus and everybody on it, enabled and standing.

    Args:
        params: The car.
        driver: Who decides.
        seed: Of the IMU's noise.
    """

    def __init__(self, params: PlantParams, driver: Driver, seed: int) -> None:
        self.driver = driver
        self.car = car = Baja(params, generator(seed, "imu"))
        self.kernel = Kernel()
        self.wire = Wire(self.kernel, round(BAJA.bus.bitrate_bps))
        self.drives = {
            STEER: EposDrive(STEER, car.steering),
            LEFT: EposDrive(LEFT, car.left),
            RIGHT: EposDrive(RIGHT, car.right),
        }
        steering, throttle = NODE_IDS["Steering"], NODE_IDS["Throttle"]
        position, velocity = OperationMode.PROFILE_POSITION, OperationMode.PROFILE_VELOCITY
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
        self.clients = {
            STEER: DriveClient(STEER, steering, position, turning),
            LEFT: DriveClient(LEFT, throttle, velocity, rolling),
            RIGHT: DriveClient(RIGHT, throttle, velocity, rolling),
        }
        self.targets = Targets(road_wheel_rad=0.0, left_mps=0.0, right_mps=0.0)
        self._values = dict.fromkeys(self.clients, 0)
        self._samples: list[tuple[float, ...]] = []
        for node_id, drive in self.drives.items():
            self._attach(f"drive {node_id:#x}", DRIVE_PERIOD_NS, DRIVE_PRIORITY, _drive_step(drive))
        self._attach("Steering", PERIOD_NS, NODE_PRIORITY, self._node_step(steering, (STEER,)))
        self._attach("Throttle", PERIOD_NS, NODE_PRIORITY, self._node_step(throttle, (LEFT, RIGHT)))
        self._every(DRIVE_PERIOD_NS, PLANT_PRIORITY, self._move)
        self._every(params.imu.period_ns, PLANT_PRIORITY, car.read_imu)
        self.run_for(BOOT_S)
        self.wire.send(self.kernel.now_ns, "Supervisor", [nmt_frame(NmtCommand.START, 0)])
        self.run_for(ENABLE_S)
        assert all(client.is_following for client in self.clients.values())
        self._every(driver.period_ns, DRIVER_PRIORITY, self._decide)
        self._every(SAMPLE_NS, DRIVER_PRIORITY, self._sample)

    @property
    def now_s(self) -> float:
        """Time since power-on."""
        return self.kernel.now_ns * 1e-9

    @property
    def heading_rad(self) -> float:
        """The car's."""
        return self.car.heading_rad

    def run_for(self, span_s: float) -> None:
        """Drives on."""
        self.kernel.run_until(self.kernel.now_ns + round(span_s * 1e9))

    @property
    def run(self) -> Run:
        """All samples so far."""
        return Run(**dict(zip(Run.__slots__, np.array(self._samples).T, strict=True)))

    def _every(self, period_ns: int, priority: int, action: Action) -> None:
        def cycle(now_ns: int) -> None:
            self.kernel.at(now_ns + period_ns, priority, cycle)
            action(now_ns)

        self.kernel.at(self.kernel.now_ns + period_ns, priority, cycle)

    def _attach(
        self,
        name: str,
        period_ns: int,
        priority: int,
        step: Callable[[int, list[ReceivedFrame]], list[Frame]],
    ) -> None:
        station = Receiver(name)
        self.wire.attach(station)

        def cycle(now_ns: int) -> None:
            heard, station.inbox = station.inbox, []
            received = [ReceivedFrame(time_ns, frame) for time_ns, frame in heard]
            self.wire.send(now_ns, name, step(now_ns, received))

        self._every(period_ns, priority, cycle)

    def _node_step(
        self, own_id: int, node_ids: tuple[int, ...]
    ) -> Callable[[int, list[ReceivedFrame]], list[Frame]]:
        def step(now_ns: int, received: list[ReceivedFrame]) -> list[Frame]:
            frames: list[Frame] = []
            for node_id in node_ids:
                client = self.clients[node_id]
                frames += client.step(now_ns, received, DriveWish.FOLLOW, self._values[node_id])
            if now_ns % HEARTBEAT_NS == 0:
                frames.append(Frame(HEARTBEAT_ID + own_id, bytes((NmtState.OPERATIONAL,))))
            return frames

        return step

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
        self._values = {
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
            self.targets.left_mps, self.targets.right_mps, self._values[STEER],
        ))  # fmt: skip


def _drive_step(drive: EposDrive) -> Callable[[int, list[ReceivedFrame]], list[Frame]]:
    return lambda now_ns, received: drive.step(now_ns, [item.frame for item in received])


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
