"""Braking: no drive, kept on, replaced by regeneration, and never without a reason."""

from __future__ import annotations

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame
from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import Mode, NodeState, Request, Verdict
from oracle.braking import (
    BrakeKept,
    NoDriveWhileBraking,
    NoFalseEmergency,
    RegenerationReplacesServo,
)
from oracle.settings import Settings
from tests.oracle.history import NS_PER_MS, History
from vehicles import load_vehicle

# No drive torque ---------------------------------------------------------------------------------


def torque_after(torque_nm: float, after_ms: float) -> list[str]:
    """Torque of 40 N.m until so long after the call, then another; gone 0.6 s after the call."""
    history = History(NoDriveWhileBraking).drive()
    history.truth["drive_torque_nm"] = 40.0
    history.call_brake()
    history.mode(Mode.EMERGENCY).run(after_ms)
    history.truth["drive_torque_nm"] = torque_nm
    history.run(600 - after_ms)
    history.truth["drive_torque_nm"] = 0.0
    return history.run(1000).broken()


@pytest.mark.parametrize(("after_ms", "is_broken"), [(110, False), (130, True)])
def test_drive_torque_may_rise_until_everybody_has_noticed(after_ms: int, is_broken: bool) -> None:
    assert bool(torque_after(60.0, after_ms)) == is_broken


def test_drive_torque_that_fades_is_well() -> None:
    assert torque_after(20.0, 200) == []


def test_regeneration_that_fades_uncovers_what_is_left_of_the_drive_torque() -> None:
    history = History(NoDriveWhileBraking).drive()
    history.truth |= {"drive_torque_nm": 20.0, "motor_torque_nm": -40.0}
    history.call_brake()
    history.mode(Mode.EMERGENCY).run(200)
    history.truth |= {"drive_torque_nm": 5.0, "motor_torque_nm": 5.0}
    assert history.run(400).broken() == []


def test_drive_torque_must_be_gone_in_the_end() -> None:
    history = History(NoDriveWhileBraking).drive()
    history.truth["drive_torque_nm"] = 3.0
    history.call_brake()
    assert history.mode(Mode.EMERGENCY).run(670).broken() == []
    (text,) = history.run(20).broken()
    assert "3.0 N.m 680.0 ms after" in text


def test_regeneration_and_a_driver_in_manual_are_no_drive_torque() -> None:
    history = History(NoDriveWhileBraking).drive().emergency()
    history.truth["motor_torque_nm"] = -60.0
    history.run(2000).mode(Mode.MANUAL, reset_epoch=1)
    history.truth |= {"drive_torque_nm": 50.0, "relay_closed": False, "throttle_pedal_ratio": 0.5}
    assert history.run(1000).broken() == []


# Kept --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [{"servo_powered": False}, {"servo_target_ratio": 0.9}, {"servo_target_ratio": 0.0}],
)
def test_a_brake_released_in_a_moving_emergency_is_told(change: dict[str, float]) -> None:
    history = History(BrakeKept).drive().emergency()
    assert history.run(1000).broken() == []
    history.truth |= change
    assert history.run(30).broken() == []
    assert history.run(10).broken()


def test_a_brake_that_is_not_applied_at_all_is_told_after_130_ms() -> None:
    history = History(BrakeKept).drive()
    history.call_brake()
    history.mode(Mode.EMERGENCY)
    assert history.run(130).broken() == []
    assert history.run(10).broken()


def test_er3_may_release_a_standing_car() -> None:
    history = History(BrakeKept).drive().emergency().stand()
    history.truth["servo_target_ratio"] = 0.0
    assert history.run(5000).broken() == []


def test_a_resting_car_that_rolls_is_braked_within_130_ms() -> None:
    history = History(BrakeKept).drive().emergency().stand()
    history.truth |= {"servo_target_ratio": 0.0, "speed_mps": -0.3}
    assert history.run(130).broken() == []
    assert history.run(20).broken()


def test_an_emergency_without_a_supervisor_keeps_the_brake_too() -> None:
    history = History(BrakeKept).drive()
    history.call_brake("BRAKE")
    del history.says["SUPERVISOR_STATE"]
    assert history.run(200).broken()


def test_a_brake_that_a_human_took_over_is_his() -> None:
    history = History(BrakeKept).drive().emergency()
    history.truth |= {"servo_powered": False, "relay_closed": False}
    assert history.mode(Mode.MANUAL, reset_epoch=1).run(1000).broken() == []


# Regeneration ------------------------------------------------------------------------------------


def dead_servo(torque_nm: float, speed_mps: float = 5.0) -> History:
    history = History(RegenerationReplacesServo).drive(speed_mps).emergency()
    history.truth["motor_torque_nm"] = torque_nm
    return history


def test_a_dead_servo_without_regeneration_is_told_when_it_is_due() -> None:
    history = dead_servo(0.0)
    assert history.run(690).broken() == []  # 100 + 1.3 x 290 + 250, of which 20 are over
    assert history.run(40).broken()


