"""The driver: histories made by hand, at the edges of their times."""

from __future__ import annotations

from typing import Any

import pytest

from dbc.messages import ErrorCode, Mode
from oracle.driver import (
    DriverSteersInEmergency,
    DriverWins,
    NothingMovesUnderDriver,
    RelayOpenUnderDriver,
    SteeringCoasts,
)
from tests.oracle.history import History

TOUCHES: dict[str, dict[str, float]] = {
    "wheel to the left": {"steering_torque_nm": 3.3},
    "wheel to the right": {"steering_torque_nm": -3.3},
    "throttle pedal": {"throttle_pedal_ratio": 0.07},
    "brake pedal": {"brake_pedal_ratio": 0.08},
}
UNTOUCHED = dict.fromkeys(("steering_torque_nm", "throttle_pedal_ratio", "brake_pedal_ratio"), 0.0)


# He wins -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("control", TOUCHES)
def test_manual_100_ms_after_a_touch_is_in_time(control: str) -> None:
    history = History(DriverWins).drive()
    history.look(**TOUCHES[control])
    history.run(90).wait(10)
    assert history.mode(Mode.MANUAL).look(relay_closed=False).run(500).broken() == []


@pytest.mark.parametrize("control", TOUCHES)
def test_a_relay_that_is_closed_later_is_told_once(control: str) -> None:
    history = History(DriverWins).drive()
    history.look(**TOUCHES[control])
    assert history.run(100).broken() == []
    (text,) = history.run(500).broken()
    assert "touched for 110.0 ms" in text


def test_a_touch_of_40_ms_is_none_and_one_of_50_counts_though_it_ends() -> None:
    for touch_ms, is_broken in ((40, False), (50, True)):
        history = History(DriverWins).drive()
        history.look(**TOUCHES["throttle pedal"])
        history.run(touch_ms)
        history.look(**UNTOUCHED)
        assert bool(history.run(500).broken()) == is_broken


@pytest.mark.parametrize(
    "below", [{"steering_torque_nm": 3.2}, {"throttle_pedal_ratio": 0.06},
              {"brake_pedal_ratio": 0.57, "servo_position_ratio": 0.5}],
)
def test_what_is_not_above_the_threshold_for_certain_is_no_touch(below: dict[str, float]) -> None:
    history = History(DriverWins).drive()
    history.look(**below)
    assert history.run(500).broken() == []


def test_while_something_is_faulty_he_wins_100_ms_after_the_debounced_touch() -> None:
    history = History(DriverWins).drive()
    history.fault(budget_ns=None)
    history.look(**TOUCHES["brake pedal"])
    assert history.run(150).broken() == []
    assert history.run(10).broken()


def test_an_emergency_brake_outranks_him() -> None:
    history = History(DriverWins).drive().emergency()
    history.look(**TOUCHES["brake pedal"])
    assert history.run(500).broken() == []


def test_a_touch_from_before_the_drive_counts_from_its_beginning() -> None:
    history = History(DriverWins).run(500)
    history.look(**TOUCHES["throttle pedal"])
    history.run(1000)
    history.truth["relay_closed"] = True
    assert history.mode(Mode.AUTOMATIC).run(110).broken() == []
    assert history.run(10).broken()


# He steers ---------------------------------------------------------------------------------------


def test_the_wheel_is_his_150_ms_after_his_touch_in_an_emergency() -> None:
    history = History(DriverSteersInEmergency).drive().emergency()
    history.truth["steering_motor_powered"] = True
    history.look(steering_torque_nm=6.0)
    assert history.run(150).broken() == []
    assert history.run(10).broken()


def test_the_wheel_stays_his_when_he_lets_go() -> None:
    history = History(DriverSteersInEmergency).drive().emergency()
    history.truth["steering_motor_powered"] = True
    history.look(steering_torque_nm=6.0)
    history.run(100)
    history.look(steering_torque_nm=0.0, steering_motor_powered=False)
    assert history.run(500).broken() == []
    history.truth["steering_motor_powered"] = True
    assert history.run(10).broken()


def test_the_wheel_may_be_held_without_his_touch() -> None:
    history = History(DriverSteersInEmergency).drive().emergency()
    history.truth["steering_motor_powered"] = True
    assert history.run(1000).broken() == []


# ER4 and ER6 -------------------------------------------------------------------------------------


def coasting(history: History, is_powered: bool, run_ms: int) -> list[str]:
    history.truth["steering_motor_powered"] = is_powered
    return history.run(run_ms).broken()


@pytest.mark.parametrize("code", [4, 6])
@pytest.mark.parametrize("how", ["told", "present"])
def test_a_motor_that_is_closed_25_ms_after_er4_or_er6_is_told(code: int, how: str) -> None:
    history = History(SteeringCoasts).drive()
    values: dict[str, Any] = {f"er{code}": True} if how == "told" else {"present_codes": 1 << code}
    history.change("STEER_DRIVER", **values)
    assert coasting(history, True, 30) == []
    assert coasting(history, True, 10)


