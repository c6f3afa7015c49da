"""Who may say what on the bus, and how often: every identifier, every kind, every rate."""

from __future__ import annotations

import pytest

from canbus.cia402 import identifiers
from canbus.frame import Frame, FrameKind, ReceivedFrame
from canbus.node import EventKind
from dbc.codec import FrameFault, decode, encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import (
    EmergencyBrake,
    ErrorCode,
    Mode,
    MonitorReason,
    Reason,
    SafetyVerdict,
    Verdict,
)
from tests.safety_monitor.monitor_bus import BRAKE, CAN_ID, CYCLE_MS, DENY, MS, PERMIT, MonitorBus
from tests.vehicles.drive_car import CAR

TEN_MS = [name for name, cycle_ms in CYCLE_MS.items() if cycle_ms == 10]

# The identifiers of this bus, written by hand.
OWN = {0x015, 0x085, 0x185, 0x585, 0x705}
PROTECTED = {
    0x011, 0x012, 0x013, 0x014, 0x016,
    0x181, 0x182, 0x183, 0x184,
    0x201, 0x202, 0x203, 0x204,
    0x282, 0x283, 0x284,
}
UNPROTECTED = (
    {0x000}
    | {0x080 + node for node in (1, 2, 3, 4, 6)}
    | {0x580 + node for node in (1, 2, 3, 4, 6)}
    | {0x600 + node for node in range(1, 7)}
    | {0x700 + node for node in (1, 2, 3, 4, 6)}
)
FAILSAFE = 0x001
TOLERATED = set(range(0x400, 0x500))
ALL = set(range(0x800))
UNKNOWN = ALL - OWN - PROTECTED - UNPROTECTED - TOLERATED - {FAILSAFE}
ONES = bytes([0xFF] * 8)
"""No protected frame of ours: counter 15 is invalid."""


def test_ones_are_no_valid_frame_of_any_protected_identifier() -> None:
    for can_id in PROTECTED | {0x015, 0x185}:
        assert decode(Frame(can_id, ONES)) is FrameFault.CRC
    assert len(UNKNOWN) + len(OWN | PROTECTED | UNPROTECTED | TOLERATED | {FAILSAFE}) == 2048


def expected_doubt(can_id: int) -> MonitorReason | None:
    """The rule by hand: what eight bytes of ones with this identifier make the monitor say."""
    if can_id in OWN:
        return MonitorReason.FOREIGN_SENDER
    if can_id in UNKNOWN:
        return MonitorReason.UNKNOWN_IDENTIFIER
    if can_id in PROTECTED or can_id == FAILSAFE:
        return MonitorReason.BAD_FRAME
    return None


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.AUTOMATIC], ids=lambda mode: mode.name)
def test_every_identifier_meets_its_rule(mode: Mode) -> None:
    bus = MonitorBus().driving() if mode is Mode.AUTOMATIC else MonitorBus().permitted()
    # Harmless ones first: a doubt stays for a second and would hide that they cause none.
    quiet = sorted(ALL, key=lambda can_id: (expected_doubt(can_id) is not None, can_id))
    verdict_in_doubt = PERMIT if mode is Mode.AUTOMATIC else DENY
    for can_id in quiet:
        bus.extra.append(Frame(can_id, ONES))
        reason = expected_doubt(can_id)
        if reason is None:
            expected = (PERMIT, MonitorReason.NONE, 0)
        else:
            expected = (verdict_in_doubt, reason, can_id)
        assert bus.tick().told == expected, hex(can_id)
    assert BRAKE not in bus.told_ever()