@pytest.mark.parametrize(("torque_nm", "speed_mps"), [(-60.0, 5.0), (0.0, 0.9)])
def test_regeneration_or_walking_pace_are_well(torque_nm: float, speed_mps: float) -> None:
    assert dead_servo(torque_nm, speed_mps).run(2000).broken() == []


@pytest.mark.parametrize(("torque_nm", "is_broken"), [(60.0, False), (0.0, True), (-60.0, True)])
def test_backwards_it_is_the_torque_forwards_that_brakes(torque_nm: float, is_broken: bool) -> None:
    assert bool(dead_servo(torque_nm, -2.0).run(2000).broken()) == is_broken


def test_what_counts_as_torque_goes_with_the_vehicles_own() -> None:
    tabby, baja = (Settings.of(load_vehicle(name)) for name in ("tabby_evo", "baja_5b"))
    assert (tabby.drive_torque_nm_max, tabby.regenerating_nm) == (2.0, 5.0)
    assert baja.drive_torque_nm_max < 0.02 * 0.8  # its whole torque
    assert baja.regenerating_nm < 0.1 * 0.4


def test_a_servo_that_brakes_needs_no_regeneration() -> None:
    history = dead_servo(0.0)
    history.truth["servo_position_ratio"] = 0.6
    assert history.run(2000).broken() == []


def test_a_throttle_node_that_is_not_heard_cannot_regenerate() -> None:
    history = dead_servo(0.0)
    del history.says["THROTTLE_STATUS"]
    assert history.run(2000).broken() == []


# Without a reason --------------------------------------------------------------------------------


def test_a_brake_without_a_reason_is_told_once_with_its_sender() -> None:
    history = History(NoFalseEmergency).drive()
    history.call_brake("THROTTLE")
    history.mode(Mode.EMERGENCY).run(3000)
    (text,) = history.broken()
    assert text.startswith("THROTTLE_EMERGENCY_BRAKE of Throttle in AUTOMATIC")


def test_a_veto_without_a_reason_is_told() -> None:
    history = History(NoFalseEmergency).drive()
    assert history.change("SAFETY_VERDICT", verdict=Verdict.BRAKE).run(10).broken()


def test_an_emergency_without_a_frame_is_told() -> None:
    assert History(NoFalseEmergency).drive().mode(Mode.EMERGENCY).run(10).broken()


def reasons() -> dict[str, object]:
    def forged(history: History) -> None:
        message = history.says["BRAKE_STATUS"]
        history.hear(encode(SPEC_OF_NAME["BRAKE_STATUS"], message, 3), "stranger")

    return {
        "fault": lambda h: h.fault(),
        "emergency stop": lambda h: h.look(emergency_stop_pressed=True),
        "failsafe": lambda h: h.hear(Frame(0x001), "stranger"),
        "request": lambda h: h.request(Request.EMERGENCY_STOP),
        "nmt": lambda h: h.hear(nmt_frame(NmtCommand.STOP, 3), "stranger"),
        "forged": forged,
    }


@pytest.mark.parametrize("reason", reasons())
def test_every_reason_explains_a_brake_for_its_time(reason: str) -> None:
    for late_ms, is_broken in ((2000, False), (2010, True)):
        history = History(NoFalseEmergency).drive()
        reasons()[reason](history)  # type: ignore[operator]
        if reason == "fault":
            history.fault(is_begin=False)
        history.truth["emergency_stop_pressed"] = False
        history.run(late_ms)
        history.call_brake()
        assert bool(history.broken()) == is_broken, late_ms


def test_a_fault_that_lasts_explains_a_brake_whenever_it_comes() -> None:
    history = History(NoFalseEmergency).drive()
    history.fault(budget_ns=None)
    history.run(10_000)
    history.call_brake()
    assert history.broken() == []


def test_a_fault_that_must_not_stop_the_car_explains_nothing() -> None:
    history = History(NoFalseEmergency).drive()
    history.fault(budget_ns=None, may_stop=False)
    history.call_brake()
    assert history.broken()


def test_a_strangers_frame_that_is_broken_explains_nothing() -> None:
    history = History(NoFalseEmergency).drive()
    history.hear(Frame(0x183, bytes(8)), "stranger")
    history.call_brake()
    assert history.broken()


@pytest.mark.parametrize("is_hazard", [True, False])
def test_a_touch_explains_a_brake_by_the_vehicles_policy_alone(is_hazard: bool) -> None:
    history = History(NoFalseEmergency, is_touch_a_hazard=is_hazard).drive()
    history.look(steering_torque_nm=6.0)
    history.call_brake()
    assert bool(history.broken()) != is_hazard


def test_the_second_emergency_needs_a_reason_of_its_own() -> None:
    history = History(NoFalseEmergency, memory_ns=500 * NS_PER_MS).drive().emergency().stand()
    history.mode(Mode.MANUAL, reset_epoch=1).node_states(NodeState.RELEASED).run(1000)
    assert history.broken() == []
    history.call_brake()
    assert history.mode(Mode.READY).run(10).mode(Mode.AUTOMATIC).run(500)
    history.call_brake()
    assert history.broken()
