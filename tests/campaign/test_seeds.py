"""Whole seeds: nothing breaks, the same seed is the same world, and a planted bug is caught."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import pytest

from campaign.failure import failures_of
from campaign.run import faults_of, run_seed
from campaign.settings import CampaignSettings
from ecus.common.actuator_ecu import ActuatorEcu
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault

pytestmark = pytest.mark.whole_car

SETTINGS = CampaignSettings()
SHORT = replace(SETTINGS, seed_s=20.0)
SEEDS = range(10)
FOUND = (17, 19, 760, 1005, 1014)
"""Seeds that once broke something; docs/campaign.md says what."""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*SEEDS, *FOUND])
def test_a_seed_breaks_nothing_and_is_the_same_when_run_again(seed: int) -> None:
    result = run_seed(SETTINGS, seed)
    assert failures_of(result) == (), f"dbw campaign --replay {seed}\n{result.violations}"
    assert run_seed(SETTINGS, seed) == result


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "seed"),
    [("fsae_electric", 0), ("fsae_electric", 1), ("baja_5b", 100), ("baja_5b", 102)],
)
def test_no_other_car_breaks_anything_either(vehicle: str, seed: int) -> None:
    settings = replace(SETTINGS, vehicle=vehicle)
    result = run_seed(settings, seed)
    assert failures_of(result) == (), f"--vehicle {vehicle} --replay {seed}\n{result.violations}"
    assert result.injections and result.engaged_s > 0.5 * settings.seed_s


def test_a_seed_does_not_depend_on_the_order_of_hashes() -> None:
    call = (
        "from campaign.run import *; "
        "print(run_seed(CampaignSettings(seed_s=20.0), 2).trace_sha256)"
    )
    traces = {
        subprocess.run(
            [sys.executable, "-c", call], env=os.environ | {"PYTHONHASHSEED": seed}, check=True,
            capture_output=True, text=True,
        ).stdout
        for seed in ("0", "1", "4711")
    }
    assert len(traces) == 1


def test_a_seed_is_another_world_than_the_next() -> None:
    assert run_seed(SHORT, 0).trace_sha256 != run_seed(SHORT, 1).trace_sha256
    assert faults_of(SETTINGS, 0) != faults_of(SETTINGS, 1)


def test_a_seed_without_faults_drives_all_the_time() -> None:
    result = run_seed(SHORT, 5, faults=[])
    assert failures_of(result) == () and result.injections == ()
    assert result.stops == 0 and result.engaged_s > 17.0
    assert result.calm_s == pytest.approx(result.engaged_s)


def test_faults_of_a_file_take_the_place_of_storms() -> None:
    text = '[[fault]]\nkind = "crash"\ntarget = "Steering"\nat_s = 8.0\nfor_s = 0.5\n'
    result = run_seed(replace(SHORT, faults_text=text), 1)
    (injection,) = result.injections
    assert (injection.kind, injection.target) == ("crash", "Steering")
    assert injection.is_due and injection.is_clean and not injection.is_missed
    assert injection.latency_ms is not None and 50.0 < injection.latency_ms < 75.0
    assert injection.is_detected and injection.code
    (repair_s,) = result.repairs_s
    assert 1.0 < repair_s < 6.0 and result.stops == 1
    assert failures_of(result) == ()


def test_ecus_that_no_longer_look_at_the_decisions_age_are_caught(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ActuatorEcu, "_check_peers", lambda self, now_ns: None)
    fault = Fault(kind=FaultKind.PLANNER_FROZEN, at_s=8.0, for_s=3.0)
    broken = failures_of(run_seed(SHORT, 1, faults=[fault]))
    assert "hazard answered in time" in broken and "planner_frozen missed" in broken


def test_a_car_that_does_not_come_back_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("campaign.pilot.FOOT_RATIO", 0.0)  # in MANUAL the car rolls on and on
    fault = Fault(kind=FaultKind.DRIVER_GRABS, target="throttle", at_s=8.0, for_s=0.5, value=1.0)
    settings = replace(SETTINGS, seed_s=25.0)
    assert failures_of(run_seed(settings, 1, faults=[fault])) == (
        "drives again after the faults",
    )
