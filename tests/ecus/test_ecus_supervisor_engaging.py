"""The supervisor through its steps: what keeps the car from engaging, and strangers."""

from __future__ import annotations

import pytest

from canbus.frame import Frame, FrameKind
from canbus.node import EventKind
from dbc.messages import HeartbeatState, Inhibit, Mode, NodeState, Request, Verdict
from tests.ecus.ecus_fakes import changed, tabby
from tests.ecus.supervisor_fakes import NODES, Street

ACTUATORS = ("Steering", "Throttle", "BrakeServo")
SUFFIX = {
    "Steering": "STEERING", "Throttle": "THROTTLE", "BrakeServo": "BRAKE_SERVO",
    "SafetyMonitor": "SAFETY_MONITOR", "Gateway": "GATEWAY",
}


# Engaging ------------------------------------------------------------------------------------


def test_button_then_request_engages_and_authorises_all_axes() -> None:
    street = Street()
    assert street.shown.inhibit is Inhibit.PRESS_BUTTON
    street.ready()
    assert street.ecu.inhibit is Inhibit.NOT_REQUESTED
    street.ask(Request.ENGAGE).until(Mode.AUTOMATIC, 4)
    state = street.shown
    assert (state.steering_authorised, state.throttle_authorised, state.brake_authorised) == (
        True, True, True
    )
    assert state.inhibit is Inhibit.NONE


def test_no_axis_is_authorised_before_automatic() -> None:
    street = Street(booted=False)
    for _ in range(150):
        state = street.step()
        assert not (
            state.steering_authorised or state.throttle_authorised or state.brake_authorised
        )
        street.is_button_down = 100 < street.cycle < 110


def test_request_without_the_button_engages_nothing() -> None:
    street = Street().ask(Request.ENGAGE)
    street.steps(100)
    assert set(street.modes) == {Mode.MANUAL} and street.shown.inhibit is Inhibit.PRESS_BUTTON


def test_button_held_since_power_on_is_no_push() -> None:
    street = Street(booted=False)
    street.is_button_down = True
    street.until(Mode.MANUAL, 60)
    street.steps(50)
    assert street.mode is Mode.MANUAL
    street.is_button_down = False
    street.step()
    street.push()
    assert street.ecu.mode is Mode.READY


def test_button_bounce_of_20_ms_is_no_push_and_a_long_push_is_one() -> None:
    street = Street()
    for _ in range(5):
        street.is_button_down = True
        street.steps(3)
        street.is_button_down = False
        street.step()
    assert street.mode is Mode.MANUAL
    street.is_button_down = True
    street.steps(200)
    assert street.modes[-196:] == [Mode.READY] * 196


def test_button_in_ready_gives_manual_back() -> None:
    street = Street().ready()
    street.push()
    assert street.mode is Mode.MANUAL


def test_ready_times_out() -> None:
    street = Street(changed(tabby(), times={"ready_timeout_s": 5.0})).ready()
    street.steps(490)
    assert street.mode is Mode.READY
    street.until(Mode.MANUAL, 15)


def _break(street: Street, what: str) -> None:
    node = street.nodes["Steering"]
    if what == "EMERGENCY_STOP_PRESSED":
        street.is_stop_pressed = True
    elif what == "CODE_LATCHED":
        street.nodes["BrakeServo"].codes = {3}
    elif what == "FOREIGN_FRAME":
        street.extra.append(Frame(0x123, b"\x01"))
    elif what == "VERDICT_DENY":
        street.verdict = Verdict.DENY
    elif what == "DRIVER_INPUT":
        node.is_driver_active = True
    elif what == "NODE_UNRELEASED":
        node.state, node.is_obedient = NodeState.STARTING, False
    elif what == "PLANNER_PERIOD":
        street.planner_period_ms = 1000
    elif what == "TOO_FAST":
        street.speed_mps = 7.7


@pytest.mark.parametrize(
    "what",
    ["CODE_LATCHED", "FOREIGN_FRAME", "VERDICT_DENY", "NODE_UNRELEASED", "PLANNER_PERIOD",
     "TOO_FAST"],
)
def test_each_obstacle_keeps_ready_from_engaging_and_is_shown(what: str) -> None:
    street = Street().ready()
    _break(street, what)
    street.steps(2)
    if what == "FOREIGN_FRAME":
        street.extra.append(Frame(0x123, b"\x01"))
    street.ask(Request.ENGAGE)
    state = street.steps(20)
    assert state.mode is Mode.READY and state.inhibit is Inhibit[what]


