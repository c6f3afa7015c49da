"""The veto: latched through a drive, told until it is heard; silence, lateness, old decisions."""

from __future__ import annotations

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import ReceivedFrame
from dbc.messages import ErrorCode, Mode, MonitorReason, Reason, Request
from tests.safety_monitor.monitor_bus import (
    BRAKE,
    CAN_ID,
    CYCLE_MS,
    DENY,
    MS,
    NAN,
    PERMIT,
    TIMEOUT_MS,
    MonitorBus,
)

NONE = (PERMIT, MonitorReason.NONE, 0)


# The veto ----------------------------------------------------------------------------------------


def pressed(bus: MonitorBus) -> MonitorBus:
    """One step with the emergency stop pressed."""
    bus.is_emergency_stop_pressed = True
    assert bus.tick().told == (BRAKE, MonitorReason.EMERGENCY_STOP, 0)
    bus.is_emergency_stop_pressed = False
    return bus


def test_brake_stays_until_the_drive_has_ended_and_names_its_cause() -> None:
    bus = pressed(MonitorBus().driving())
    bus.forget()
    bus.run(3_000)
    assert {answer.told for answer in bus.answers} == {(BRAKE, MonitorReason.EMERGENCY_STOP, 0)}


def test_after_a_veto_the_half_second_of_proof_is_asked_for_again() -> None:
    bus = pressed(MonitorBus().driving())
    bus.say_mode(Mode.EMERGENCY)
    bus.forget()
    bus.run(500)
    assert {answer.told for answer in bus.answers} == {(DENY, MonitorReason.STARTING, 0)}
    assert bus.tick().told == NONE


def test_a_later_hazard_does_not_hide_the_first() -> None:
    bus = pressed(MonitorBus().driving())
    bus.muted = {"STEER_STATUS"}
    assert bus.run(500).told == (BRAKE, MonitorReason.EMERGENCY_STOP, 0)


def test_emergency_brake_is_sent_every_cycle_until_the_supervisor_is_in_emergency() -> None:
    bus = MonitorBus().driving()
    bus.forget()
    pressed(bus)
    bus.run(90)
    ages = []
    for answer in bus.answers:
        assert answer.emergency is not None
        ages.append(answer.emergency.cause_age_ms)
        told = (answer.emergency.code, answer.emergency.reason, answer.emergency.reset_epoch)
        assert told == (ErrorCode.ER1, Reason.VERDICT_BRAKE, 3)
    assert ages == [10 * n for n in range(10)]
    bus.say_mode(Mode.EMERGENCY)
    bus.forget()
    bus.run(500)
    assert all(answer.emergency is None for answer in bus.answers)


def test_the_age_of_the_cause_saturates() -> None:
    bus = pressed(MonitorBus().driving())
    bus.now_ns += 70_000 * MS
    answer = bus.tick()
    assert answer.emergency is not None and answer.emergency.cause_age_ms == 65_535


@pytest.mark.parametrize("way_out", [Mode.MANUAL, Mode.READY])
def test_a_veto_that_no_emergency_answered_is_no_burden_on_the_next_drive(way_out: Mode) -> None:
    bus = pressed(MonitorBus().driving())
    bus.say_mode(way_out)
    assert bus.tick().emergency is None
    bus.say_mode(Mode.MANUAL)
    assert bus.run(1_000).told == NONE
    bus.say_mode(Mode.READY)
    bus.run(20)
    bus.request(Request.ENGAGE)
    bus.tick()
    bus.forget()
    bus.begin_drive()
    assert {answer.told for answer in bus.answers} == {NONE}
    assert all(answer.emergency is None for answer in bus.answers)


def test_a_hazard_under_a_human_driver_denies_and_never_asks_for_the_brake() -> None:
    for mode in (Mode.INIT, Mode.MANUAL, Mode.READY, Mode.EMERGENCY):
        bus = MonitorBus()
        bus.say_mode(mode)
        bus.run(600)
        bus.is_emergency_stop_pressed = True
        bus.muted = {"STEER_STATUS"}
        bus.run(300)
        assert BRAKE not in bus.told_ever()
        assert all(answer.emergency is None for answer in bus.answers)


def test_a_hazard_in_a_controlled_stop_brakes_as_well() -> None:
    bus = MonitorBus().driving()
    bus.say_mode(Mode.STOPPING)
    assert bus.run(100).told == NONE
    pressed(bus)


def test_a_stopped_monitor_still_asks_for_the_brake_it_has_decided_on() -> None:
    bus = MonitorBus().driving()
    bus.extra.append(nmt_frame(NmtCommand.STOP, 5))
    bus.is_emergency_stop_pressed = True
    answer = bus.tick()
    assert answer.verdict is None and answer.emergency is not None


@pytest.mark.parametrize("name", sorted(CYCLE_MS))
def test_any_silence_in_a_drive_brakes_one_cycle_after_its_time_out(name: str) -> None:
    bus = MonitorBus().driving()
    if bus.cycle % 2:
        bus.tick()  # so that every message has just come
    bus.muted = {name}
    bus.forget()
    bus.run(TIMEOUT_MS[name])
    assert bus.told_ever() == {PERMIT}
    assert bus.tick().told == (BRAKE, MonitorReason.FRAME_LATE, CAN_ID[name])


