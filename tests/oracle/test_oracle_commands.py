"""Commands, nodes and the report: histories made by hand."""

from __future__ import annotations

from dataclasses import replace
from math import nan
from typing import Any

import pytest

from canbus.frame import Frame
from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import (
    BrakeCommand,
    Mode,
    NodeState,
    SteerCommand,
    ThrottleCommand,
)
from oracle.commands import NoOldDecision, OnlyIntactCommandsApplied, PathBounded
from oracle.judge import KEPT_MAX, PROPERTIES, Oracle
from oracle.nodes import SILENT_NS_OF, OneSender, RejoinsByRearming
from oracle.property import Property
from tests.oracle.history import REMOTE, TABBY, History
from tests.vehicles.drive_car import CAR, LEFT, RIGHT, STEER

APPLIED = {
    "STEER": ("applied_steering_wheel_angle_rad", "steering_wheel_angle_rad", 2.0),
    "THROTTLE": ("applied_wheel_speed_radps", "wheel_speed_radps", 20.0),
    "BRAKE": ("applied_position_ratio", "position_ratio", 0.6),
}
BAD_COMMANDS: dict[str, Any] = {
    "STEER": SteerCommand(steering_wheel_angle_rad=2.0, decision_age_ms=0.0),
    "THROTTLE": ThrottleCommand(wheel_speed_radps=20.0, decision_age_ms=0.0),
    "BRAKE": BrakeCommand(position_ratio=0.6, decision_age_ms=0.0),
}


def following(axis: str) -> History:
    """An engaged car whose axis applies zero, as commanded."""
    history = History(OnlyIntactCommandsApplied).drive()
    signal, _, _ = APPLIED[axis]
    return history.change(f"{axis}_STATUS", **{signal: 0.0}).run(500)


def bad_frame(history: History, axis: str, how: str) -> Frame:
    """A command that fails its protection."""
    command = f"{axis}_COMMAND"
    spec = SPEC_OF_NAME[command]
    counter = history._counters[command]
    if how == "counter":
        return encode(spec, BAD_COMMANDS[axis], (counter - 1) % 15)
    if how == "jump":
        return encode(spec, BAD_COMMANDS[axis], (counter + 5) % 15)
    frame = encode(spec, BAD_COMMANDS[axis], counter)
    if how == "kind":
        return Frame(frame.can_id, b"", REMOTE)
    if how == "length":
        return Frame(frame.can_id, frame.data[:7])
    return Frame(frame.can_id, bytes([frame.data[0] ^ 1]) + frame.data[1:])


@pytest.mark.parametrize("how", ["crc", "counter", "jump", "length"])
@pytest.mark.parametrize("axis", APPLIED)
def test_a_setpoint_from_a_command_that_fails_its_protection_is_told(axis: str, how: str) -> None:
    history = following(axis)
    history.hear(bad_frame(history, axis, how), "Gateway")
    signal, _, setpoint = APPLIED[axis]
    history.change(f"{axis}_STATUS", **{signal: 0.1 * setpoint})
    (text,) = history.run(10).broken()
    assert f"{axis}_STATUS applies" in text and "was wrong" in text


@pytest.mark.parametrize("how", ["crc", "counter", "jump", "length", "kind"])
@pytest.mark.parametrize("axis", APPLIED)
def test_a_bad_command_that_is_ignored_is_well(axis: str, how: str) -> None:
    history = following(axis)
    history.hear(bad_frame(history, axis, how), "Gateway")
    assert history.run(500).broken() == []


@pytest.mark.parametrize("axis", APPLIED)
def test_an_echo_on_its_way_to_an_intact_setpoint_is_well(axis: str) -> None:
    history = following(axis)
    signal, command_signal, setpoint = APPLIED[axis]
    history.change(f"{axis}_COMMAND", **{command_signal: setpoint}).run(20)
    for share in (0.2, 0.5, 0.9, 1.0):
        history.change(f"{axis}_STATUS", **{signal: share * setpoint}).run(10)
    assert history.broken() == []
    history.change(f"{axis}_STATUS", **{signal: 1.1 * setpoint})
    assert history.run(10).broken()


