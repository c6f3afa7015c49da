"""The supervisor's pure decisions: why not engage, why not reset."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from dbc.messages import ErrorCode, Inhibit, Mode, NodeState, Verdict
from ecus.supervisor.control import Situation, engage_inhibit, inhibit, reset_inhibit

RADIUS_M = 0.287
GEAR = 5.8
DT_S = 0.01
MS = 1_000_000
NODES = ("Steering", "Throttle", "BrakeServo", "SafetyMonitor", "Gateway")





# The supervisor's decisions ------------------------------------------------------------------

WELL = Situation(
    mode=Mode.READY,
    alive=dict.fromkeys(NODES, True),
    heard=dict.fromkeys(NODES, True),
    operational=dict.fromkeys(NODES, True),
    configuration_equal=dict.fromkeys(NODES, True),
    node_states=dict.fromkeys(NODES[:3], NodeState.RELEASED),
    codes=frozenset(),
    blocking_codes=frozenset(),
    verdict=Verdict.PERMIT,
    is_driver_active=False,
    is_emergency_stop_pressed=False,
    has_foreign_frames=False,
    is_planner_period_allowed=True,
    speed_mps=0.0,
    is_standing=True,
    engage_speed_mps_max=7.5,
)


def test_nothing_in_the_way_leaves_only_the_request() -> None:
    assert engage_inhibit(WELL) is Inhibit.NOT_REQUESTED
    assert reset_inhibit(WELL) is Inhibit.NONE


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"verdict": None}, "VERDICT_MISSING"),
        ({"verdict": Verdict.DENY}, "VERDICT_DENY"),
        ({"verdict": Verdict.BRAKE}, "VERDICT_DENY"),
        ({"codes": frozenset({ErrorCode.ER0})}, "CODE_LATCHED"),
        ({"speed_mps": math.nan}, "TOO_FAST"),
        ({"speed_mps": 7.5001}, "TOO_FAST"),
        ({"node_states": {"Steering": NodeState.ACTIVE}}, "NODE_UNRELEASED"),
        ({"node_states": {}}, "NODE_UNRELEASED"),
        ({"mode": Mode.MANUAL}, "PRESS_BUTTON"),
        ({"mode": Mode.AUTOMATIC}, "PRESS_BUTTON"),
    ],
)
def test_each_obstacle_to_engaging(changes: dict[str, object], reason: str) -> None:
    assert engage_inhibit(replace(WELL, **changes)) is Inhibit[reason]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("alive", "heard", "operational", "equal", "reason"),
    [
        (True, True, True, False, "CONFIGURATION_GATEWAY"),
        (False, True, True, False, "CONFIGURATION_GATEWAY"),  # its frames cannot be read
        (True, True, True, None, "CONFIGURATION_GATEWAY"),
        (False, False, True, None, "MISSING_GATEWAY"),
        (False, True, False, None, "NOT_OPERATIONAL_GATEWAY"),
        (False, False, False, True, "MISSING_GATEWAY"),
        (False, True, True, True, "MISSING_GATEWAY"),
    ],
)
def test_node_in_the_way_is_named_with_what_it_lacks(
    alive: bool, heard: bool, operational: bool, equal: bool | None, reason: str
) -> None:
    situation = replace(
        WELL,
        alive={**WELL.alive, "Gateway": alive},
        heard={**WELL.heard, "Gateway": heard},
        operational={**WELL.operational, "Gateway": operational},
        configuration_equal={**WELL.configuration_equal, "Gateway": equal},
    )
    assert engage_inhibit(situation) is Inhibit[reason]


@pytest.mark.parametrize("mode", [Mode.AUTOMATIC, Mode.STOPPING])
def test_nothing_inhibits_while_driving(mode: Mode) -> None:
    assert inhibit(replace(WELL, mode=mode, verdict=None)) is Inhibit.NONE
