"""Requests on their way to the supervisor, and the gateway's own emergency brake."""

from __future__ import annotations

import itertools

import pytest

from canbus.frame import Frame
from dbc.messages import (
    EmergencyBrake,
    ErrorCode,
    Inhibit,
    Mode,
    ModeRequest,
    Reason,
    Request,
)
from gateway.core import PlannerInputs
from tests.gateway.scripted import MS, Rig, Sent, named


def ask(rig: Rig, request: Request) -> list[Sent]:
    return rig.poke(PlannerInputs(request=request))


def requests(sent: list[Sent]) -> list[ModeRequest]:
    return [item.content for item in named(sent, "MODE_REQUEST")]


def ready(mode: Mode = Mode.READY, period_ms: int = 20) -> Rig:
    rig = Rig(period_ms=period_ms).start()
    rig.mode(mode)
    rig.run(40)
    rig.sent.clear()
    rig.events.clear()
    return rig


def test_nothing_is_requested_unasked() -> None:
    assert requests(ready().run(500)) == []


def test_request_leaves_at_once_with_the_promised_period_and_a_new_sequence() -> None:
    rig = ready(period_ms=50)
    assert requests(ask(rig, Request.ENGAGE)) == [
        ModeRequest(request=Request.ENGAGE, planner_period_ms=50, sequence=1)
    ]
    rig.run(50)
    assert requests(ask(rig, Request.DISENGAGE)) == [
        ModeRequest(request=Request.DISENGAGE, planner_period_ms=50, sequence=2)
    ]


def test_pending_request_is_repeated_every_20_ms_with_the_same_sequence() -> None:
    rig = ready()
    ask(rig, Request.ENGAGE)
    rig.run(200)
    sent = named(rig.sent, "MODE_REQUEST")
    assert {item.content.sequence for item in sent} == {1}
    assert {b.time_ns - a.time_ns for a, b in itertools.pairwise(sent)} == {20 * MS}


def test_sequence_goes_round_after_255() -> None:
    rig = ready()
    for _ in range(256):
        ask(rig, Request.RESET)
        rig.run(10)
    assert requests(rig.sent)[-1].sequence == 0


def test_second_request_in_the_same_instant_waits_for_the_minimum_interval() -> None:
    rig = ready()
    ask(rig, Request.ENGAGE)
    rig.now_ns += 3 * MS
    assert requests(ask(rig, Request.RESET)) == []
    assert [r.request for r in requests(rig.step())] == [Request.RESET]


def test_engage_ends_with_automatic() -> None:
    rig = ready()
    ask(rig, Request.ENGAGE)
    rig.run(20)
    rig.mode(Mode.AUTOMATIC)
    rig.step()
    assert rig.state().pending_request is Request.NONE
    assert requests(rig.run(100)) == []


def test_engage_lapses_after_two_seconds() -> None:
    rig = ready()
    ask(rig, Request.ENGAGE)
    rig.run(1990)
    assert rig.state().pending_request is Request.ENGAGE
    rig.run(20)
    assert rig.state().pending_request is Request.NONE


def test_engage_is_withdrawn_by_none() -> None:
    rig = ready()
    ask(rig, Request.ENGAGE)
    rig.run(10)
    withdrawals = requests(ask(rig, Request.NONE)) + requests(rig.run(200))
    assert [(r.request, r.sequence) for r in withdrawals] == [(Request.NONE, 2)] * 3
    assert rig.state().pending_request is Request.NONE


def test_withdrawing_nothing_says_nothing() -> None:
    rig = ready()
    assert requests(ask(rig, Request.NONE) + rig.run(100)) == []


def test_new_request_ends_the_withdrawal_of_the_last_one() -> None:
    rig = ready()
    ask(rig, Request.ENGAGE)
    rig.run(10)
    ask(rig, Request.NONE)
    rig.run(10)
    ask(rig, Request.ENGAGE)
    assert {r.request for r in requests(rig.run(200))} == {Request.ENGAGE}


