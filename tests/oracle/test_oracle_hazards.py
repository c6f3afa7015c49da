"""Hazards: answered in time, ended braked; histories made by hand, at the edges of their times."""

from __future__ import annotations

import pytest

from canbus.frame import Frame
from dbc.messages import Mode, Request
from oracle.hazards import HazardAnswered, HazardEndsBraked
from tests.oracle.history import History

BUDGETS_MS = (20.0, 75.0, 100.0)


def answered(answer_ms: float, budget_ms: float = 100.0) -> list[str]:
    """A fault, and EMERGENCY_BRAKE so long after it."""
    history = History(HazardAnswered).drive()
    history.fault(budget_ns=round(budget_ms * 1e6))
    history.wait(answer_ms)
    history.call_brake()
    history.mode(Mode.EMERGENCY).run(200)
    return history.broken()


@pytest.mark.parametrize("budget_ms", BUDGETS_MS)
def test_an_emergency_brake_at_the_end_of_its_time_answers(budget_ms: float) -> None:
    assert answered(budget_ms, budget_ms) == []


@pytest.mark.parametrize("budget_ms", BUDGETS_MS)
def test_an_emergency_brake_after_its_time_is_late_to_the_nanosecond(budget_ms: float) -> None:
    (text,) = answered(budget_ms + 1e-6, budget_ms)
    assert f"no answer within {budget_ms:.1f} ms" in text


def test_a_hazard_that_nobody_answers_is_told_once() -> None:
    history = History(HazardAnswered).drive()
    history.fault()
    assert history.run(100).broken() == []
    assert len(history.run(500).broken()) == 1


def test_a_servo_sent_to_its_end_answers_without_a_word() -> None:
    history = History(HazardAnswered).drive()
    history.fault()
    history.run(90)
    history.truth |= {"servo_powered": True, "servo_target_ratio": 1.0}
    assert history.run(200).broken() == []


def test_half_a_brake_does_not_answer() -> None:
    history = History(HazardAnswered).drive()
    history.fault()
    history.truth |= {"servo_powered": True, "servo_target_ratio": 0.5}
    assert history.run(200).broken()


def test_a_driver_who_takes_the_car_ends_a_hazard() -> None:
    history = History(HazardAnswered).drive()
    history.fault()
    history.run(50)
    history.truth["relay_closed"] = False
    assert history.mode(Mode.MANUAL).run(500).broken() == []


def test_a_fault_that_goes_before_its_time_needs_no_answer() -> None:
    history = History(HazardAnswered).drive()
    history.fault()
    history.run(90)
    history.fault(is_begin=False)
    assert history.run(500).broken() == []


def test_a_fault_that_goes_after_its_time_needed_one() -> None:
    history = History(HazardAnswered).drive()
    history.fault()
    history.run(110)
    history.fault(is_begin=False)
    assert history.broken()


@pytest.mark.parametrize("is_planners", [True, False])
def test_a_controlled_stop_needs_no_planner(is_planners: bool) -> None:
    before = History(HazardAnswered).drive()
    before.mode(Mode.STOPPING).run(50)
    before.fault(is_planners=is_planners)
    assert (before.run(300).broken() == []) is is_planners
    meanwhile = History(HazardAnswered).drive()
    meanwhile.fault(is_planners=is_planners)
    meanwhile.run(50)
    meanwhile.mode(Mode.STOPPING)
    assert (meanwhile.run(300).broken() == []) is is_planners


@pytest.mark.parametrize(("after_ms", "is_late"), [(149.0, False), (150.1, True)])
def test_a_further_fault_before_the_answer_begins_the_time_anew(
    after_ms: float, is_late: bool
) -> None:
    history = History(HazardAnswered).drive()
    history.fault()
    history.wait(50)
    history.fault()
    history.wait(after_ms - 50)
    history.call_brake()
    assert bool(history.run(50).broken()) is is_late


