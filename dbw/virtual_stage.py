"""A drive in virtual time: all nodes, the wire and the car in the deterministic simulation."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Self

from dbw.plan import DrivePlan
from gateway.api import Car
from planner.gnss import GnssFix, GnssReceiver
from simulation.link import SimulationLink
from simulation.plant.params import PlantParams
from simulation.plant.state import Pose
from simulation.world import World
from telemetry.bus_log import BusLog
from telemetry.recording import DriveRecorder

BUTTON_S: Final = 0.15
"""How long the button is held."""


class VirtualStage:
    """Implements `dbw.stage.Stage` in a `World` of its own.

    Args:
        plan: Its line's start is where the car stands.
        seed: Of everything that is left to chance.
        plant: The truth; by default that of the vehicle's name.
    """

    def __init__(self, plan: DrivePlan, seed: int, plant: PlantParams | None = None) -> None:
        start = plan.line.start
        self.world = World(
            plan.vehicle,
            seed,
            planner_period_ns=plan.planner_period_ns,
            start_pose=Pose(x_m=start.x_m, y_m=start.y_m, heading_rad=start.heading_rad),
            plant=plant,
            keep_frames=False,
        )
        self.log = BusLog()
        self.world.wire.witnesses.append(self.log)
        self.recorder = DriveRecorder()
        self._link = SimulationLink(self.world)
        self.car = Car(self._link)
        self._receiver = GnssReceiver(self.world.planner_rng)

    def __enter__(self) -> Self:
        """Connects the planner."""
        self.car.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        """Lets go of the car without a stop: the world ends here."""
        self.car.close()

    @property
    def trace_sha256(self) -> str:
        """The world's own hash of all frames."""
        return self.world.trace.sha256

    def press_button(self) -> None:
        """The person in the car presses Auto/Manual and lets go."""
        driver = self.world.car.driver
        driver.button_pressed = True
        self.world.run_for(BUTTON_S)
        driver.button_pressed = False
        self.world.run_for(BUTTON_S)

    def observe(self) -> Iterable[GnssFix]:
        """Notes the truth, and answers the fixes that have arrived."""
        truth = self.world.car.truth
        now_ns = self._link.now_ns()
        self.recorder.add_truth(now_ns, truth.pose.x_m, truth.pose.y_m, truth.speed_mps)
        return self._receiver.step(now_ns, truth.pose.x_m, truth.pose.y_m)

    def check(self) -> None:
        """Nothing can die here."""