def test_engage_waits_for_nmt_start() -> None:
    rig = Rig()
    rig.run(20)
    ask(rig, Request.ENGAGE)
    assert requests(rig.run(100)) == []
    assert rig.state().pending_request is Request.ENGAGE


def test_engage_waits_while_somebody_else_sends_with_our_identifier() -> None:
    rig = ready()
    rig.extra.append(Frame(0x202, bytes(8)))
    rig.step()
    ask(rig, Request.ENGAGE)
    assert requests(rig.run(500)) == []
    assert len(requests(rig.run(600))) > 0


def test_disengage_goes_on_through_the_controlled_stop() -> None:
    rig = ready(Mode.AUTOMATIC)
    ask(rig, Request.DISENGAGE)
    rig.run(30)
    rig.mode(Mode.STOPPING)
    assert len(requests(rig.run(3000))) == 150
    rig.mode(Mode.READY)
    rig.step()
    assert rig.state().pending_request is Request.NONE


def test_disengage_is_sent_before_nmt_start_too() -> None:
    rig = Rig()
    rig.run(20)
    assert [r.request for r in requests(ask(rig, Request.DISENGAGE))] == [Request.DISENGAGE]


def test_disengage_is_not_answered_by_a_state_the_supervisor_sent_before_hearing_it() -> None:
    rig = ready()
    ask(rig, Request.DISENGAGE)
    rig.run(20)
    assert rig.state().pending_request is Request.DISENGAGE
    rig.run(10)
    assert rig.state().pending_request is Request.NONE


def test_reset_ends_with_a_new_epoch() -> None:
    rig = ready(Mode.EMERGENCY)
    ask(rig, Request.RESET)
    rig.run(20)
    assert rig.state().pending_request is Request.RESET
    rig.mode(Mode.MANUAL, reset_epoch=4)
    rig.step()
    assert rig.state().pending_request is Request.NONE


def test_reset_lapses_after_one_second() -> None:
    rig = ready(Mode.EMERGENCY)
    ask(rig, Request.RESET)
    rig.run(990)
    assert rig.state().pending_request is Request.RESET
    rig.run(20)
    assert rig.state().pending_request is Request.NONE


def test_reset_cannot_be_confirmed_by_an_epoch_never_seen_before() -> None:
    rig = Rig()
    rig.muted.add("Supervisor")
    rig.start()
    ask(rig, Request.RESET)
    rig.muted.clear()
    rig.run(100)
    assert rig.state().pending_request is Request.RESET


def test_emergency_stop_sends_failsafe_once_and_its_own_brake_every_10_ms() -> None:
    rig = ready(Mode.AUTOMATIC)
    first = ask(rig, Request.EMERGENCY_STOP)
    assert [item.name for item in first] == ["FAILSAFE", "GATEWAY_EMERGENCY_BRAKE", "MODE_REQUEST"]
    assert first[1].content == EmergencyBrake(
        code=ErrorCode.ER1, reason=Reason.REQUESTED, cause_age_ms=0, reset_epoch=3
    )
    rig.run(50)
    assert len(named(rig.sent, "FAILSAFE")) == 1
    assert [b.content.cause_age_ms for b in named(rig.sent, "GATEWAY_EMERGENCY_BRAKE")] == [
        *(0, 10, 20, 30, 40, 50)
    ]
    assert str(rig.state().emergency_reason) == "Gateway: the planner asked for it (ER1)"


def test_emergency_stop_ends_with_emergency() -> None:
    rig = ready(Mode.AUTOMATIC)
    ask(rig, Request.EMERGENCY_STOP)
    rig.run(20)
    rig.mode(Mode.EMERGENCY)
    assert {item.name for item in rig.run(100)}.isdisjoint(
        {"FAILSAFE", "GATEWAY_EMERGENCY_BRAKE", "MODE_REQUEST"}
    )
    assert rig.state().pending_request is Request.NONE