@pytest.mark.parametrize("code", [1, 2, 3, 5])
def test_other_codes_leave_the_motor_alone(code: int) -> None:
    history = History(SteeringCoasts).drive()
    history.change("STEER_DRIVER", **{f"er{code}": True, "present_codes": 1 << code})
    assert coasting(history, True, 500) == []


def test_an_emergency_brake_with_er4_is_enough() -> None:
    for code, is_broken in ((ErrorCode.ER4, True), (ErrorCode.ER1, False)):
        history = History(SteeringCoasts).drive()
        history.call_brake("STEER", code)
        del history.says["STEER_DRIVER"]
        assert bool(coasting(history, True, 100)) == is_broken


def test_an_open_motor_is_well_and_so_is_one_after_the_codes_have_gone() -> None:
    history = History(SteeringCoasts).drive()
    history.change("STEER_DRIVER", er6=True)
    assert coasting(history, False, 500) == []
    history.change("STEER_DRIVER", er6=False)
    assert coasting(history, True, 500) == []


# The relay, and what moves -----------------------------------------------------------------------


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.READY])
def test_a_closed_relay_under_a_human_is_told(mode: Mode) -> None:
    history = History(RelayOpenUnderDriver)
    history.run(500).mode(mode)
    history.truth["relay_closed"] = True
    assert history.run(40).broken()


def test_the_relay_closes_a_little_before_the_word_automatic() -> None:
    history = History(RelayOpenUnderDriver).ready()
    history.look(relay_closed=True)
    assert history.run(10).mode(Mode.AUTOMATIC).run(500).broken() == []


def test_the_relay_opens_with_the_mode() -> None:
    history = History(RelayOpenUnderDriver).drive()
    history.mode(Mode.MANUAL).run(10)
    history.look(relay_closed=False)
    assert history.run(500).broken() == []


def test_a_relay_that_a_restarted_supervisor_found_closed_is_well() -> None:
    history = History(RelayOpenUnderDriver).drive()
    assert history.mode(Mode.INIT).run(1000).broken() == []


@pytest.mark.parametrize(
    ("truth", "word"),
    [
        ({"servo_powered": True}, "servo has power"),
        ({"steering_motor_powered": True}, "steering motor has power"),
        ({"servo_position_ratio": 0.1}, "servo is at 0.10"),
        ({"motor_torque_nm": 5.0}, "motor gives 5.0"),
        ({"motor_torque_nm": -5.0}, "motor gives -5.0"),
        ({"motor_torque_nm": 70.0, "throttle_pedal_ratio": 0.5}, "motor gives 70.0"),
    ],
)
def test_whatever_moves_under_a_driver_is_told(truth: dict[str, float], word: str) -> None:
    history = History(NothingMovesUnderDriver).run(1000)
    history.truth |= truth
    (text,) = history.run(500).broken()
    assert word in text


def test_his_own_pedal_drives_and_for_a_moment_after_it() -> None:
    history = History(NothingMovesUnderDriver).run(1000)
    history.truth |= {"motor_torque_nm": 60.0, "throttle_pedal_ratio": 0.5}
    history.run(1000)
    history.truth["throttle_pedal_ratio"] = 0.0
    history.run(500)
    history.truth["motor_torque_nm"] = 0.0
    assert history.run(1000).broken() == []


def test_the_servo_returns_by_its_spring() -> None:
    for release_ms, is_broken in ((320, False), (340, True)):
        history = History(NothingMovesUnderDriver).drive()
        history.truth |= {"servo_position_ratio": 0.9, "relay_closed": False}
        history.mode(Mode.MANUAL).run(release_ms)
        history.truth["servo_position_ratio"] = 0.0
        assert bool(history.run(500).broken()) == is_broken


@pytest.mark.parametrize(
    ("name", "signal"),
    [("STEER_STATUS", "applied_steering_wheel_angle_rad"),
     ("THROTTLE_STATUS", "applied_wheel_speed_radps"), ("BRAKE_STATUS", "applied_position_ratio")],
)
def test_a_setpoint_applied_in_manual_is_told(name: str, signal: str) -> None:
    history = History(NothingMovesUnderDriver).run(500)
    history.change(name, **{signal: 0.5})
    (text,) = history.run(500).broken()
    assert "applies 0.5 in MANUAL" in text


def test_a_setpoint_applied_in_manual_while_something_is_faulty_is_not() -> None:
    history = History(NothingMovesUnderDriver).run(500)
    history.fault(budget_ns=None)
    history.change("BRAKE_STATUS", applied_position_ratio=1.0)
    assert history.run(500).broken() == []


def test_a_relay_that_closes_a_moment_before_the_frame_that_says_so_is_well() -> None:
    history = History(RelayOpenUnderDriver)
    history.run(500).mode(Mode.READY).run(100)
    history.look(relay_closed=True)
    history.mode(Mode.AUTOMATIC)
    assert history.run(500).broken() == []
