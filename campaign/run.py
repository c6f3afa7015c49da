"""One seed from power-on to the verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from campaign.result import SeedResult
from campaign.settings import CampaignSettings
from simulation.faults import Fault
from simulation.world import World


def run_seed(
    settings: CampaignSettings,
    seed: int,
    *,
    faults: Sequence[Fault] | None = None,
    watch: Callable[[World], None] | None = None,
) -> SeedResult:
    """Runs one seed.

    Args:
        settings: Of the campaign.
        seed: Of everything that is left to chance: the world, the route, the faults.
        faults: In place of those that the seed draws (`faults_of`), all else being equal.
        watch: Given the world before it begins, to attach a recorder.
    """
    raise NotImplementedError


def faults_of(settings: CampaignSettings, seed: int) -> list[Fault]:
    """The faults that a seed draws, with their times, in order."""
    raise NotImplementedError
