"""What all seeds of a campaign have in common."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache

from simulation.fault_kinds import targets_of
from simulation.faults import FaultPlan, parse_faults
from vehicles import DEFAULT, Vehicle, load_vehicle, parse_vehicle

SEED_S = 120.0
"""Virtual time of one seed: some ten storms."""
S_PER_H = 3600.0


@cache
def _car(name: str, text: str) -> Vehicle:
    return parse_vehicle(text, name) if text else load_vehicle(name)


@cache
def _plan(text: str, name: str, vehicle: Vehicle) -> FaultPlan:
    return parse_faults(text, name, targets_of(vehicle))


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignSettings:
    """Plain data, so that it can be sent to workers; what it stands for each of them reads itself.

    Attributes:
        vehicle: Name of a shipped vehicle, or what the user's own file is called in errors.
        vehicle_text: The user's own vehicle file; empty: the shipped one of that name.
        seed_s: Virtual time of each seed.
        faults_text: A file of faults (`simulation.faults`); None: each seed draws its own swarm.
        faults_name: What that file is called in errors.
    """

    vehicle: str = DEFAULT
    vehicle_text: str = ""
    seed_s: float = SEED_S
    faults_text: str | None = None
    faults_name: str = "faults"

    @property
    def car(self) -> Vehicle:
        """What the nodes believe.

        Raises:
            VehicleError: the vehicle is not known, or its file cannot be used.
        """
        return _car(self.vehicle, self.vehicle_text)

    @property
    def faults(self) -> FaultPlan | None:
        """The file's plan; None for swarms.

        Raises:
            FaultError: the file cannot be used for this car: file, line and reason.
        """
        if self.faults_text is None:
            return None
        return _plan(self.faults_text, self.faults_name, self.car)

    def check(self) -> None:
        """Reads what there is to read.

        Raises:
            VehicleError: as `car`.
            FaultError: as `faults`.
        """
        _ = self.car, self.faults

    @property
    def sha256(self) -> str:
        """Of everything that makes a seed what it is."""
        car, faults = self.vehicle_text or self.vehicle, self.faults_text or ""
        parts = (car, repr(self.seed_s), faults)
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()

    def seeds(self, hours: float, first: int) -> range:
        """The seeds that make up so many hours.

        Raises:
            ValueError: hours or seed are out of range.
        """
        if not 0.0 < hours <= 1e6:
            raise ValueError(f"hours {hours:g}: allowed is above 0 up to 1000000")
        if not 0 <= first < 2**63:
            raise ValueError(f"seed {first}: allowed is 0 to 2**63 - 1")
        return range(first, first + -(-round(hours * S_PER_H) // round(self.seed_s)))
