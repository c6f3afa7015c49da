"""The state a planner sees: values, what is missing, and the reasons in words."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError, asdict
from typing import Any

import pytest

from canbus.node import NODE_IDS
from dbc.messages import (
    EmergencyBrake,
    ErrorCode,
    HeartbeatState,
    Inhibit,
    Mode,
    MonitorReason,
    NodeState,
    Reason,
    Request,
    Verdict,
)
from gateway.core import PlannerInputs
from gateway.node_health import NodeHealth
from gateway.sentences import INHIBIT_TEXT, MONITOR_TEXT, REASON_TEXT
from gateway.state import CarState
from tests.gateway.scripted import Rig

NODES = {"Supervisor", "Steering", "Throttle", "BrakeServo", "SafetyMonitor", "Gateway"}


def why(**supervisor: Any) -> str:
    rig = Rig().start()
    rig.set("SUPERVISOR_STATE", **supervisor)
    rig.step()
    return rig.state().why_not_engaged


def test_measured_values_come_from_the_status_frames() -> None:
    rig = Rig().start()
    rig.set("STEER_STATUS", steering_wheel_angle_rad=-5.0)
    rig.set("THROTTLE_STATUS", wheel_speed_radps=20.0)
    rig.set("BRAKE_STATUS", servo_position_ratio=0.25)
    rig.step()
    state = rig.state()
    # tan(-5/40)/2.36 = -0.053244 1/m; 20 rad/s x cos(0.125) x 0.287 m = 5.6952 m/s
    assert state.steering_wheel_angle_rad == pytest.approx(-5.0, abs=3e-4)
    assert state.curvature_per_m == pytest.approx(-0.053244, abs=1e-5)
    assert state.speed_mps == pytest.approx(5.6952, abs=1e-3)
    assert state.yaw_rate_radps == pytest.approx(-0.053244 * 5.6952, abs=1e-3)
    assert state.brake_position_ratio == pytest.approx(0.25, abs=1e-3)
    assert state.time_ns == rig.now_ns


def test_state_is_frozen() -> None:
    state = Rig().start().state()
    with pytest.raises(FrozenInstanceError):
        state.mode = Mode.AUTOMATIC  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        state.node_health["Steering"].is_heard = False  # type: ignore[misc]
    with pytest.raises(TypeError):
        state.node_health["Steering"] = state.node_health["Gateway"]  # type: ignore[index]


@pytest.mark.parametrize(
    "through", [copy.copy, copy.deepcopy, lambda state: pickle.loads(pickle.dumps(state))]
)
def test_state_can_be_copied_and_handed_to_another_process(
    through: Callable[[CarState], CarState],
) -> None:
    state = Rig().start().state()
    twin = through(state)
    # By their texts, for NaN equals nothing.
    assert repr(twin) == repr(state)
    assert twin.node_health == state.node_health and len(twin.node_health) == len(NODE_IDS)
    with pytest.raises(TypeError):
        twin.node_health["Steering"] = twin.node_health["Gateway"]  # type: ignore[index]
    assert asdict(twin)["mode"] is Mode.READY


def test_healthy_bus_reads_healthy() -> None:
    state = Rig().start().state()
    assert set(state.node_health) == NODES
    assert all(health.is_healthy for health in state.node_health.values())
    assert state.mode is Mode.READY and not state.is_engaged
    assert state.codes == () and state.reset_epoch == 3
    assert state.decision_age_limit_s == pytest.approx(0.085)
    assert math.isnan(state.decision_age_s)
    assert state.pending_request is Request.NONE
    assert state.emergency_reason is None
    assert state.supervisor_state_age_s == state.verdict_age_s == pytest.approx(0.001)


def assert_nothing_known(state: CarState) -> None:
    for name in (
        *("speed_mps", "curvature_per_m", "steering_wheel_angle_rad", "yaw_rate_radps"),
        *("brake_position_ratio", "decision_age_limit_s"),
    ):
        assert math.isnan(getattr(state, name)), name
    assert state.mode is None and state.codes is None and state.reset_epoch is None
    assert not state.is_engaged
    assert not any(
        health.is_healthy for node, health in state.node_health.items() if node != "Gateway"
    )


def test_before_any_frame_nothing_is_known_and_nothing_is_healthy() -> None:
    rig = Rig()
    rig.muted |= NODES
    rig.step()
    state = rig.state()
    assert_nothing_known(state)
    assert state.why_not_engaged == (
        "no supervisor on the bus (nothing heard yet):"
        " is it running, on this interface and channel?"
    )
    assert state.steering_age_s == state.throttle_age_s == state.brake_age_s == math.inf


def test_when_the_bus_falls_silent_in_automatic_nothing_is_known_any_more() -> None:
    rig = Rig().start()
    rig.mode(Mode.AUTOMATIC, inhibit=Inhibit.NONE)
    rig.run(20)
    assert rig.state().is_engaged and rig.state().why_not_engaged == ""
    rig.muted |= NODES
    rig.run(50)
    assert rig.state().is_engaged  # 51 ms: within the time-out of 60 ms
    rig.run(150)
    state = rig.state()
    assert_nothing_known(state)
    assert state.why_not_engaged.startswith("no supervisor on the bus (silent for 0.20 s)")
    assert state.steering_age_s == pytest.approx(0.201)


def test_value_a_node_does_not_have_is_nan() -> None:
    rig = Rig().start()
    rig.set("STEER_STATUS", steering_wheel_angle_rad=math.nan)
    rig.step()
    state = rig.state()
    assert math.isnan(state.curvature_per_m) and math.isnan(state.speed_mps)
    assert state.brake_position_ratio == 0.0


@pytest.mark.parametrize(
    ("message", "values"),
    [
        ("STEER_HEARTBEAT", {"state": HeartbeatState.PRE_OPERATIONAL}),
        ("STEER_DRIVER", {"er6": True}),
        ("STEER_DRIVER", {"node_state": NodeState.SAFE_ALONE}),
        ("STEER_DRIVER", {"node_state": NodeState.EMERGENCY}),
        ("STEER_DRIVER", {"node_state": NodeState.STARTING}),
    ],
)
def test_node_that_reports_anything_wrong_is_unhealthy(
    message: str, values: dict[str, Any]
) -> None:
    rig = Rig().start()
    rig.set(message, **values)
    rig.run(20)
    health = rig.state().node_health
    assert not health["Steering"].is_healthy
    assert health["Throttle"].is_healthy


@pytest.mark.parametrize("message", ["STEER_STATUS", "STEER_DRIVER", "STEER_HEARTBEAT"])
def test_node_is_unhealthy_as_soon_as_one_of_its_frames_is_missing(message: str) -> None:
    rig = Rig().start()
    rig.muted.add(message)
    rig.run(200)
    health = rig.state().node_health["Steering"]
    assert not health.is_healthy
    if message == "STEER_DRIVER":
        assert health.codes is None and health.node_state is None
    if message == "STEER_HEARTBEAT":
        assert health.heartbeat is None


def test_node_health_tells_state_and_codes() -> None:
    rig = Rig().start()
    rig.set("BRAKE_DRIVER", node_state=NodeState.ACTIVE, er3=True, er5=True)
    rig.run(20)
    assert rig.state().node_health["BrakeServo"] == NodeHealth(
        heartbeat=HeartbeatState.OPERATIONAL,
        age_s=0.001,
        is_heard=True,
        node_state=NodeState.ACTIVE,
        codes=(ErrorCode.ER3, ErrorCode.ER5),
    )


def test_codes_are_those_the_supervisor_has_latched() -> None:
    rig = Rig().start()
    rig.set("SUPERVISOR_STATE", er0=True, er6=True)
    rig.step()
    assert rig.state().codes == (ErrorCode.ER0, ErrorCode.ER6)


@pytest.mark.parametrize(
    ("table", "members"),
    [(INHIBIT_TEXT, Inhibit), (MONITOR_TEXT, MonitorReason), (REASON_TEXT, Reason)],
)
def test_every_reason_has_a_sentence_of_its_own(table: dict[Any, str], members: Any) -> None:
    assert set(table) == set(members)
    assert all(text and text == text.strip() and "\n" not in text for text in table.values())
    assert len(set(table.values())) >= len(table) - 1  # "no reason given" may be shared


@pytest.mark.parametrize("inhibit", [i for i in Inhibit if i is not Inhibit.VERDICT_DENY])
def test_inhibit_is_told_in_words(inhibit: Inhibit) -> None:
    assert why(inhibit=inhibit) == INHIBIT_TEXT[inhibit]


def test_missing_and_misconfigured_nodes_are_named() -> None:
    assert "the brake-servo ECU" in why(inhibit=Inhibit.MISSING_BRAKE_SERVO)
    assert "the steering ECU" in why(inhibit=Inhibit.CONFIGURATION_STEERING)


def test_latched_codes_are_listed() -> None:
    text = why(inhibit=Inhibit.CODE_LATCHED, er2=True, er4=True)
    assert text == "an error code is latched: remove its cause, then call reset() (ER2, ER4)"


def test_controlled_stop_says_wait() -> None:
    assert why(mode=Mode.STOPPING) == "a controlled stop is under way: wait until the car stands"


def denied(reason: MonitorReason, identifier: int = 0, value: int = 0) -> str:
    rig = Rig().start()
    rig.set("SUPERVISOR_STATE", inhibit=Inhibit.VERDICT_DENY)
    rig.set(
        "SAFETY_VERDICT", verdict=Verdict.DENY, reason=reason, identifier=identifier, value=value
    )
    rig.step()
    return rig.state().why_not_engaged


@pytest.mark.parametrize(
    ("reason", "identifier", "value", "text"),
    [
        (MonitorReason.STARTING, 0, 0, "it has not seen everything healthy yet"),
        (MonitorReason.FRAME_MISSING, 0x183, 0, "a frame is missing (THROTTLE_STATUS 0x183)"),
        (
            MonitorReason.UNKNOWN_IDENTIFIER,
            0x123,
            0,
            "an identifier is not known: find its sender and unplug it (identifier 0x123)",
        ),
        (MonitorReason.SPEED, 0x183, 1250, "the speed is above the envelope (1.25 of the limit)"),
    ],
)
def test_denying_verdict_is_told_with_its_reason_and_message(
    reason: MonitorReason, identifier: int, value: int, text: str
) -> None:
    assert denied(reason, identifier, value) == f"the safety monitor denies: {text}"


def test_denial_whose_verdict_no_longer_comes_says_so() -> None:
    rig = Rig().start()
    rig.set("SUPERVISOR_STATE", inhibit=Inhibit.VERDICT_DENY)
    rig.muted.add("SafetyMonitor")
    rig.run(100)
    assert rig.state().why_not_engaged == "the safety monitor denies: its verdict no longer comes"


def emergency_brake(rig: Rig, name: str, code: ErrorCode, reason: Reason) -> None:
    message = EmergencyBrake(code=code, reason=reason, cause_age_ms=12, reset_epoch=3)
    rig.extra.append(rig.frame(name, message))


def test_emergency_tells_who_braked_and_why() -> None:
    rig = Rig().start()
    emergency_brake(rig, "STEER_EMERGENCY_BRAKE", ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS)
    rig.mode(Mode.EMERGENCY, inhibit=Inhibit.MOVING)
    rig.step()
    state = rig.state()
    assert str(state.emergency_reason) == "Steering: a sensor was out of bounds (ER6)"
    assert state.why_not_engaged == (
        "emergency brake (Steering: a sensor was out of bounds (ER6)):"
        " the car is moving: bring it to a standstill first"
    )


def test_emergency_without_a_known_cause_still_says_what_to_do() -> None:
    assert why(mode=Mode.EMERGENCY, inhibit=Inhibit.MOVING) == (
        "emergency brake: the car is moving: bring it to a standstill first"
    )


def test_nodes_that_only_follow_do_not_hide_the_cause() -> None:
    rig = Rig().start()
    emergency_brake(rig, "BRAKE_EMERGENCY_BRAKE", ErrorCode.ER1, Reason.NODE_EMERGENCY)
    rig.step()
    reason = rig.state().emergency_reason
    assert reason is not None and reason.node == "BrakeServo"
    emergency_brake(rig, "THROTTLE_EMERGENCY_BRAKE", ErrorCode.ER5, Reason.PLANNER_SILENT)
    rig.step()
    emergency_brake(rig, "SUPERVISOR_EMERGENCY_BRAKE", ErrorCode.ER1, Reason.NODE_EMERGENCY)
    rig.step()
    assert str(rig.state().emergency_reason) == (
        "Throttle: the planner's decision grew too old (ER5)"
    )


@pytest.mark.parametrize("change", [{"reset_epoch": 4}, {"mode": Mode.AUTOMATIC}])
def test_cause_is_forgotten_with_the_reset_and_with_the_next_drive(change: dict[str, Any]) -> None:
    rig = Rig().start()
    emergency_brake(rig, "STEER_EMERGENCY_BRAKE", ErrorCode.ER4, Reason.MOTOR_FAULT)
    rig.step()
    assert rig.state().emergency_reason is not None
    rig.set("SUPERVISOR_STATE", **change)
    rig.step()
    assert rig.state().emergency_reason is None


def test_pending_request_is_visible() -> None:
    rig = Rig().start()
    rig.poke(PlannerInputs(request=Request.ENGAGE))
    assert rig.state().pending_request is Request.ENGAGE
