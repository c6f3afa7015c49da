"""This stack in UWA's car, its steering told in UWA's byte commands."""

from __future__ import annotations

from typing import Final

from experiments.uah.stack import Stack
from experiments.uwa.paper_board import column_rad
from simulation.plant.derived import plant_of
from simulation.plant.params import PlantParams
from vehicles import Vehicle, load_vehicle

VEHICLE: Final[Vehicle] = load_vehicle("fsae_electric")
PLANT: Final[PlantParams] = plant_of(VEHICLE)
"""For both controllers."""


class UwaStack(Stack):
    """All nodes, the wire and UWA's car, engaged at standstill."""

    def __init__(self, seed: int) -> None:
        super().__init__(VEHICLE, PLANT, seed)

    def steer(self, steer: int, hold_s: float) -> None:
        """Asks for the angle of a byte command, and waits."""
        self.wheel_rad = column_rad(steer)
        self.run_for(hold_s)