def test_a_dead_supervisor_is_told_to_brake_for_as_long_as_it_is_dead() -> None:
    bus = MonitorBus().driving()
    bus.muted = {"SUPERVISOR_STATE"}
    bus.run(100)
    bus.forget()
    bus.run(2_000)
    assert bus.told_ever() == {BRAKE}
    assert all(answer.emergency is not None for answer in bus.answers)


# The monitor's own cycle -------------------------------------------------------------------------


def test_a_monitor_late_by_more_than_50_ms_brakes() -> None:
    bus = MonitorBus().driving()
    assert bus.tick(6).told == NONE  # 50 ms: an overrun, not late
    bus.tick()
    answer = bus.tick(7)
    assert answer.told == (BRAKE, MonitorReason.LATE, 0)
    emcy = next(frame for frame in answer.frames if frame.can_id == 0x085)
    assert emcy.data == bytes([0x02, 0xFF, 0x81, 2, Reason.LATE, 0b100, 0, 0])


def test_three_overruns_in_a_row_brake_and_two_do_not() -> None:
    bus = MonitorBus().driving()
    for cycles in (2, 2, 1, 2, 2):
        assert bus.tick(cycles).told == NONE
    answer = bus.tick(2)
    assert answer.told == (BRAKE, MonitorReason.LATE, 0)
    emcy = next(frame for frame in answer.frames if frame.can_id == 0x085)
    assert emcy.data[4] == Reason.OVERRUNS


def test_a_late_monitor_denies_when_nothing_drives() -> None:
    bus = MonitorBus().permitted()
    assert bus.tick(8).told == (DENY, MonitorReason.LATE, 0)


# The age of the planner's decision ---------------------------------------------------------------

COMMANDS = ("STEER_COMMAND", "THROTTLE_COMMAND", "BRAKE_COMMAND")
COMMAND_CASES = pytest.mark.parametrize("name", COMMANDS)


def at_command(bus: MonitorBus) -> MonitorBus:
    """The next cycle brings commands."""
    if bus.cycle % 2 == 0:
        bus.tick()
    return bus


@COMMAND_CASES
@pytest.mark.parametrize(("told_ms", "is_young"), [(100.0, True), (105.0, True), (110.0, False)])
def test_a_decision_is_stale_30_ms_after_the_actuators_limit(
    name: str, told_ms: float, is_young: bool
) -> None:
    bus = at_command(MonitorBus().driving())
    bus.say(name, decision_age_ms=told_ms)  # 85 + 30 ms; the frame itself grows 10 ms old
    bus.forget()
    bus.run(200)
    if is_young:
        assert bus.told_ever() == {PERMIT}
        return
    assert bus.answers[0].told == NONE
    assert bus.answers[1].told == (BRAKE, MonitorReason.COMMAND_STALE, CAN_ID[name])
    assert bus.answers[1].verdict is not None
    assert bus.answers[1].verdict.value == round(1000 * 120 / 115)


@COMMAND_CASES
def test_no_decision_at_all_is_stale_once_the_drive_is_old_enough(name: str) -> None:
    bus = MonitorBus()
    bus.say(name, decision_age_ms=NAN)
    bus.permitted()
    bus.say_mode(Mode.READY)
    bus.run(20)
    bus.request(Request.ENGAGE)
    bus.tick()
    bus.say_mode(Mode.AUTOMATIC)
    bus.forget()
    bus.run(120)  # the first of these begins the drive: 110 ms
    assert bus.told_ever() == {PERMIT}
    assert bus.tick().told == (BRAKE, MonitorReason.COMMAND_STALE, CAN_ID[name])


def test_a_controlled_stop_needs_no_decision() -> None:
    bus = MonitorBus().driving()
    for name in COMMANDS:
        bus.say(name, decision_age_ms=NAN)
    bus.say_mode(Mode.STOPPING)
    assert bus.run(2_000).told == NONE


@pytest.mark.parametrize(("told_ms", "is_young"), [(1020.0, True), (1025.0, False)])
def test_no_supervisor_can_stretch_the_limit_beyond_the_vehicles_own(
    told_ms: float, is_young: bool
) -> None:
    bus = MonitorBus()
    bus.say("SUPERVISOR_STATE", decision_age_ms_max=1270.0)  # the vehicle allows 1000 ms
    at_command(bus.driving())
    bus.run(2_000)
    bus.say("STEER_COMMAND", decision_age_ms=told_ms)
    bus.forget()
    bus.run(100)
    assert bus.told_ever() == ({PERMIT} if is_young else {PERMIT, BRAKE})


def test_commands_that_never_came_are_missing_and_stale() -> None:
    bus = MonitorBus()
    bus.muted = set(COMMANDS)
    bus.say_mode(Mode.AUTOMATIC)
    assert bus.run(300).told[0] is BRAKE
    assert bus.answers[-1].emergency is not None


def test_frames_that_arrive_between_two_steps_count_from_their_arrival() -> None:
    bus = MonitorBus().driving()
    bus.muted = {"STEER_STATUS"}
    bus.forget()
    bus.tick()
    frame = bus.frame("STEER_STATUS")
    bus.now_ns += 10 * MS
    bus.cycle += 1
    others = [ReceivedFrame(bus.now_ns, item) for item in bus.due()]
    bus.step([ReceivedFrame(bus.now_ns - 5 * MS, frame), *others])
    bus.run(50)
    assert bus.told_ever() == {PERMIT}  # 55 ms old
    assert bus.tick().told == (BRAKE, MonitorReason.FRAME_LATE, 0x182)  # 65 ms
