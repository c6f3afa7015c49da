"""Steer, throttle and brake ECU: the age of the planner's decision (ER5)."""

from __future__ import annotations

import math

import pytest

from canbus.node import EventKind
from dbc.messages import ErrorCode, Mode, NodeState, Reason
from tests.ecus.actuator_causes import (
    NAMES,
    SETPOINT,
)
from tests.ecus.ecus_fakes import (
    AGE_LIMIT_MS,
    Rig,
)

# ER5 -----------------------------------------------------------------------------------------


def _drive_with_commands_on_the_step(name: str) -> Rig:
    rig = Rig(name).drive()
    rig.steps(20)
    rig.lag_ns = 0
    rig.forget()
    return rig


@pytest.mark.parametrize("name", NAMES)
def test_decision_exactly_as_old_as_the_limit_is_obeyed(name: str) -> None:
    rig = _drive_with_commands_on_the_step(name)
    rig.age_ms = None
    rig.extra.append(rig.command_frame(0.0, AGE_LIMIT_MS))
    rig.step()
    assert rig.state is NodeState.ACTIVE


@pytest.mark.parametrize("name", NAMES)
def test_decision_a_nanosecond_older_than_the_limit_is_an_emergency(name: str) -> None:
    rig = _drive_with_commands_on_the_step(name)
    rig.age_ms, rig.lag_ns = None, 1
    rig.extra.append(rig.command_frame(0.0, AGE_LIMIT_MS))
    rig.step()
    assert rig.state is NodeState.SAFE_ALONE
    (brake,) = rig.all_sent("EMERGENCY_BRAKE")
    assert (brake.code, brake.reason) == (ErrorCode.ER5, Reason.PLANNER_SILENT)
    assert brake.cause_age_ms == AGE_LIMIT_MS


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("silent_steps", "state"), [(8, "ACTIVE"), (9, "SAFE_ALONE")])
def test_gateway_silent_for_longer_than_the_limit_is_an_emergency(
    name: str, silent_steps: int, state: str
) -> None:
    rig = _drive_with_commands_on_the_step(name)
    rig.age_ms = None
    rig.extra.append(rig.command_frame(0.0, 0.0))
    rig.step()
    rig.steps(silent_steps)
    assert rig.state is NodeState[state]
    reasons = {brake.reason for brake in rig.all_sent("EMERGENCY_BRAKE")}
    assert reasons == (set() if state == "ACTIVE" else {Reason.COMMAND_MISSING})


@pytest.mark.parametrize("name", NAMES)
def test_limit_of_the_node_itself_counts_when_it_is_the_smaller(name: str) -> None:
    rig = Rig(name)
    rig.age_limit_ms = 1270.0
    rig.drive()
    rig.age_ms = None
    rig.steps(99)
    assert rig.state is NodeState.ACTIVE
    rig.steps(3)
    assert rig.node.state is NodeState.SAFE_ALONE  # the vehicle's 1 s


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("age_ms", [None, math.nan, 1270.0])
def test_planner_has_one_limit_of_time_for_its_first_decision(
    name: str, age_ms: float | None
) -> None:
    rig = Rig(name)
    rig.age_ms = age_ms
    rig.mode = Mode.READY
    rig.steps(4)
    rig.mode, rig.is_authorised = Mode.AUTOMATIC, True
    rig.step()
    assert rig.state is NodeState.ACTIVE
    rig.steps(8)
    assert rig.state is NodeState.ACTIVE
    rig.step()  # 90 ms
    assert rig.node.state is NodeState.SAFE_ALONE
    reason = Reason.COMMAND_MISSING if age_ms is None else Reason.PLANNER_SILENT
    assert rig.now_sent("EMERGENCY_BRAKE")[0].reason is reason


@pytest.mark.parametrize("name", NAMES)
def test_decision_from_long_before_the_drive_is_not_obeyed(name: str) -> None:
    rig = Rig(name)
    rig.setpoint, rig.age_ms = SETPOINT[name], 90.0
    rig.mode = Mode.READY
    rig.steps(4)
    rig.mode, rig.is_authorised = Mode.AUTOMATIC, True
    rig.steps(8)
    assert rig.state is NodeState.ACTIVE
    status = rig.now_sent("STATUS")[0]
    applied = [
        getattr(status, field) for field in type(status).__dataclass_fields__ if "applied" in field
    ]
    assert applied == [0.0]


@pytest.mark.parametrize("name", NAMES)
def test_controlled_stop_needs_no_planner(name: str) -> None:
    rig = Rig(name).drive()
    rig.mode, rig.age_ms = Mode.STOPPING, None
    rig.steps(100)
    assert rig.state is NodeState.ACTIVE and not rig.logged(EventKind.CODE)


@pytest.mark.parametrize("name", NAMES)
def test_controlled_stop_still_needs_a_supervisor(name: str) -> None:
    rig = Rig(name).drive()
    rig.mode = Mode.STOPPING
    rig.step()
    rig.mode = None
    rig.steps(6)
    assert rig.state is NodeState.SAFE_ALONE


@pytest.mark.parametrize("name", NAMES)
def test_setpoint_not_available_keeps_the_actuator_still(name: str) -> None:
    rig = Rig(name).drive(math.nan)
    rig.steps(5)
    assert rig.state is NodeState.ACTIVE
    status = rig.now_sent("STATUS")[0]
    applied = [
        getattr(status, field) for field in type(status).__dataclass_fields__ if "applied" in field
    ]
    assert applied == [0.0]