def test_unacknowledged_brake_ends_after_200_ms_and_the_request_goes_on() -> None:
    rig = ready(Mode.AUTOMATIC)
    ask(rig, Request.EMERGENCY_STOP)
    rig.muted.add("Supervisor")
    rig.run(3000)
    assert len(named(rig.sent, "GATEWAY_EMERGENCY_BRAKE")) == 21
    assert rig.state().pending_request is Request.EMERGENCY_STOP


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.INIT])
def test_emergency_stop_under_a_driver_is_a_request_alone_and_lapses(mode: Mode) -> None:
    rig = ready(mode)
    ask(rig, Request.EMERGENCY_STOP)
    rig.run(1500)
    assert named(rig.sent, "FAILSAFE") == named(rig.sent, "GATEWAY_EMERGENCY_BRAKE") == []
    assert len(requests(rig.sent)) == 50
    assert rig.state().pending_request is Request.NONE


def test_emergency_stop_under_a_driver_whose_supervisor_falls_silent_still_does_not_brake() -> None:
    rig = ready(Mode.MANUAL)
    rig.muted.add("Supervisor")
    rig.run(500)
    ask(rig, Request.EMERGENCY_STOP)
    rig.run(100)
    assert named(rig.sent, "FAILSAFE") == []


def test_emergency_stop_in_ready_uses_the_failsafe_frame() -> None:
    rig = ready(Mode.READY)
    assert len(named(ask(rig, Request.EMERGENCY_STOP), "FAILSAFE")) == 1


def test_emergency_stop_brakes_when_no_supervisor_was_ever_heard() -> None:
    rig = Rig()
    rig.muted.add("Supervisor")
    rig.start()
    (brake,) = named(ask(rig, Request.EMERGENCY_STOP), "GATEWAY_EMERGENCY_BRAKE")
    assert brake.content.reset_epoch == 0


def test_emergency_stop_in_an_emergency_adds_nothing_but_the_request() -> None:
    rig = ready(Mode.EMERGENCY)
    assert [item.name for item in ask(rig, Request.EMERGENCY_STOP)] == ["MODE_REQUEST"]
    rig.run(20)
    assert rig.state().pending_request is Request.NONE


def test_pressing_twice_is_one_emergency_brake() -> None:
    rig = ready(Mode.AUTOMATIC)
    ask(rig, Request.EMERGENCY_STOP)
    rig.run(20)
    assert named(ask(rig, Request.EMERGENCY_STOP), "FAILSAFE") == []
    rig.run(500)
    assert len(named(rig.sent, "GATEWAY_EMERGENCY_BRAKE")) == 21


@pytest.mark.parametrize("request_", [Request.ENGAGE, Request.NONE, Request.RESET])
def test_pending_emergency_stop_yields_to_nothing(request_: Request) -> None:
    rig = ready(Mode.AUTOMATIC)
    ask(rig, Request.EMERGENCY_STOP)
    ask(rig, request_)
    assert rig.state().pending_request is Request.EMERGENCY_STOP
    assert rig.events[-1].text == f"{request_.name} dropped: an emergency stop is pending"
    rig.run(50)
    assert {r.request for r in requests(rig.sent)} == {Request.EMERGENCY_STOP}


def test_brake_is_not_repeated_closer_than_the_dbc_allows() -> None:
    rig = ready(Mode.AUTOMATIC)
    ask(rig, Request.EMERGENCY_STOP)
    rig.now_ns += 3 * MS
    assert rig.poke(PlannerInputs()) == []


def test_old_inhibit_says_what_is_missing_while_a_request_is_pending() -> None:
    rig = ready(Mode.MANUAL)
    rig.set("SUPERVISOR_STATE", inhibit=Inhibit.PRESS_BUTTON)
    ask(rig, Request.ENGAGE)
    rig.run(20)
    assert rig.state().why_not_engaged == "press the Auto/Manual button"
