"""What all seeds of a campaign have in common."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

from simulation.faults import FaultPlan, parse_faults

SEED_S = 120.0
"""Virtual time of one seed: some ten storms."""
S_PER_H = 3600.0


@dataclass(frozen=True, kw_only=True)
class CampaignSettings:
    """Plain data, so that it can be sent to workers.

    Attributes:
        vehicle: Name of a vehicle file.
        seed_s: Virtual time of each seed.
        faults_text: A file of faults (`simulation.faults`); empty: each seed draws its own swarm.
        faults_name: What that file is called in errors.
    """

    vehicle: str = "tabby_evo"
    seed_s: float = SEED_S
    faults_text: str = ""
    faults_name: str = "faults"

    @cached_property
    def faults(self) -> FaultPlan | None:
        """The file's plan; None for swarms.

        Raises:
            FaultError: the file cannot be used: file, line and reason.
        """
        return parse_faults(self.faults_text, self.faults_name) if self.faults_text else None

    @property
    def sha256(self) -> str:
        """Of everything that makes a seed what it is."""
        parts = (self.vehicle, repr(self.seed_s), self.faults_text)
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