def test_the_steering_may_coast_on_towards_a_setpoint_that_was_replaced_just_now() -> None:
    for late_ms, is_broken in ((290, False), (400, True)):
        history = following("STEER")
        history.change("STEER_COMMAND", steering_wheel_angle_rad=2.0).run(100)
        history.change("STEER_STATUS", applied_steering_wheel_angle_rad=1.0)
        history.change("STEER_COMMAND", steering_wheel_angle_rad=0.0).run(late_ms)
        history.change("STEER_STATUS", applied_steering_wheel_angle_rad=1.5).run(10)
        assert bool(history.broken()) == is_broken


def test_speed_may_go_to_zero_and_the_brake_to_its_end_by_themselves() -> None:
    history = following("THROTTLE")
    history.change("THROTTLE_COMMAND", wheel_speed_radps=20.0).run(20)
    history.change("THROTTLE_STATUS", applied_wheel_speed_radps=20.0).run(1000)
    history.change("THROTTLE_STATUS", applied_wheel_speed_radps=15.0).run(10)
    history.change("BRAKE_STATUS", applied_position_ratio=0.0).run(20)
    assert history.change("BRAKE_STATUS", applied_position_ratio=1.0).run(10).broken() == []


def test_an_echo_that_begins_or_that_an_emergency_sets_is_free() -> None:
    history = History(OnlyIntactCommandsApplied).drive()
    history.change("THROTTLE_STATUS", applied_wheel_speed_radps=17.0).run(10)
    history.change("BRAKE_STATUS", applied_position_ratio=0.0).run(20)
    history.mode(Mode.STOPPING).run(10).change("BRAKE_STATUS", applied_position_ratio=0.25)
    history.run(10).mode(Mode.EMERGENCY).change("BRAKE_STATUS", applied_position_ratio=0.8).run(10)
    assert history.broken() == []


# Age ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", APPLIED)
def test_a_decision_that_grows_too_old_is_told(axis: str) -> None:
    history = History(NoOldDecision).drive()
    del history.says[f"{axis}_COMMAND"]
    assert history.run(100).broken() == []  # 85 and 17 ms
    assert history.run(10).broken() == ["obeyed at an age of 110.0 ms, limit 85.0 ms"]


def test_the_age_that_a_command_tells_counts() -> None:
    history = History(NoOldDecision).drive()
    history.change("STEER_COMMAND", decision_age_ms=100.0)
    assert history.run(10).broken() == []
    assert history.change("STEER_COMMAND", decision_age_ms=105.0).run(10).broken()


def test_no_decision_at_all_is_too_old_after_the_limit_from_the_beginning() -> None:
    history = History(NoOldDecision).ready()
    history.change("BRAKE_COMMAND", decision_age_ms=nan).mode(Mode.AUTOMATIC)
    assert history.run(110).broken() == []
    assert history.run(10).broken()


@pytest.mark.parametrize("end", ["emergency brake", "full servo", "stopping"])
def test_an_old_decision_that_is_answered_is_well(end: str) -> None:
    history = History(NoOldDecision).drive()
    del history.says["THROTTLE_COMMAND"]
    history.run(90)
    if end == "emergency brake":
        history.call_brake("THROTTLE")
    elif end == "full servo":
        history.truth |= {"servo_powered": True, "servo_target_ratio": 1.0}
    else:
        history.mode(Mode.STOPPING)
    assert history.run(500).broken() == []


def test_a_node_that_may_be_late_has_50_ms_more() -> None:
    history = History(NoOldDecision).drive()
    history.fault(budget_ns=None)
    del history.says["STEER_COMMAND"]
    assert history.run(150).broken() == []
    assert history.run(20).broken()


# The path ----------------------------------------------------------------------------------------


def test_an_engaged_car_far_from_its_path_is_told() -> None:
    history = History(PathBounded).drive()
    assert history.look(path_error_m=-0.86).broken() == []
    assert history.look(path_error_m=-0.87).broken() == ["0.87 m from the path"]
    assert History(PathBounded).run(10).look(path_error_m=3.0).broken() == []
    assert History(PathBounded, path_error_m_max=4.0).drive().look(path_error_m=3.0).broken() == []