@pytest.mark.parametrize("name", ["SAFETY_VERDICT", "SAFETY_MONITOR_EMERGENCY_BRAKE"])
def test_a_forged_frame_of_the_monitors_own_brakes_a_drive(name: str) -> None:
    spec = SPEC_OF_NAME[name]
    contents = {
        "SAFETY_VERDICT": SafetyVerdict(
            verdict=PERMIT, reason=MonitorReason.NONE, identifier=0, value=0
        ),
        "SAFETY_MONITOR_EMERGENCY_BRAKE": EmergencyBrake(
            code=ErrorCode.ER1, reason=Reason.VERDICT_BRAKE, cause_age_ms=0, reset_epoch=0
        ),
    }
    for bus, verdict in ((MonitorBus().permitted(), DENY), (MonitorBus().driving(), BRAKE)):
        bus.extra.append(encode(spec, contents[name], 7))
        answer = bus.tick()
        assert answer.told == (verdict, MonitorReason.FOREIGN_SENDER, spec.can_id)
        assert any(event.kind is EventKind.FOREIGN for event in answer.events)


def test_a_doubt_denies_for_a_second_and_half_a_second_of_proof_follows() -> None:
    bus = MonitorBus().permitted()
    bus.extra.append(Frame(0x555, b"\1"))
    assert bus.tick().told == (DENY, MonitorReason.UNKNOWN_IDENTIFIER, 0x555)
    assert bus.run(1_000).told == (DENY, MonitorReason.UNKNOWN_IDENTIFIER, 0x555)
    assert bus.tick().told == (DENY, MonitorReason.STARTING, 0)
    assert bus.run(490).told[0] is DENY
    assert bus.tick().told[0] is PERMIT


def test_a_doubt_warns_in_a_drive_and_denies_the_next_one() -> None:
    bus = MonitorBus().driving()
    bus.extra.append(Frame(0x555, b"\1"))
    assert bus.run(500).told == (PERMIT, MonitorReason.UNKNOWN_IDENTIFIER, 0x555)
    bus.say_mode(Mode.MANUAL)
    assert bus.tick().told == (DENY, MonitorReason.UNKNOWN_IDENTIFIER, 0x555)


def test_a_drive_that_ends_soon_after_a_doubt_has_its_proof_to_give_again() -> None:
    bus = MonitorBus().driving()
    bus.extra.append(Frame(0x555, b"\1"))
    bus.run(1_100)
    bus.say_mode(Mode.MANUAL)
    assert bus.tick().told == (DENY, MonitorReason.STARTING, 0)


def test_foreign_traffic_in_the_tolerated_range_is_reported_and_nothing_more() -> None:
    bus = MonitorBus().permitted()
    bus.extra.append(Frame(0x4FF, b"hello"))
    answer = bus.tick()
    assert answer.told == (PERMIT, MonitorReason.NONE, 0)
    assert [event.text for event in answer.events] == ["4FF#68656C6C6F (data)"]


@pytest.mark.parametrize("can_id", [0x3FF, 0x500])
def test_the_edge_of_the_tolerated_range_is_outside_it(can_id: int) -> None:
    bus = MonitorBus().permitted()
    bus.extra.append(Frame(can_id, b"hello"))
    assert bus.tick().told == (DENY, MonitorReason.UNKNOWN_IDENTIFIER, can_id)


@pytest.mark.parametrize("kind", [FrameKind.REMOTE, FrameKind.FD])
def test_other_kinds_are_not_tolerated_even_in_the_range(kind: FrameKind) -> None:
    bus = MonitorBus().permitted()
    bus.extra.append(Frame(0x480, b"", kind))
    assert bus.tick().told == (DENY, MonitorReason.UNKNOWN_IDENTIFIER, 0x480)


@pytest.mark.parametrize("can_id", [0x480, 0x182, 0x185, 0x18FEF100])
def test_an_extended_frame_is_nobodys_whatever_its_number(can_id: int) -> None:
    bus = MonitorBus().driving()
    bus.extra += [Frame(can_id, ONES, FrameKind.EXTENDED)] * 12
    # No identifier: the verdict has room for 11 bits and must not blame an innocent one.
    assert bus.tick().told == (PERMIT, MonitorReason.UNKNOWN_IDENTIFIER, 0)


@pytest.mark.parametrize("kind", [FrameKind.REMOTE, FrameKind.FD])
def test_a_frame_of_ours_of_another_kind_is_a_bad_frame(kind: FrameKind) -> None:
    bus = MonitorBus().permitted()
    bus.extra.append(Frame(0x182, b"", kind))
    answer = bus.tick()
    assert answer.told == (DENY, MonitorReason.BAD_FRAME, 0x182)
    assert any(event.text.endswith("kind") for event in answer.events)


