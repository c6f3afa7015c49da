"""The monitor denies until everything has been healthy for half a second, and says why."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame
from dbc.messages import Mode, MonitorReason, Verdict
from safety_monitor.verdict import VERDICT_OF, Phase, Severity
from tests.safety_monitor.monitor_bus import CAN_ID, DENY, NAN, PERMIT, TIMEOUT_MS, MonitorBus

NAMES = sorted(CAN_ID)


def test_the_verdict_table_is_what_its_rules_say() -> None:
    by_hand = {
        (Phase.UNPROVEN, Severity.NONE): Verdict.DENY,
        (Phase.UNPROVEN, Severity.DOUBT): Verdict.DENY,
        (Phase.UNPROVEN, Severity.HAZARD): Verdict.DENY,
        (Phase.PROVEN, Severity.NONE): Verdict.PERMIT,
        (Phase.PROVEN, Severity.DOUBT): Verdict.DENY,
        (Phase.PROVEN, Severity.HAZARD): Verdict.DENY,
        (Phase.DRIVING, Severity.NONE): Verdict.PERMIT,
        (Phase.DRIVING, Severity.DOUBT): Verdict.PERMIT,
        (Phase.DRIVING, Severity.HAZARD): Verdict.BRAKE,
        (Phase.VETOED, Severity.NONE): Verdict.BRAKE,
        (Phase.VETOED, Severity.DOUBT): Verdict.BRAKE,
        (Phase.VETOED, Severity.HAZARD): Verdict.BRAKE,
    }
    table = {(p, s): verdict for p, row in VERDICT_OF.items() for s, verdict in row.items()}
    assert table == by_hand


def test_a_monitor_that_hears_nothing_denies_for_ever() -> None:
    bus = MonitorBus()
    bus.muted = set(CAN_ID)
    bus.run(5_000)
    assert bus.told_ever() == {DENY}
    assert bus.answers[-1].told == (DENY, MonitorReason.FRAME_MISSING, 0x181)


def test_a_healthy_bus_is_permitted_after_half_a_second_and_not_before() -> None:
    bus = MonitorBus()
    answers = [bus.tick() for _ in range(80)]
    healthy = next(n for n, a in enumerate(answers) if a.told[1] is MonitorReason.STARTING)
    permitted = next(n for n, a in enumerate(answers) if a.told[0] is PERMIT)
    assert permitted - healthy == 50
    assert all(a.told[0] is DENY for a in answers[:permitted])
    assert all(a.told == (PERMIT, MonitorReason.NONE, 0) for a in answers[permitted:])


@pytest.mark.parametrize("name", NAMES)
def test_a_frame_that_was_never_heard_denies_and_is_named(name: str) -> None:
    bus = MonitorBus()
    bus.muted = {name}
    assert bus.run(2_000).told == (DENY, MonitorReason.FRAME_MISSING, CAN_ID[name])
    assert bus.told_ever() == {DENY}


@pytest.mark.parametrize("name", NAMES)
def test_a_frame_that_stops_denies_after_its_time_out_and_not_at_it(name: str) -> None:
    bus = MonitorBus().permitted()
    bus.muted = {name}
    bus.forget()
    bus.run(TIMEOUT_MS[name])  # every message came in the last cycle before
    assert bus.told_ever() == {PERMIT}
    answer = bus.tick()
    assert answer.told == (DENY, MonitorReason.FRAME_LATE, CAN_ID[name])
    assert answer.verdict is not None
    age_share = (TIMEOUT_MS[name] + 10) / TIMEOUT_MS[name]
    assert answer.verdict.value == pytest.approx(1000 * age_share, abs=1)


def test_a_gap_in_health_starts_the_half_second_again() -> None:
    bus = MonitorBus()
    bus.run(400)
    bus.is_emergency_stop_pressed = True
    assert bus.tick().told == (DENY, MonitorReason.EMERGENCY_STOP, 0)
    bus.is_emergency_stop_pressed = False
    assert bus.tick().told == (DENY, MonitorReason.STARTING, 0)
    bus.forget()
    bus.run(490)
    assert bus.told_ever() == {DENY}
    assert bus.tick().told == (PERMIT, MonitorReason.NONE, 0)


@pytest.mark.parametrize(
    ("name", "signal", "can_id"),
    [
        ("STEER_STATUS", "steering_wheel_angle_rad", 0x182),
        ("THROTTLE_STATUS", "wheel_speed_radps", 0x183),
        ("BRAKE_STATUS", "rear_wheel_speed_radps", 0x184),
        ("BRAKE_STATUS", "servo_position_ratio", 0x184),
    ],
)
def test_a_measured_value_that_is_not_available_denies_and_names_its_frame(
    name: str, signal: str, can_id: int
) -> None:
    bus = MonitorBus().permitted()
    bus.say(name, **{signal: NAN})
    assert bus.tick().told == (DENY, MonitorReason.VALUE_NOT_AVAILABLE, can_id)


@pytest.mark.parametrize("name", ["STEER_DRIVER", "THROTTLE_DRIVER", "BRAKE_DRIVER"])
@pytest.mark.parametrize("code", range(7))
def test_a_reported_code_denies_all_but_er0(name: str, code: int) -> None:
    bus = MonitorBus().permitted()
    bus.say(name, **{f"er{code}": True})
    answer = bus.run(20)
    if code == 0:
        assert answer.told == (PERMIT, MonitorReason.NONE, 0)
    else:
        assert answer.told == (DENY, MonitorReason.ERROR_REPORTED, CAN_ID[name])


def test_no_verdict_is_sent_before_the_node_is_started() -> None:
    bus = MonitorBus(is_started=False)
    bus.run(1_000)
    assert not any(0x185 in answer.ids for answer in bus.answers)
    assert bus.answers[0].ids == {0x705}  # boot-up
    bus.extra.append(nmt_frame(NmtCommand.START, 5))
    answer = bus.tick()
    assert 0x185 in answer.ids
    assert any(event.text == "obeyed START" for event in answer.events)


def test_a_stopped_monitor_sends_no_verdict_and_goes_on_when_started() -> None:
    bus = MonitorBus().permitted()
    bus.extra.append(nmt_frame(NmtCommand.STOP, 5))
    bus.tick()
    assert 0x185 not in bus.tick().ids
    bus.extra.append(nmt_frame(NmtCommand.START, 0))
    assert bus.tick().told == (PERMIT, MonitorReason.NONE, 0)


def test_the_verdict_comes_every_step_and_its_counter_never_stands() -> None:
    bus = MonitorBus()
    bus.run(300)
    frames = [f for answer in bus.answers for f in answer.frames if f.can_id == 0x185]
    assert [frame.data[1] & 0x0F for frame in frames] == [n % 15 for n in range(30)]


def test_a_monitor_restarted_in_a_drive_never_permits_it() -> None:
    bus = MonitorBus()
    bus.say_mode(Mode.AUTOMATIC)
    bus.run(100)
    assert PERMIT not in bus.told_ever()
    assert bus.answers[-1].told[0] is Verdict.BRAKE


# SDO -----------------------------------------------------------------------------------------

LIMITS = {1: 8.2, 2: 3.0, 3: 5.0, 4: 9.45, 5: 11.0}
"""Object 0x2100 of TABBY EVO, by hand."""


def ask(bus: MonitorBus, data: bytes) -> bytes:
    """One SDO request; the answer."""
    bus.extra.append(Frame(0x605, data))
    return next(frame.data for frame in bus.tick().frames if frame.can_id == 0x585)


@pytest.mark.parametrize(("subindex", "limit"), LIMITS.items())
def test_each_limit_is_readable_by_sdo(subindex: int, limit: float) -> None:
    bus = MonitorBus().permitted()
    answer = ask(bus, struct.pack("<BHB4x", 0x40, 0x2100, subindex))
    assert answer[0] == 0x43 and math.isclose(int.from_bytes(answer[4:], "little") / 1e3, limit)


@pytest.mark.parametrize("subindex", LIMITS)
def test_no_limit_is_writable_even_in_manual(subindex: int) -> None:
    bus = MonitorBus().permitted()
    before = ask(bus, struct.pack("<BHB4x", 0x40, 0x2100, subindex))
    answer = ask(bus, struct.pack("<BHBl", 0x23, 0x2100, subindex, 2_000))
    assert answer[0] == 0x80 and struct.unpack("<L", answer[4:])[0] in (0x06010002, 0x08000022)
    assert ask(bus, struct.pack("<BHB4x", 0x40, 0x2100, subindex)) == before


def test_every_reason_of_the_dbc_is_given_by_some_test() -> None:
    here = Path(__file__).parent
    text = "".join(path.read_text() for path in sorted(here.glob("test_monitor_*.py")))
    assert [reason for reason in MonitorReason if f"MonitorReason.{reason.name}" not in text] == []
