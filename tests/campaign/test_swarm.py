"""What seeds draw: faults that can be, storms with calm between, most kinds left out."""

from __future__ import annotations

import numpy as np
import pytest

from campaign.expectation import RECOVERY_S
from campaign.run import faults_of
from campaign.settings import CampaignSettings
from campaign.swarm import CALM_S, FIRST_S, VALUE_MAX, storms
from simulation.fault_kinds import KINDS, FaultKind, Strikes, targets_of
from vehicles import load_vehicle

SEEDS = range(400)
SETTINGS = CampaignSettings()
DRAWN = {seed: faults_of(SETTINGS, seed) for seed in SEEDS}
KINDS_OF_DRIVES = {kind for kind, spec in KINDS.items() if spec.strikes is Strikes.DRIVE}


@pytest.mark.parametrize("vehicle", ["tabby_evo", "baja_5b"])
def test_every_kind_and_every_target_that_a_car_has_comes_in_some_seed(vehicle: str) -> None:
    settings = CampaignSettings(vehicle=vehicle)
    drawn = {
        (fault.kind, fault.target) for seed in SEEDS for fault in faults_of(settings, seed)
    }
    targets = targets_of(settings.car)
    wanted = {(kind, target) for kind, names in targets.items() for target in names}
    assert {kind for kind, _ in drawn} == set(targets)
    assert drawn <= wanted and len(wanted - drawn) < 0.1 * len(wanted)


def test_only_a_car_with_drives_has_their_faults() -> None:
    assert len(KINDS_OF_DRIVES) == 4
    assert set(targets_of(load_vehicle("baja_5b"))) == set(FaultKind)
    assert set(targets_of(load_vehicle("tabby_evo"))) == set(FaultKind) - KINDS_OF_DRIVES


def test_some_seeds_have_no_fault_and_each_leaves_most_kinds_out() -> None:
    calm = sum(not faults for faults in DRAWN.values())
    assert 0.05 * len(SEEDS) < calm < 0.2 * len(SEEDS)
    kinds = [len({fault.kind for fault in faults}) for faults in DRAWN.values() if faults]
    assert np.median(kinds) < 0.4 * len(FaultKind)


def test_between_storms_there_is_time_to_recover() -> None:
    assert CALM_S > RECOVERY_S
    for faults in DRAWN.values():
        times_s = [fault.at_s for fault in faults]
        gaps_s = np.diff(times_s)
        assert not times_s or times_s[0] >= FIRST_S
        assert all(gap_s <= 2.0 or gap_s > CALM_S - 2.0 for gap_s in gaps_s)


def test_a_seed_without_room_for_a_storm_has_none() -> None:
    assert storms(FIRST_S + CALM_S, np.random.default_rng(0), targets_of(SETTINGS.car)) == []


def test_what_is_set_off_ends_with_its_storm() -> None:
    for faults in DRAWN.values():
        for fault in faults:
            assert fault.value <= VALUE_MAX.get(fault.kind, KINDS[fault.kind].high)
