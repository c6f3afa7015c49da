"""The fault matrix: its cases, its columns, its cells."""

from __future__ import annotations

from dataclasses import replace

import pytest

from campaign.futures import SEEDS, cases
from campaign.matrix import ALL, COLUMNS, cell, column, matrix
from campaign.result import Demand, InjectionResult
from simulation.fault_kinds import KINDS, TARGETS, Strikes
from simulation.faults import Fault
from tests.campaign.fakes import result_of

ITEM = InjectionResult(
    kind="crash", target="Steering", at_s=8.0, for_s=2.0, value=0.0, share=1.0,
    demand=Demand.BRAKE, budget_ms=100.0, is_clean=True, is_due=True, latency_ms=61.2,
    code="ER2 NODE_SILENT", is_detected=True, is_missed=False,
)


def test_every_kind_with_every_target_is_a_case_and_has_a_column() -> None:
    every = [fault for _, faults in cases() for fault in faults]
    assert len(every) == sum(len(TARGETS[spec.strikes]) for spec in KINDS.values())
    assert {column(fault) for fault in every} == set(COLUMNS)
    assert column(Fault(kind=every[0].kind, target="STEER_STATUS")) == "Steering"
    assert ALL not in {column(fault) for fault in every if fault.target}


def test_faults_of_drives_strike_the_car_that_has_some() -> None:
    cars = dict(cases())
    assert {KINDS[fault.kind].strikes for fault in cars["baja_5b"]} == {Strikes.DRIVE}
    assert Strikes.DRIVE not in {KINDS[fault.kind].strikes for fault in cars["tabby_evo"]}
    assert [column(fault) for fault in cars["baja_5b"][:3]] == ["Steering", "Throttle", "Throttle"]


def test_a_cell_tells_the_worst_time_before_the_time_allowed() -> None:
    assert cell([]) == ""
    assert cell([ITEM] * len(SEEDS)) == "brakes, 62/100 ms: ER2 NODE_SILENT"
    slower = replace(ITEM, latency_ms=70.0)
    assert cell([ITEM, slower]) == "brakes, 70/100 ms: ER2 NODE_SILENT"


def test_a_cell_tells_how_many_did_what() -> None:
    calm = replace(ITEM, demand=Demand.ANY, is_due=False, latency_ms=None, code="ER0")
    hands = replace(ITEM, demand=Demand.HANDOVER, latency_ms=52.0, code="")
    assert cell([calm, calm]) == "goes on, says ER0"
    assert cell([ITEM, replace(calm, code="")]) == (
        "1 of 2 brakes, 62/100 ms: ER2 NODE_SILENT; 1 of 2 goes on"
    )
    assert cell([hands]) == "MANUAL, 52/100 ms"


def test_a_matrix_with_a_missed_fault_is_not_written() -> None:
    missed = replace(result_of(0), injections=(replace(ITEM, is_missed=True),))
    with pytest.raises(AssertionError):
        matrix([missed])