def test_a_further_fault_after_the_time_excuses_nothing() -> None:
    history = History(HazardAnswered).drive()
    history.fault()
    history.run(110)
    history.fault()
    history.call_brake()
    assert len(history.run(50).broken()) == 1


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.READY])
def test_a_fault_under_a_human_needs_no_answer(mode: Mode) -> None:
    history = History(HazardAnswered)
    history.mode(mode).run(500)
    history.fault()
    assert history.run(500).broken() == []


def test_a_fault_without_a_time_needs_no_answer() -> None:
    history = History(HazardAnswered).drive()
    history.fault(budget_ns=None)
    assert history.run(500).broken() == []


@pytest.mark.parametrize(("answer_ms", "is_late"), [(21.0, False), (21.1, True)])
def test_the_emergency_stop_is_a_sensed_cause(answer_ms: float, is_late: bool) -> None:
    history = History(HazardAnswered).drive()
    history.look(emergency_stop_pressed=True)
    history.wait(answer_ms)
    history.call_brake()
    assert bool(history.mode(Mode.EMERGENCY).run(100).broken()) == is_late


def test_failsafe_and_the_planners_request_are_sensed_causes() -> None:
    for is_failsafe in (True, False):
        history = History(HazardAnswered).drive()
        if is_failsafe:
            history.hear(Frame(0x001), "stranger")
        else:
            history.request(Request.EMERGENCY_STOP)
        (text,) = history.run(50).broken()
        assert "21.0 ms" in text


def test_a_sensed_cause_has_the_hazards_time_while_something_is_faulty() -> None:
    history = History(HazardAnswered).drive()
    history.fault(budget_ns=None)
    history.look(emergency_stop_pressed=True)
    assert history.run(100).broken() == []
    assert history.run(20).broken()


# The end -----------------------------------------------------------------------------------------


def ended(full_ms: float, stand_ms: float) -> list[str]:
    """A fault at 5 m/s; the brake is full, and the car stands, so long after it."""
    history = History(HazardEndsBraked).drive(5.0)
    history.fault()
    history.run(50)
    history.call_brake()
    history.mode(Mode.EMERGENCY)
    history.truth |= {"servo_powered": True, "servo_target_ratio": 1.0}
    history.run(full_ms - 60)
    history.truth["servo_position_ratio"] = 0.9
    history.run(stand_ms - full_ms)
    history.truth["speed_mps"] = 0.0
    history.run(3000)
    return history.broken()


def test_full_brake_and_standstill_in_their_times_end_a_hazard() -> None:
    assert ended(full_ms=400, stand_ms=2400) == []  # 100 + 290 and a look; 5 m/s at 2.5 m/s2


def test_a_brake_that_comes_late_is_told() -> None:
    (text,) = ended(full_ms=420, stand_ms=1000)
    assert "brake at 0.00 after 410.0 ms" in text


def test_a_car_that_does_not_stop_is_told() -> None:
    (text,) = ended(full_ms=350, stand_ms=2420)
    assert "still 5.00 m/s" in text


def test_reactions_tell_every_time_from_the_beginning() -> None:
    history = History(HazardEndsBraked).drive(5.0)
    history.fault()
    history.wait(30)
    history.call_brake()
    history.mode(Mode.EMERGENCY)
    history.truth |= {"servo_powered": True, "servo_target_ratio": 1.0}
    history.run(270)
    history.truth["servo_position_ratio"] = 0.95
    history.run(700)
    history.truth["speed_mps"] = 0.0
    history.run(100)
    (reaction,) = history.oracle.finish(history.now_ns).reactions
    assert (reaction.kind, reaction.target) == ("trouble", "part")
    times_ms = reaction.emergency_ms, reaction.setpoint_ms, reaction.brake_ms
    assert times_ms == (30.0, 40.0, 310.0)
    assert reaction.standstill_ms == 1010.0


def test_what_never_came_is_none() -> None:
    history = History(HazardAnswered).drive()
    history.fault()
    (reaction,) = history.run(300).oracle.finish(history.now_ns).reactions
    assert reaction.emergency_ms is None and reaction.standstill_ms is None
