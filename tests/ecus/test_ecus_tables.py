"""Every cell of every table, written a second time by hand."""

from __future__ import annotations

import pytest

from dbc.messages import Mode, NodeState
from ecus.brake_servo.mode import ACTION as BRAKE_ACTION
from ecus.brake_servo.mode import BrakeAction
from ecus.brake_servo.mode import Situation as BrakeSituation
from ecus.common.node_state import NODE_STATE_AFTER, SAFE_STATES, NodeEvent
from ecus.steering.mode import ACTION as STEER_ACTION
from ecus.steering.mode import SteerAction
from ecus.supervisor.mode import AUTHORISED, DRIVING_MODES, MODE_AFTER, RELAY_CLOSED, ModeEvent
from ecus.throttle.mode import ACTION as THROTTLE_ACTION
from ecus.throttle.mode import Situation as ThrottleSituation
from ecus.throttle.mode import ThrottleAction

NODE_EVENTS = "MANUAL EMERGENCY OWN_CAUSE UNAUTHORISED AUTHORISED NOTHING"
NODE_ROWS = {
    "STARTING": "RELEASED EMERGENCY STARTING RELEASED RELEASED STARTING",
    "RELEASED": "RELEASED EMERGENCY RELEASED RELEASED ACTIVE RELEASED",
    "ACTIVE": "RELEASED EMERGENCY SAFE_ALONE RELEASED ACTIVE ACTIVE",
    "SAFE_ALONE": "RELEASED EMERGENCY SAFE_ALONE SAFE_ALONE SAFE_ALONE SAFE_ALONE",
    "EMERGENCY": "RELEASED EMERGENCY EMERGENCY EMERGENCY EMERGENCY EMERGENCY",
}

MODE_EVENTS = (
    "ADOPT EMERGENCY_STOP FAULT DRIVER RESET BUTTON DISENGAGE STANDSTILL ENGAGE TIMEOUT "
    "NODES_SEEN NOTHING"
)
N, M, R, A, S, E = "INIT", "MANUAL", "READY", "AUTOMATIC", "STOPPING", "EMERGENCY"
MODE_ROWS = {
    N: (E, N, N, N, N, N, N, N, N, N, M, N),
    M: (M, M, M, M, M, R, M, M, M, M, M, M),
    R: (R, E, R, M, R, M, R, R, A, M, R, R),
    A: (A, E, E, M, A, S, S, A, A, A, A, A),
    S: (S, E, E, M, S, S, S, R, S, S, S, S),
    E: (E, E, E, E, M, E, E, E, E, E, E, E),
}

ACTION_CELLS = [
    ("STARTING", "COAST COAST", "IDLE IDLE IDLE", "NONE NONE NONE"),
    ("RELEASED", "COAST COAST", "IDLE IDLE IDLE", "RELEASE RELEASE RELEASE"),
    ("ACTIVE", "FOLLOW FOLLOW", "FOLLOW STOP FOLLOW", "FOLLOW STOP REST"),
    ("SAFE_ALONE", "COAST HOLD", "CUT CUT REGENERATE", "FULL FULL REST"),
    ("EMERGENCY", "COAST HOLD", "CUT CUT REGENERATE", "FULL FULL REST"),
]


@pytest.mark.parametrize("state", NODE_ROWS)
def test_node_state_after_every_event_is_as_written_here(state: str) -> None:
    row = NODE_STATE_AFTER[NodeState[state]]
    assert [event.name for event in NodeEvent] == NODE_EVENTS.split()  # order is priority
    assert [row[event].name for event in NodeEvent] == NODE_ROWS[state].split()


def test_node_states_are_those_of_this_test() -> None:
    assert [state.name for state in NodeState] == list(NODE_ROWS)
    assert {NodeState.SAFE_ALONE, NodeState.EMERGENCY} == SAFE_STATES


@pytest.mark.parametrize("mode", MODE_ROWS)
def test_mode_after_every_event_is_as_written_here(mode: str) -> None:
    row = MODE_AFTER[Mode[mode]]
    assert [event.name for event in ModeEvent] == MODE_EVENTS.split()  # order is priority
    assert [row[event].name for event in ModeEvent] == list(MODE_ROWS[mode])


def test_emergency_is_entered_only_as_the_design_says() -> None:
    into = {
        (mode.name, event.name)
        for mode, row in MODE_AFTER.items()
        for event, after in row.items()
        if after is Mode.EMERGENCY and mode is not Mode.EMERGENCY
    }
    assert into == {
        ("INIT", "ADOPT"),
        ("READY", "EMERGENCY_STOP"),
        ("AUTOMATIC", "EMERGENCY_STOP"),
        ("AUTOMATIC", "FAULT"),
        ("STOPPING", "EMERGENCY_STOP"),
        ("STOPPING", "FAULT"),
    }


def test_emergency_is_left_only_to_manual_by_reset() -> None:
    leaving = {e: m for e, m in MODE_AFTER[Mode.EMERGENCY].items() if m is not Mode.EMERGENCY}
    assert leaving == {ModeEvent.RESET: Mode.MANUAL}


def test_automatic_is_entered_only_from_ready_by_request() -> None:
    into = {
        (mode, event)
        for mode, row in MODE_AFTER.items()
        for event, after in row.items()
        if after is Mode.AUTOMATIC and mode is not Mode.AUTOMATIC
    }
    assert into == {(Mode.READY, ModeEvent.ENGAGE)}


@pytest.mark.parametrize(("state", "steer", "throttle", "brake"), ACTION_CELLS)
def test_actions_in_every_state_and_situation(
    state: str, steer: str, throttle: str, brake: str
) -> None:
    node_state = NodeState[state]
    assert [STEER_ACTION[node_state][hold] for hold in (False, True)] == [
        SteerAction[name] for name in steer.split()
    ]
    assert [THROTTLE_ACTION[node_state][s] for s in ThrottleSituation] == [
        ThrottleAction[name] for name in throttle.split()
    ]
    assert [BRAKE_ACTION[node_state][s] for s in BrakeSituation] == [
        BrakeAction[name] for name in brake.split()
    ]


def test_every_state_has_its_actions() -> None:
    assert [row[0] for row in ACTION_CELLS] == [state.name for state in NodeState]
    assert [s.name for s in ThrottleSituation] == ["NORMAL", "STOPPING", "BRAKE_MISSING"]
    assert [s.name for s in BrakeSituation] == ["NORMAL", "STOPPING", "RESTING"]


def test_axes_are_authorised_only_while_driving_and_traction_not_in_emergency() -> None:
    everything = {"steering", "throttle", "brake"}
    assert {
        Mode.INIT: set(),
        Mode.MANUAL: set(),
        Mode.READY: set(),
        Mode.AUTOMATIC: everything,
        Mode.STOPPING: everything,
        Mode.EMERGENCY: {"steering", "brake"},
    } == AUTHORISED
    assert {Mode.AUTOMATIC, Mode.STOPPING} == DRIVING_MODES


def test_relay_is_closed_only_while_the_system_drives_or_brakes() -> None:
    assert RELAY_CLOSED == {
        Mode.INIT: None,
        Mode.MANUAL: False,
        Mode.READY: False,
        Mode.AUTOMATIC: True,
        Mode.STOPPING: True,
        Mode.EMERGENCY: True,
    }