@pytest.mark.parametrize("length", [0, 1, 7])
def test_a_frame_of_ours_of_another_length_is_a_bad_frame(length: int) -> None:
    bus = MonitorBus().permitted()
    bus.extra.append(Frame(0x183, bytes(length)))
    assert bus.tick().told == (DENY, MonitorReason.BAD_FRAME, 0x183)


def test_a_bad_frame_does_not_end_a_drive_but_silence_behind_bad_frames_does() -> None:
    bus = MonitorBus().driving()
    bus.muted = {"STEER_STATUS"}
    for _ in range(6):
        bus.extra.append(Frame(0x182, ONES))
        assert bus.tick().told == (PERMIT, MonitorReason.BAD_FRAME, 0x182)
    bus.extra.append(Frame(0x182, ONES))
    assert bus.tick().told == (BRAKE, MonitorReason.FRAME_LATE, 0x182)


# FAILSAFE and bus-off ------------------------------------------------------------------------


def test_the_failsafe_frame_brakes_a_drive_and_denies_the_next() -> None:
    bus = MonitorBus().driving()
    bus.extra.append(Frame(FAILSAFE))
    answer = bus.tick()
    assert answer.told == (BRAKE, MonitorReason.EMERGENCY_STOP, FAILSAFE)
    assert answer.emergency is not None
    bus = MonitorBus().permitted()
    bus.extra.append(Frame(FAILSAFE))
    assert bus.tick().told == (DENY, MonitorReason.EMERGENCY_STOP, FAILSAFE)


def test_bus_off_brakes_at_once() -> None:
    bus = MonitorBus().driving()
    bus.extra.append(Frame(0x040, bytes(8), FrameKind.ERROR))
    answer = bus.tick()
    assert answer.told == (BRAKE, MonitorReason.FRAME_MISSING, 0)
    assert any(event.text == "bus-off" for event in answer.events)


@pytest.mark.parametrize("can_id", [0x004, 0x008, 0x080, 0x100, 0x184, 0x201])
def test_other_error_frames_are_no_traffic_of_anybody(can_id: int) -> None:
    bus = MonitorBus().driving()
    bus.extra += [Frame(can_id, bytes(8), FrameKind.ERROR)] * 20
    assert bus.tick().told == (PERMIT, MonitorReason.NONE, 0)


# Rates ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TEN_MS)
def test_a_doubled_stream_brakes_within_200_ms(name: str) -> None:
    bus = MonitorBus().driving()
    bus.forget()
    for _ in range(20):
        first = bus.frame(name)
        bus.now_ns += 10 * MS
        bus.cycle += 1
        received = [ReceivedFrame(bus.now_ns - 5 * MS, first)]
        received += [ReceivedFrame(bus.now_ns, frame) for frame in bus.due()]
        bus.step(received)
    assert bus.answers[-1].told[0] is BRAKE
    vetoed = next(answer for answer in bus.answers if answer.told[0] is BRAKE)
    assert vetoed.told == (BRAKE, MonitorReason.RATE_TOO_HIGH, CAN_ID[name])
    assert vetoed.verdict is not None and 1000 < vetoed.verdict.value <= 1125


def limited() -> dict[int, int]:
    """Shortest lasting interval in ms of each identifier that has one, by hand."""
    protected = dict.fromkeys(PROTECTED | {0x015, 0x185}, 7)
    return protected | {0x700 + node: 20 for node in range(1, 7)}


