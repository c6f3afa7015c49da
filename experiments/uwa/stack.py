"""This stack in UWA's car, its steering told in UWA's byte commands."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from dbw.calibrate import HEADING_DEG, simulated_roll
from experiments.uah.stack import Stack
from experiments.uwa.paper_board import column_rad
from simulation.plant.derived import plant_of
from simulation.plant.params import PlantParams
from telemetry.databases import load_databases
from telemetry.decode.tables import Decoder
from telemetry.steering_zero import ANGLE, SPEED, check_usable, roll_of, zero_of
from vehicles import Vehicle, load_vehicle

VEHICLE: Final[Vehicle] = load_vehicle("fsae_electric")
PLANT: Final[PlantParams] = plant_of(VEHICLE)
"""For both controllers."""


def calibrated(seed: int) -> Vehicle:
    """UWA's car after `dbw calibrate`: a driver has rolled it along a straight line once."""
    databases = load_databases(())
    decoder = Decoder(databases, [databases.named(name) for name, _ in (ANGLE, SPEED)])
    decoded, _ = simulated_roll(VEHICLE, seed, decoder)
    zero = zero_of(roll_of(decoded, VEHICLE), VEHICLE, math.radians(HEADING_DEG))
    check_usable(zero, VEHICLE)
    return replace(VEHICLE, steering=replace(VEHICLE.steering, zero_rad=round(zero.zero_rad, 5)))


class UwaStack(Stack):
    """All nodes, the wire and UWA's car, engaged at standstill."""

    def __init__(self, seed: int, vehicle: Vehicle = VEHICLE) -> None:
        super().__init__(vehicle, PLANT, seed)

    def steer(self, steer: int, hold_s: float) -> None:
        """Asks for the angle of a byte command, and waits."""
        self.wheel_rad = column_rad(steer)
        self.run_for(hold_s)