# Nodes -------------------------------------------------------------------------------------------


def away(name: str, gap_ms: int) -> History:
    """An engaged car whose message was missing for so long."""
    history = History(RejoinsByRearming).drive()
    message = history.says.pop(name)
    history.run(gap_ms)
    history.says[name] = message
    return history.run(10)


@pytest.mark.parametrize("name", SILENT_NS_OF)
def test_a_drive_that_goes_on_after_a_silence_is_told(name: str) -> None:
    gap_ms = 120 if name == "STEER_COMMAND" else 80
    history = away(name, gap_ms)
    history.node_states(NodeState.SAFE_ALONE)
    assert history.run(100).broken() == []
    assert history.run(10).broken()
    assert away(name, gap_ms - 20).run(500).broken() == []


@pytest.mark.parametrize("axis", APPLIED)
def test_a_node_that_drives_on_after_a_boot_up_is_told(axis: str) -> None:
    history = History(RejoinsByRearming).drive()
    history.boot_up(f"{axis}_HEARTBEAT")
    assert history.run(50).broken() == []
    (text,) = history.run(10).broken()
    assert "ACTIVE 60.0 ms after it came back" in text


def test_what_a_node_said_before_it_was_away_does_not_count() -> None:
    history = History(RejoinsByRearming).drive()
    status, driver = (history.says.pop(name) for name in ("STEER_STATUS", "STEER_DRIVER"))
    history.run(80)
    history.says["STEER_STATUS"] = status
    assert history.run(90).broken() == []
    history.says["STEER_DRIVER"] = driver
    history.run(10)
    assert any("Steering: ACTIVE" in text for text in history.broken())


def test_a_drive_that_ends_at_once_is_well_and_the_next_one_too() -> None:
    history = away("BRAKE_STATUS", 80)
    history.mode(Mode.EMERGENCY).node_states(NodeState.EMERGENCY).run(2000)
    history.mode(Mode.MANUAL).node_states(NodeState.RELEASED).run(500)
    history.mode(Mode.READY).run(100).mode(Mode.AUTOMATIC).node_states(NodeState.ACTIVE)
    assert history.run(2000).broken() == []


def test_a_node_may_be_away_when_nothing_drives() -> None:
    history = History(RejoinsByRearming).run(500)
    history.boot_up("BRAKE_HEARTBEAT")
    del history.says["BRAKE_STATUS"]
    assert history.run(1000).broken() == []


def test_one_node_that_sends_anothers_identifier_is_told_once() -> None:
    history = History(OneSender).run(20)
    for _ in range(3):
        history.send("BRAKE_STATUS", history.says["BRAKE_STATUS"], "Throttle")
        history.hear(Frame(0x7F0), "Throttle")
    assert history.broken() == [
        "Throttle sends 0x184, which is BrakeServo's", "Throttle sends 0x7F0, which is nobody's",
    ]


def test_strangers_are_counted_and_failsafe_is_anybodys() -> None:
    history = History(OneSender).run(20)
    history.hear(Frame(0x001), "Steering")
    history.hear(Frame(0x184, bytes(8)), "stranger")
    history.hear(Frame(0x450), "stranger 2")
    report = history.oracle.finish(history.now_ns)
    assert history.broken() == [] and report.strangers == 2


def test_each_drive_and_its_ecu_send_their_own_identifiers() -> None:
    history = History(OneSender, CAR).run(20)
    for drive, ecu, node_id, command in (
        ("SteeringDrive", "Steering", STEER, 0x200), ("LeftWheelDrive", "Throttle", LEFT, 0x300),
        ("RightWheelDrive", "Throttle", RIGHT, 0x300),
    ):
        for base in (0x080, 0x180, 0x280, 0x580, 0x700):
            history.hear(Frame(base + node_id), drive)
        for base in (command, 0x600):
            history.hear(Frame(base + node_id), ecu)
    assert history.broken() == []
    history.hear(Frame(0x180 + LEFT), "RightWheelDrive")
    history.hear(Frame(0x300 + LEFT), "Steering")
    history.hear(Frame(0x300 + STEER), "Throttle")
    assert history.broken() == [
        "RightWheelDrive sends 0x192, which is LeftWheelDrive's",
        "Steering sends 0x312, which is Throttle's", "Throttle sends 0x311, which is nobody's",
    ]