def test_the_dbc_limits_the_rates_written_here() -> None:
    limits = {s.can_id: s.min_interval_ns // MS for s in SPEC_OF_NAME.values() if s.min_interval_ns}
    assert limits == limited()


@pytest.mark.parametrize("can_id", sorted(set(limited()) - OWN - set(CAN_ID.values())))
def test_eight_frames_at_once_are_a_burst_and_nine_are_too_many(can_id: int) -> None:
    for count, verdict in ((8, PERMIT), (9, BRAKE)):
        bus = MonitorBus().driving()
        bus.extra += [Frame(can_id, ONES)] * count
        assert bus.tick().told[0] is verdict
    assert bus.answers[-1].told == (BRAKE, MonitorReason.RATE_TOO_HIGH, can_id)


@pytest.mark.parametrize("interval_ms", [6, 7])
def test_a_lasting_rate_at_the_limit_is_allowed_and_above_it_is_not(interval_ms: int) -> None:
    bus = MonitorBus().driving()
    bus.forget()
    start_ns = bus.now_ns
    sent = [start_ns + n * interval_ms * MS for n in range(1, 400)]
    while bus.now_ns - start_ns < 1_000 * MS:
        before_ns = bus.now_ns
        bus.now_ns += 10 * MS
        bus.cycle += 1
        received = [ReceivedFrame(t, Frame(0x016, ONES)) for t in sent if before_ns < t]
        received = [item for item in received if item.arrival_ns <= bus.now_ns]
        received += [ReceivedFrame(bus.now_ns, frame) for frame in bus.due()]
        bus.step(received)
    assert bus.told_ever() == ({PERMIT} if interval_ms == 7 else {PERMIT, BRAKE})


@pytest.mark.parametrize("name", TEN_MS)
def test_a_burst_of_five_after_50_ms_of_silence_is_no_breach(name: str) -> None:
    bus = MonitorBus().driving()
    bus.forget()
    for _ in range(10):
        bus.muted = {name}
        bus.run(40)
        bus.muted = set()
        held = [bus.frame(name) for _ in range(4)]
        bus.now_ns += 10 * MS
        bus.cycle += 1
        bus.step([ReceivedFrame(bus.now_ns, frame) for frame in held + bus.due()])
    assert bus.told_ever() == {PERMIT}
    assert {answer.told[1] for answer in bus.answers} == {MonitorReason.NONE}


@pytest.mark.parametrize("jitter_ms", [1, 3, 5])
def test_jitter_of_every_frame_is_no_breach(jitter_ms: int) -> None:
    bus = MonitorBus().driving()
    bus.forget()
    for n in range(100):
        bus.now_ns += 10 * MS
        bus.cycle += 1
        early_ns = (n * 7 % (jitter_ms + 1)) * MS
        bus.step([ReceivedFrame(bus.now_ns - early_ns, frame) for frame in bus.due()])
    assert {answer.told for answer in bus.answers} == {(PERMIT, MonitorReason.NONE, 0)}


# Losses --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(CYCLE_MS))
@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_lost_frames_of_any_message_trip_nothing(name: str, count: int) -> None:
    bus = MonitorBus().driving(speed_mps=5.0)
    angle_rad = 0.0
    bus.forget()
    for cycle in range(60):
        if cycle % 20 == 5:
            bus.lose(name, count)
        step_rad = 0.08 if cycle % 20 < 10 else -0.08  # 8 rad/s, the fastest the car steers
        angle_rad += step_rad
        bus.say(
            "STEER_STATUS",
            steering_wheel_angle_rad=angle_rad,
            applied_steering_wheel_angle_rad=angle_rad,
        )
        bus.say("STEER_COMMAND", steering_wheel_angle_rad=angle_rad)
        bus.tick()
    assert bus.told_ever() == {Verdict.PERMIT}


def test_the_drives_identifiers_are_known_where_the_vehicle_has_drives() -> None:
    with_drives, without = MonitorBus(CAR).permitted(), MonitorBus().permitted()
    for can_id in sorted(identifiers(CAR.drive_node_ids)):
        for bus in (with_drives, without):
            bus.extra.append(Frame(can_id, bytes(8)))
        assert with_drives.tick().told == (PERMIT, MonitorReason.NONE, 0)
        assert without.tick().told == (DENY, MonitorReason.UNKNOWN_IDENTIFIER, can_id)
    with_drives.extra.append(Frame(0x090 + 5, bytes(8)))  # no drive of this car
    assert with_drives.tick().told == (DENY, MonitorReason.UNKNOWN_IDENTIFIER, 0x095)
