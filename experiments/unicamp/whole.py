"""The circles by all of baja_5b: gateway, ECUs, supervisor, monitor, and drives on their bus."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from experiments.chance import generator
from experiments.engaged import SAMPLE_NS, Engaged
from experiments.result import Outcome, Setting
from experiments.unicamp.circles import compare
from experiments.unicamp.drivers import KINEMATICS
from experiments.unicamp.gyroscope import Gyroscope
from experiments.unicamp.plant import BAJA, UNICAMP_PLANT
from experiments.unicamp.wire import SAMPLE_NS as ROW_NS
from experiments.unicamp.wire import UNITS_PER_ROAD_RAD, Driver, Known, Run, Targets
from gateway.commands import Decision
from simulation.plant.derived import plant_of
from simulation.plant.params import PlantParams
from simulation.plant.state import Truth

PLANT: Final[PlantParams] = replace(plant_of(BAJA), linkage=UNICAMP_PLANT.linkage)
"""The car of `dbw demo --vehicle baja_5b`, with the worn linkage of the other experiments."""

assert UNICAMP_PLANT.imu.period_ns == SAMPLE_NS, "a reading with each sample"


def decision_of(targets: Targets) -> Decision:
    """What a CarCommand asks for, within the vehicle file's range; the wheels are the ECU's."""
    wheel_rad = targets.road_wheel_rad * BAJA.steering.ratio
    bound = BAJA.curvature_per_m_max
    return Decision(
        speed_mps=0.5 * (targets.left_mps + targets.right_mps),
        curvature_per_m=min(max(KINEMATICS.curvature_per_m(wheel_rad), -bound), bound),
    )


class WholeCar(Engaged):
    """All nodes, three drives and the car, engaged at standstill; the planner is a driver.

    Args:
        driver: Who decides. He knows what the gateway hears, and the IMU beside it.
        seed: Of everything left to chance.
    """

    def __init__(self, driver: Driver, seed: int) -> None:
        self._driver = driver
        self._due_ns = 0
        self._decision = Decision(speed_mps=0.0, curvature_per_m=0.0)
        self._gyroscope = Gyroscope(UNICAMP_PLANT.imu, generator(seed, "imu"))
        self._rows: list[tuple[float, ...]] = []
        super().__init__(BAJA, PLANT, seed)

    @property
    def heading_rad(self) -> float:
        """The car's."""
        return self.world.car.pose.heading_rad

    @property
    def run(self) -> Run:
        """All samples so far, as of drives that are commanded directly."""
        return Run(**dict(zip(Run.__slots__, np.array(self._rows).T, strict=True)))

    def decide(self) -> Decision:
        """The driver's newest; he decides at his own period."""
        now_ns = self.world.now_ns
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + self._driver.period_ns
            speed_mps = self.link.state().speed_mps
            yaw = self._gyroscope.shown(now_ns)
            known = Known(now_ns=now_ns, left_mps=speed_mps, right_mps=speed_mps, yaw=yaw)
            self._decision = decision_of(self._driver.decide(known))
        return self._decision

    def note(self, truth: Truth) -> None:
        """The gyroscope reads, and now and then it is a sample."""
        now_ns, pose, decision = truth.time_ns, truth.pose, self._decision
        self._gyroscope.read(now_ns, truth.yaw_rate_radps, truth.speed_mps)
        if now_ns % ROW_NS:
            return
        shown = self._gyroscope.shown(now_ns)
        wanted = KINEMATICS.rear_wheel_speeds_mps(decision.speed_mps, decision.curvature_per_m)
        road_rad = KINEMATICS.road_wheel_angle_rad(decision.curvature_per_m)
        half_mps = 0.5 * BAJA.geometry.track_m * truth.yaw_rate_radps
        self._rows.append((
            now_ns * 1e-9, pose.x_m, pose.y_m, pose.heading_rad, truth.speed_mps,
            truth.yaw_rate_radps, truth.speed_mps - half_mps, truth.speed_mps + half_mps,
            math.nan if shown is None else shown.yaw_rate_radps,
            wanted.left_mps, wanted.right_mps, road_rad * UNITS_PER_ROAD_RAD,
        ))  # fmt: skip


def run(setting: Setting, file: Path) -> Outcome:
    """As the circles of drives that are commanded directly."""
    rows = compare("stack", lambda driver: WholeCar(driver, setting.seed), file)
    return Outcome(rows=rows, notes=_NOTES)


_NOTES = (
    "The same circles, controllers and gains, driven by the nodes of baja_5b on one bus: the "
    "driver's decision goes to the gateway, the steer ECU commands its drive in profile position "
    "and the throttle ECU both wheels' in profile velocity with the electronic differential; "
    "supervisor and safety monitor let it.",
    "The car is that of `dbw demo --vehicle baja_5b` with the linkage above: on wheels that roll "
    "without slip at this speed, on 1 % less than the radius of the vehicle file, with a steering "
    "sensor that is off. Gains were tuned in the other plant. The paper's controller asks for one "
    "speed of both wheels; here they get the differential's.",
)
