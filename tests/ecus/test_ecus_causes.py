"""Steer, throttle and brake ECU: causes, the safe state, EMERGENCY_BRAKE, ER2."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame
from canbus.node import NODE_IDS, EventKind
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import ErrorCode, Mode, NodeState, Reason
from tests.ecus.actuator_causes import (
    ALL_OWN,
    FOREIGN_STOPS,
    NAMES,
    SETPOINT,
    bus_off,
    foreign_sender,
    late,
    nmt,
    supervisor_silent,
)
from tests.ecus.ecus_fakes import (
    BUS_OFF,
    MS,
    Rig,
    flags,
)

# Causes --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "code", "reason", "act"), ALL_OWN)
def test_own_cause_while_active_ends_in_the_safe_state_and_is_told(
    name: str, code: ErrorCode, reason: Reason, act: Callable[[Rig], None]
) -> None:
    rig = Rig(name).drive()
    rig.steps(10)
    rig.forget()
    act(rig)
    assert rig.state is NodeState.SAFE_ALONE
    brakes = rig.all_sent("EMERGENCY_BRAKE")
    assert brakes and {(b.code, b.reason) for b in brakes} == {(code, reason)}
    assert f"{code.name} {reason.name}" in rig.logged(EventKind.CODE)
    assert "ACTIVE -> SAFE_ALONE" in rig.logged(EventKind.STATE)


@pytest.mark.parametrize(("name", "code", "reason", "act"), ALL_OWN)
def test_own_cause_is_in_emcy_and_driver_frame_until_the_reset_epoch_rises(
    name: str, code: ErrorCode, reason: Reason, act: Callable[[Rig], None]
) -> None:
    rig = Rig(name).drive()
    rig.steps(10)
    rig.forget()
    act(rig)
    rig.heal()
    rig.age_ms = 0.0
    rig.emergency().steps(2)
    rig.extra.append(nmt_frame(NmtCommand.START, NODE_IDS[name]))
    rig.steps(105)
    (emcy,) = [e for e in rig.all_sent("EMCY") if e.er_code is code]
    assert emcy.error_code == 0xFF00 + code and emcy.error_register == 0x81
    assert emcy.reason is reason and emcy.er_bits & 1 << code
    driver = rig.all_sent("DRIVER")[-1]
    assert code in flags(driver) and driver.present_codes == 0
    rig.mode, rig.is_authorised, rig.reset_epoch = Mode.MANUAL, False, 1
    rig.steps(6)
    assert flags(rig.all_sent("DRIVER")[-1]) == set()
    assert rig.all_sent("EMCY")[-1].error_code == 0  # error reset


@pytest.mark.parametrize(("name", "code", "reason", "act"), ALL_OWN)
def test_nothing_brakes_in_manual_for_any_cause_of_the_node_itself(
    name: str, code: ErrorCode, reason: Reason, act: Callable[[Rig], None]
) -> None:
    rig = Rig(name)
    for _ in range(3):
        act(rig)
        assert rig.state is NodeState.RELEASED and rig.is_idle
    rig.steps(50)
    assert rig.state is NodeState.RELEASED and rig.is_idle
    assert not rig.all_sent("EMERGENCY_BRAKE")


@pytest.mark.parametrize(("name", "act"), FOREIGN_STOPS)
def test_nothing_brakes_in_manual_for_a_frame_that_stops_others(
    name: str, act: Callable[[Rig], None]
) -> None:
    rig = Rig(name)
    for _ in range(20):
        act(rig)
        assert rig.state is NodeState.RELEASED and rig.is_idle
    assert not rig.all_sent("EMERGENCY_BRAKE")


@pytest.mark.parametrize(("name", "act"), FOREIGN_STOPS)
def test_anybodys_emergency_is_obeyed_in_the_same_step_while_active(
    name: str, act: Callable[[Rig], None]
) -> None:
    rig = Rig(name).drive(SETPOINT[name])
    act(rig)
    assert rig.state is NodeState.EMERGENCY
    assert not rig.all_sent("EMERGENCY_BRAKE")  # somebody else's cause


@pytest.mark.parametrize("name", NAMES)
def test_codes_under_a_human_driver_do_not_latch(name: str) -> None:
    rig = Rig(name)
    foreign_sender(rig)
    assert flags(rig.now_sent("DRIVER")[0]) == {1}
    rig.steps(105)
    assert flags(rig.all_sent("DRIVER")[-1]) == set()


@pytest.mark.parametrize("name", NAMES)
def test_cause_still_there_at_the_reset_is_reported_again(name: str) -> None:
    rig = Rig(name).drive()
    foreign_sender(rig)
    rig.emergency().steps(3)
    rig.mode, rig.is_authorised, rig.reset_epoch = Mode.MANUAL, False, 1
    foreign_sender(rig)
    assert rig.state is NodeState.RELEASED
    assert flags(rig.now_sent("DRIVER")[0]) == {1}


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.READY])
@pytest.mark.parametrize("name", NAMES)
def test_one_state_with_another_epoch_unlatches_nothing(name: str, mode: Mode) -> None:
    """A corrupt frame fits its CRC-8 once in 256 times; twice in a row with one epoch, hardly."""
    rig = Rig(name).drive()
    late(rig)
    rig.emergency().steps(3)
    rig.mode, rig.is_authorised, rig.reset_epoch = mode, False, 1
    rig.step()
    rig.mode, rig.reset_epoch = Mode.EMERGENCY, 0
    rig.steps(110)
    assert rig.state is NodeState.EMERGENCY
    assert flags(rig.all_sent("DRIVER")[-1]) == {2}


@pytest.mark.parametrize("name", NAMES)
def test_one_state_that_is_looked_at_again_and_again_is_not_told_twice(name: str) -> None:
    rig = Rig(name).drive()
    late(rig)
    rig.emergency().steps(3)
    rig.mode, rig.is_authorised, rig.reset_epoch = Mode.MANUAL, False, 1
    rig.step()
    rig.mode = None  # nothing more of the supervisor is heard
    rig.steps(110)
    assert flags(rig.all_sent("DRIVER")[-1]) == {2}


@pytest.mark.parametrize("name", NAMES)
def test_restarted_supervisor_with_another_epoch_unlatches_nothing(name: str) -> None:
    rig = Rig(name)
    rig.reset_epoch = 3
    rig.drive()
    late(rig)
    rig.emergency().steps(3)
    rig.reset_epoch = 0
    rig.mode, rig.is_authorised = Mode.INIT, False
    rig.steps(5)
    rig.emergency().steps(110)
    assert rig.state is NodeState.EMERGENCY
    assert flags(rig.all_sent("DRIVER")[-1]) == {2}
    rig.mode, rig.is_authorised, rig.reset_epoch = Mode.MANUAL, False, 1
    rig.steps(3)
    assert flags(rig.all_sent("DRIVER")[-1]) == set()


@pytest.mark.parametrize("name", NAMES)
def test_supervisor_back_in_init_while_active_is_a_dead_supervisor(name: str) -> None:
    rig = Rig(name).drive(SETPOINT[name])
    rig.mode, rig.is_authorised = Mode.INIT, False
    rig.step()
    assert rig.state is NodeState.SAFE_ALONE
    brake = rig.now_sent("EMERGENCY_BRAKE")[0]
    assert (brake.code, brake.reason) == (ErrorCode.ER2, Reason.SUPERVISOR_SILENT)


# EMERGENCY_BRAKE -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_emergency_brake_goes_out_at_once_and_every_10_ms_until_acknowledged(name: str) -> None:
    rig = Rig(name).drive()
    rig.reset_epoch = 5
    rig.steps(2)
    foreign_sender(rig)
    for count in range(30):
        (brake,) = rig.now_sent("EMERGENCY_BRAKE")
        assert brake.cause_age_ms == 10 * count and brake.reset_epoch == 5
        assert (brake.code, brake.reason) == (ErrorCode.ER1, Reason.FOREIGN_SENDER)
        rig.step()
    rig.emergency().step()
    assert not rig.now_sent("EMERGENCY_BRAKE") and rig.state is NodeState.EMERGENCY


@pytest.mark.parametrize("name", NAMES)
def test_emergency_brake_keeps_the_first_cause(name: str) -> None:
    rig = Rig(name).drive()
    foreign_sender(rig)
    bus_off(rig)
    assert {b.reason for b in rig.all_sent("EMERGENCY_BRAKE")} == {Reason.FOREIGN_SENDER}


@pytest.mark.parametrize("name", NAMES)
def test_emergency_brake_passes_over_a_bad_frame_of_the_same_step(name: str) -> None:
    rig = Rig(name).drive()
    rig.extra.append(Frame(SPEC_OF_NAME["SUPERVISOR_STATE"].can_id, bytes(3)))
    rig.extra.append(BUS_OFF)
    rig.step()
    assert [b.reason for b in rig.all_sent("EMERGENCY_BRAKE")] == [Reason.BUS_OFF]


@pytest.mark.parametrize("name", NAMES)
def test_emergency_brake_is_withdrawn_when_a_human_drives(name: str) -> None:
    rig = Rig(name).drive()
    foreign_sender(rig)
    rig.mode, rig.is_authorised = Mode.MANUAL, False
    rig.step()
    assert not rig.now_sent("EMERGENCY_BRAKE") and rig.is_idle
    rig.mode = Mode.READY
    rig.steps(5)
    assert not rig.now_sent("EMERGENCY_BRAKE")


@pytest.mark.parametrize("name", NAMES)
def test_age_of_a_very_old_cause_saturates(name: str) -> None:
    rig = Rig(name).drive()
    foreign_sender(rig)
    rig.step(span_ns=66_000 * MS)
    assert rig.now_sent("EMERGENCY_BRAKE")[0].cause_age_ms == 65_535


# ER2 -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_lateness_of_exactly_50_ms_does_not_brake_and_a_nanosecond_more_does(name: str) -> None:
    rig = Rig(name).drive()
    rig.step(span_ns=60 * MS)
    assert rig.state is NodeState.ACTIVE
    rig.step()
    rig.step(span_ns=60 * MS + 1)
    assert rig.node.state is NodeState.SAFE_ALONE


@pytest.mark.parametrize("name", NAMES)
def test_two_overruns_do_not_brake_but_each_is_reported(name: str) -> None:
    rig = Rig(name).drive()
    for _ in range(4):
        rig.step(span_ns=16 * MS)
        rig.step(span_ns=16 * MS)
        rig.step()
    assert rig.state is NodeState.ACTIVE
    assert rig.logged(EventKind.OVERRUN) == ["overrun (6.0 ms)"] * 8
    assert rig.node.shell.cycle.overruns == 8


@pytest.mark.parametrize("name", NAMES)
def test_supervisor_silent_for_50_ms_is_tolerated_for_60_ms_brakes(name: str) -> None:
    rig = Rig(name).drive()
    rig.mode = None
    rig.steps(5)
    assert rig.state is NodeState.ACTIVE
    rig.step()
    assert rig.node.state is NodeState.SAFE_ALONE
    assert rig.now_sent("EMERGENCY_BRAKE")[0].cause_age_ms == 61  # since it was last heard


@pytest.mark.parametrize("name", NAMES)
def test_supervisor_heard_at_exactly_60_ms_is_in_time(name: str) -> None:
    rig = Rig(name).drive()
    rig.lag_ns = 0
    rig.step()
    rig.mode = None
    rig.steps(6)
    assert rig.state is NodeState.ACTIVE


@pytest.mark.parametrize("name", NAMES)
def test_dead_supervisor_in_manual_or_ready_does_not_stop_the_car(name: str) -> None:
    for mode in (Mode.MANUAL, Mode.READY):
        rig = Rig(name)
        rig.mode = mode
        rig.step()
        rig.mode = None
        rig.steps(100)
        assert rig.state is NodeState.RELEASED and rig.is_idle


@pytest.mark.parametrize("name", NAMES)
def test_ready_ends_a_safe_state_only_with_another_reset_epoch(name: str) -> None:
    rig = Rig(name).drive()
    rig.steps(10)
    rig.mode, rig.is_authorised = Mode.EMERGENCY, False
    rig.steps(3)
    rig.mode = Mode.READY  # MANUAL was not heard
    rig.steps(20)
    assert rig.state is NodeState.EMERGENCY
    rig.reset_epoch += 1
    rig.steps(2)
    assert rig.node.state is NodeState.RELEASED


@pytest.mark.parametrize("name", NAMES)
def test_a_reset_before_the_drive_ends_no_later_safe_state(name: str) -> None:
    rig = Rig(name)
    rig.reset_epoch += 1
    rig.steps(3)
    rig.drive().steps(10)
    rig.mode, rig.is_authorised = Mode.EMERGENCY, False
    rig.steps(3)
    rig.mode = Mode.READY
    rig.steps(20)
    assert rig.state is NodeState.EMERGENCY


@pytest.mark.parametrize("name", NAMES)
def test_safe_state_outlives_a_supervisor_that_comes_back_in_automatic(name: str) -> None:
    rig = Rig(name).drive()
    supervisor_silent(rig)
    rig.mode = Mode.AUTOMATIC
    rig.steps(30)
    assert rig.state is NodeState.SAFE_ALONE
    rig.mode = Mode.READY
    rig.steps(5)
    assert rig.state is NodeState.SAFE_ALONE


@pytest.mark.parametrize("name", NAMES)
def test_stopped_node_still_calls_for_the_emergency_brake(name: str) -> None:
    rig = Rig(name).drive()
    nmt(NmtCommand.STOP)(rig)
    rig.step()
    assert rig.now_sent("EMERGENCY_BRAKE") and not rig.now_sent("STATUS")


@pytest.mark.parametrize("name", NAMES)
def test_nmt_command_for_another_node_is_not_ours(name: str) -> None:
    rig = Rig(name).drive()
    rig.extra.append(nmt_frame(NmtCommand.STOP, 9))
    rig.step()
    assert rig.state is NodeState.ACTIVE and not rig.events