@pytest.mark.parametrize("what", ["EMERGENCY_STOP_PRESSED", "DRIVER_INPUT"])
def test_obstacles_that_leave_ready_are_shown_in_manual(what: str) -> None:
    street = Street()
    _break(street, what)
    state = street.steps(3)
    assert state.mode is Mode.MANUAL and state.inhibit is Inhibit[what]
    street.push()
    assert street.ask(Request.ENGAGE).steps(20).mode is Mode.MANUAL


@pytest.mark.parametrize("name", NODES)
def test_silent_node_keeps_the_car_from_engaging_and_is_named(name: str) -> None:
    street = Street().ready()
    street.nodes[name].is_silent = True
    street.steps(12)
    state = street.ask(Request.ENGAGE).steps(20)
    assert state.mode is Mode.READY and state.inhibit is Inhibit[f"MISSING_{SUFFIX[name]}"]


@pytest.mark.parametrize("name", NODES)
def test_node_that_is_not_operational_is_named_as_such(name: str) -> None:
    street = Street()
    street._hear = lambda frames: None  # type: ignore[method-assign]
    street.nodes[name].nmt = HeartbeatState.STOPPED
    state = street.steps(40)
    assert state.inhibit is Inhibit[f"NOT_OPERATIONAL_{SUFFIX[name]}"]


@pytest.mark.parametrize("name", NODES)
@pytest.mark.parametrize("sub", [1, 2])
def test_node_with_another_configuration_never_engages_and_is_named(name: str, sub: int) -> None:
    street = Street(booted=False)
    street.nodes[name].hashes[sub] ^= 1
    street.boot()
    assert street.shown.inhibit is Inhibit[f"CONFIGURATION_{SUFFIX[name]}"]
    street.push()
    state = street.ask(Request.ENGAGE).steps(100)
    assert state.mode is Mode.READY
    assert state.inhibit is Inhibit[f"CONFIGURATION_{SUFFIX[name]}"]


def test_node_that_answers_nothing_is_asked_again_and_never_engages() -> None:
    street = Street(booted=False)
    street.nodes["Throttle"].answers_sdo = False
    street.steps(400)
    questions = [frame for frame in street.sent if frame.can_id == 0x603]
    assert len(questions) >= 12
    assert street.shown.inhibit is Inhibit.CONFIGURATION_THROTTLE
    street.nodes["Throttle"].answers_sdo = True
    assert street.steps(60).inhibit is Inhibit.PRESS_BUTTON


def test_node_that_refuses_the_question_is_asked_again() -> None:
    street = Street(booted=False)
    node = street.nodes["Gateway"]
    node.answers_sdo = False
    for _ in range(100):
        street.step()
        if any(frame.can_id == 0x606 for frame in street.output.frames):
            node.answers.append(Frame(0x586, b"\x80\x00\x20\x01\x00\x00\x09\x06"))
    assert street.shown.inhibit is Inhibit.CONFIGURATION_GATEWAY
    assert len([frame for frame in street.sent if frame.can_id == 0x606]) > 2


@pytest.mark.parametrize("state", [None, HeartbeatState.PRE_OPERATIONAL])
def test_restarted_node_is_asked_for_its_configuration_again(state: HeartbeatState | None) -> None:
    street = Street()
    street.nodes["Gateway"].nmt = state  # the boot-up heard, or lost
    street.nodes["Gateway"].hashes[2] ^= 1
    street.steps(60)
    assert street.shown.inhibit is Inhibit.CONFIGURATION_GATEWAY


@pytest.mark.parametrize(("period_ms", "limit_ms"), [(20, 85), (100, 205), (21, 90), (600, 955)])
def test_decision_age_limit_follows_the_planners_period(period_ms: int, limit_ms: int) -> None:
    street = Street().ready()
    assert street.shown.decision_age_ms_max == 85
    street.planner_period_ms = period_ms
    street.ask(Request.ENGAGE).until(Mode.AUTOMATIC, 6)
    assert street.shown.decision_age_ms_max == limit_ms