# The report --------------------------------------------------------------------------------------


def test_corruptions_are_counted_beside_their_expected_share() -> None:
    history = History(OneSender)
    sent = history.frame("STEER_COMMAND", BAD_COMMANDS["STEER"])
    for value in range(256):
        heard = Frame(sent.can_id, bytes([value]) + sent.data[1:4] + b"\x55" + sent.data[5:])
        history.oracle.on_corruption("Gateway", sent, heard)
    history.oracle.on_corruption("Gateway", sent, sent)  # nothing has changed
    corruptions = history.oracle.finish(0).corruptions
    assert (corruptions.count, corruptions.unseen) == (256, 1)
    assert corruptions.unseen_expected == 1.0


@pytest.mark.parametrize("is_altered", [False, True])
def test_what_was_changed_and_fits_its_crc_nobody_has_said(is_altered: bool) -> None:
    history = following("STEER")
    said = history.says["STEER_STATUS"]
    sent = encode(SPEC_OF_NAME["STEER_STATUS"], said, history._counters["STEER_STATUS"])
    heard = history.frame(
        "STEER_STATUS", replace(said, applied_steering_wheel_angle_rad=3.0)
    )
    if is_altered:
        history.oracle.on_corruption("Steering", sent, heard)
    history.hear(heard, "Steering")
    assert bool(history.run(100).broken()) != is_altered
    report = history.oracle.finish(history.now_ns)
    assert (report.corruptions.unseen, report.strangers) == (is_altered, 0)


def test_an_excused_violation_is_kept_apart_while_the_fault_is_there_and_lately() -> None:
    for late_ms, is_broken in ((1900, False), (2100, True)):
        history = History(PathBounded).drive()
        history.fault(excuses=frozenset({PathBounded.name}), budget_ns=None)
        history.fault(is_begin=False)
        history.run(late_ms).look(path_error_m=5.0)
        report = history.oracle.finish(history.now_ns)
        assert bool(report.violations) == is_broken and bool(report.excused) != is_broken


def test_an_excuse_for_no_property_is_the_callers_mistake() -> None:
    with pytest.raises(AssertionError, match="unknown properties"):
        History(PathBounded).fault(excuses=frozenset({"everything"}))


def test_a_property_that_is_broken_again_and_again_is_counted() -> None:
    history = History(PathBounded).drive()
    for _ in range(2 * KEPT_MAX):
        history.look(path_error_m=5.0).look(path_error_m=0.0)
    report = history.oracle.finish(history.now_ns)
    assert len(report.violations) == KEPT_MAX and report.counts == {PathBounded.name: 2 * KEPT_MAX}
    assert str(report).splitlines()[0].endswith("path error bounded: 5.00 m from the path")
    assert str(Oracle(TABBY).finish(0)) == "no violation"


@pytest.mark.parametrize("kind", PROPERTIES, ids=lambda kind: kind.__name__)
def test_every_property_has_a_name_and_tells_its_sentence_and_source(kind: type[Property]) -> None:
    assert len({other.name for other in PROPERTIES}) == len(PROPERTIES)
    text = str(kind.__doc__)
    assert text.split("\n\n")[0].strip().endswith((".", ")."))
    sources = ("docs/", "UAH", "UWA", "Design", "design", "is there, or was")
    assert any(source in text for source in sources)


def test_a_command_that_comes_with_its_age_is_answered_in_the_nodes_next_step() -> None:
    history = History(NoOldDecision).drive()
    history.change("STEER_COMMAND", decision_age_ms=1270.0)
    assert history.run(10).broken() == []
    history.call_brake("STEER")
    assert history.run(500).broken() == []
