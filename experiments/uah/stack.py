"""The stack with a planner that asks for one speed and one angle of the steering wheel."""

from __future__ import annotations

from experiments.engaged import Engaged
from experiments.uah.paper_board import Run, Sample, sample
from gateway.commands import Decision
from gateway.kinematics import Kinematics
from simulation.plant.params import PlantParams
from simulation.plant.state import Truth
from vehicles import Vehicle


class Stack(Engaged):
    """All nodes, the wire and the car, engaged at standstill.

    Args:
        vehicle: What the nodes believe.
        plant: What the car is.
        seed: Of everything left to chance.

    Attributes:
        speed_mps: What the planner asks for.
        wheel_rad: The steering wheel's angle that it asks for, as a curvature.
    """

    def __init__(self, vehicle: Vehicle, plant: PlantParams, seed: int) -> None:
        self.speed_mps = 0.0
        self.wheel_rad = 0.0
        self._kinematics = Kinematics.of(vehicle.geometry, vehicle.steering)
        self._samples: list[Sample] = []
        super().__init__(vehicle, plant, seed)

    @property
    def run(self) -> Run:
        """All that happened so far."""
        return Run.of(self._samples)

    def decide(self) -> Decision:
        """Speed and angle as they are."""
        curvature_per_m = self._kinematics.curvature_per_m(self.wheel_rad)
        return Decision(speed_mps=self.speed_mps, curvature_per_m=curvature_per_m)

    def note(self, truth: Truth) -> None:
        """A sample."""
        self._samples.append(sample(truth))