def test_decision_age_limit_above_the_vehicles_timeout_is_refused() -> None:
    street = Street(changed(tabby(), times={"command_timeout_s": 0.3})).ready()
    street.planner_period_ms = 164  # 301 ms, told as 305
    state = street.ask(Request.ENGAGE).steps(10)
    assert state.mode is Mode.READY and state.inhibit is Inhibit.PLANNER_PERIOD
    assert state.decision_age_ms_max == 85
    street.planner_period_ms = 163  # 299.5 ms, told as 300
    street.ask(Request.ENGAGE).until(Mode.AUTOMATIC, 4)
    assert street.shown.decision_age_ms_max == 300


@pytest.mark.parametrize("stop", [False, True])
def test_decision_age_limit_is_frozen_while_driving(stop: bool) -> None:
    street = Street().automatic()
    if stop:
        street.speed_mps = 3.0
        street.steps(40)
        street.push()
        assert street.mode is Mode.STOPPING
    street.planner_period_ms = 300
    street.ask(Request.ENGAGE).steps(10)
    assert street.shown.decision_age_ms_max == 85


def test_request_stops_counting_60_ms_after_its_last_frame() -> None:
    street = Street()
    street.ask(Request.ENGAGE).steps(10)
    street.request = Request.NONE
    street.steps(7)
    street.push()
    street.steps(20)
    assert street.mode is Mode.READY


def test_request_with_the_same_sequence_acts_once() -> None:
    street = Street().automatic()
    street.request = Request.ENGAGE  # still repeated with its old number
    street.nodes["Throttle"].is_driver_active = True
    street.until(Mode.MANUAL, 4)
    street.nodes["Throttle"].is_driver_active = False
    street.steps(10)
    street.push()
    street.steps(50)
    assert street.mode is Mode.READY
    street.ask(Request.ENGAGE).until(Mode.AUTOMATIC, 4)


def test_restarted_gateway_may_count_its_requests_anew() -> None:
    street = Street().automatic()  # by request number 1
    street.push()
    street.until(Mode.READY, 40)
    street.nodes["Gateway"].nmt = None
    street.steps(60)
    street.sequence = 0
    street.ask(Request.ENGAGE).until(Mode.AUTOMATIC, 6)


# Strangers -----------------------------------------------------------------------------------

DENIED = [
    Frame(0x123, b"\x01"),
    Frame(0x3FF), Frame(0x500),
    Frame(0x450, b"", FrameKind.REMOTE),
    Frame(0x450, b"\x01", FrameKind.EXTENDED),
    Frame(0x18FEF100, bytes(8), FrameKind.EXTENDED),
    Frame(0x082, bytes(8), FrameKind.EXTENDED),
    Frame(0x701, b"\x05"),
]


@pytest.mark.parametrize("frame", DENIED, ids=str)
def test_foreign_frame_denies_engagement_for_a_second_and_is_reported(frame: Frame) -> None:
    street = Street().ready()
    street.extra.append(frame)
    street.step()
    assert street.shown.inhibit is Inhibit.FOREIGN_FRAME
    assert len(street.logged(EventKind.FOREIGN)) == 1
    street.steps(98)
    assert street.shown.inhibit is Inhibit.FOREIGN_FRAME
    street.steps(2)
    assert street.ecu.inhibit is Inhibit.NOT_REQUESTED


@pytest.mark.parametrize("can_id", [0x400, 0x450, 0x4FF])
def test_tolerated_range_is_reported_and_denies_nothing(can_id: int) -> None:
    street = Street().ready()
    street.extra.append(Frame(can_id, b"\x01"))
    street.step()
    assert street.shown.inhibit is Inhibit.NOT_REQUESTED
    assert len(street.logged(EventKind.FOREIGN)) == 1


@pytest.mark.parametrize("frame", DENIED[:-1], ids=str)
def test_foreign_frame_in_automatic_is_a_warning_and_moves_nothing(frame: Frame) -> None:
    street = Street().automatic()
    street.extra.append(frame)
    street.steps(5)
    assert street.mode is Mode.AUTOMATIC and len(street.logged(EventKind.FOREIGN)) == 1
