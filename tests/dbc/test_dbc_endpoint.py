"""A node's end of the bus: what it believes, what it ignores and counts, what is foreign."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canbus.frame import Frame, FrameKind, ReceivedFrame
from dbc.codec import FrameFault, encode
from dbc.endpoint import (
    ID_OF_NAME,
    SPEC_OF_NAME,
    STOPPING_IDS,
    Endpoint,
    is_forged,
    sent_by,
)
from dbc.messages import (
    EmergencyBrake,
    ErrorCode,
    Heartbeat,
    HeartbeatState,
    Reason,
    SteerStatus,
    ThrottleStatus,
)
from dbc.protection import COUNTER_MODULO, USABLE, AliveCheck, AliveState

MS = 1_000_000
STEER = 0x182
STATUS = SteerStatus(steering_wheel_angle_rad=1.0, applied_steering_wheel_angle_rad=1.0)
BRAKE = EmergencyBrake(
    code=ErrorCode.ER4, reason=Reason.MOTOR_FAULT, cause_age_ms=0, reset_epoch=0
)


def steer(counter: int, angle_rad: float = 1.0) -> Frame:
    content = SteerStatus(
        steering_wheel_angle_rad=angle_rad, applied_steering_wheel_angle_rad=angle_rad
    )
    return encode(SPEC_OF_NAME["STEER_STATUS"], content, counter)


def brake(counter: int) -> Frame:
    return encode(SPEC_OF_NAME["STEER_EMERGENCY_BRAKE"], BRAKE, counter)


def at(now_ms: int, *frames: Frame) -> list[ReceivedFrame]:
    return [ReceivedFrame(now_ms * MS, frame) for frame in frames]


def listening(*names: str) -> Endpoint:
    return Endpoint("Supervisor", names or ("STEER_STATUS",))


def in_sequence() -> Endpoint:
    """The last counter heard is 1."""
    endpoint = listening("STEER_STATUS", "STEER_EMERGENCY_BRAKE", "FAILSAFE", "STEER_HEARTBEAT")
    endpoint.take(at(0, steer(0), steer(1)))
    return endpoint


# What is believed --------------------------------------------------------------------------------


def test_the_first_frame_tells_where_the_counter_stands_and_is_nobodys_fault() -> None:
    endpoint = listening()
    assert endpoint.take(at(0, steer(4))) == []
    assert endpoint.bad == [] and endpoint.newest("STEER_STATUS") is None
    (message,) = endpoint.take(at(10, steer(5)))
    assert (message.can_id, message.arrival_ns, message.content) == (STEER, 10 * MS, STATUS)


def test_frames_are_answered_in_their_order_with_their_own_arrival() -> None:
    endpoint = in_sequence()
    received = [ReceivedFrame(7, steer(2, 0.5)), ReceivedFrame(9, steer(3, 0.25))]
    messages = endpoint.take(received)
    assert [m.content.steering_wheel_angle_rad for m in messages] == [0.5, 0.25]
    assert [m.arrival_ns for m in messages] == [7, 9]
    newest = endpoint.newest("STEER_STATUS")
    assert newest is not None and newest.arrival_ns == 9


def test_one_lost_frame_is_believed_and_counted() -> None:
    endpoint = in_sequence()
    assert len(endpoint.take(at(10, steer(3)))) == 1
    assert endpoint.lost == 1 and endpoint.bad == []


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (steer(1), FrameFault.REPEATED),
        (steer(9), FrameFault.SEQUENCE),
        (Frame(STEER, steer(2).data[:7]), FrameFault.LENGTH),
        (Frame(STEER, bytes([steer(2).data[0] ^ 1]) + steer(2).data[1:]), FrameFault.CRC),
        (Frame(STEER, b"", FrameKind.REMOTE), FrameFault.KIND),
        (Frame(STEER, steer(2).data, FrameKind.FD), FrameFault.KIND),
    ],
)
def test_each_fault_is_ignored_counted_and_reported_once(frame: Frame, fault: FrameFault) -> None:
    endpoint = in_sequence()
    assert endpoint.take(at(10, frame)) == []
    assert [(bad.arrival_ns, bad.frame, bad.fault) for bad in endpoint.bad] == [
        (10 * MS, frame, fault)
    ]
    assert endpoint.counts == {f: int(f is fault) for f in FrameFault}
    assert endpoint.foreign == [] and not endpoint.is_bus_off
    endpoint.take([])
    assert endpoint.bad == [] and endpoint.counts[fault] == 1


def test_a_value_that_the_dbc_does_not_know_is_a_value_fault() -> None:
    endpoint = listening("STEER_HEARTBEAT")
    assert endpoint.take(at(0, Frame(0x702, b"\7"))) == []
    assert endpoint.bad[0].fault is FrameFault.VALUE


@pytest.mark.parametrize("frame", [Frame(STEER, b"", FrameKind.REMOTE), Frame(STEER, bytes(8))])
def test_a_corrupt_frame_shows_in_the_state_of_its_identifier(frame: Frame) -> None:
    endpoint = in_sequence()
    endpoint.take(at(10, frame))
    assert endpoint.subscription("STEER_STATUS").check.state is AliveState.ERROR
    endpoint.take(at(20, steer(2)))
    assert endpoint.subscription("STEER_STATUS").check.state is AliveState.OK


def test_a_bad_frame_takes_nothing_away() -> None:
    endpoint = in_sequence()
    before = endpoint.newest("STEER_STATUS")
    endpoint.take(at(10, Frame(STEER, bytes(8))))
    assert endpoint.newest("STEER_STATUS") is before
    assert len(endpoint.take(at(20, steer(2)))) == 1


def test_an_unprotected_message_is_believed_at_once_and_again() -> None:
    endpoint = in_sequence()
    heartbeat = Frame(0x702, b"\5")
    messages = endpoint.take(at(0, heartbeat, heartbeat, Frame(0x001)))
    assert [message.can_id for message in messages] == [0x702, 0x702, 0x001]
    assert endpoint.get("STEER_HEARTBEAT", Heartbeat) == Heartbeat(
        state=HeartbeatState.OPERATIONAL
    )


@settings(max_examples=200, deadline=None, derandomize=True)
@given(counters=st.lists(st.one_of(st.none(), st.integers(0, 14)), max_size=40))
def test_the_endpoint_believes_what_the_state_machine_says(counters: list[int | None]) -> None:
    """The usual case has a short cut; here it is held against the table."""
    endpoint, reference = listening(), AliveCheck()
    for now_ms, counter in enumerate(counters):
        frame = Frame(STEER, b"\1" * 8) if counter is None else steer(counter)
        believed = bool(endpoint.take(at(now_ms, frame)))
        assert believed == (reference.judge(counter) in USABLE)
        check = endpoint.subscription("STEER_STATUS").check
        assert (check.state, check.expected, check.is_in_sequence) == (
            reference.state, reference.expected, reference.is_in_sequence
        )


# Frames that stop the car ------------------------------------------------------------------------


def test_the_stopping_frames_are_the_six_emergency_brakes() -> None:
    assert {0x011, 0x012, 0x013, 0x014, 0x015, 0x016} == STOPPING_IDS


def test_a_stopping_frame_is_believed_at_once_but_not_when_repeated() -> None:
    endpoint = in_sequence()
    assert [m.content for m in endpoint.take(at(0, brake(7)))] == [BRAKE]
    assert endpoint.bad == []
    assert endpoint.take(at(10, brake(7))) == []
    assert endpoint.bad[0].fault is FrameFault.REPEATED
    assert len(endpoint.take(at(20, brake(8)))) == 1
    assert len(endpoint.take(at(30, brake(12)))) == 1  # after any loss as well


def test_a_corrupt_stopping_frame_stops_nothing() -> None:
    endpoint = in_sequence()
    assert endpoint.take(at(0, Frame(0x012, bytes(8)))) == []
    assert endpoint.bad[0].fault is FrameFault.CRC


# Strangers ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x181, bytes(8)),  # the supervisor's own
        Frame(0x000, b"\1\2"),
        Frame(0x181, b"", FrameKind.REMOTE),
        Frame(0x400, b"hello"),  # nobody's
        Frame(0x7FF, b"", FrameKind.REMOTE),
        Frame(0x182, steer(2).data, FrameKind.EXTENDED),  # the number fits, the identifier not
        Frame(0x18FEF100, bytes(8), FrameKind.EXTENDED),
    ],
)
def test_own_and_unknown_identifiers_are_foreign(frame: Frame) -> None:
    endpoint = in_sequence()
    assert endpoint.take(at(10, frame)) == []
    assert [item.frame for item in endpoint.foreign] == [frame]
    assert endpoint.bad == [] and sum(endpoint.counts.values()) == 0
    endpoint.take([])
    assert endpoint.foreign == []


@pytest.mark.parametrize("kind", [FrameKind.DATA, FrameKind.REMOTE, FrameKind.FD])
def test_a_known_frame_that_is_not_subscribed_is_nothing(kind: FrameKind) -> None:
    endpoint = in_sequence()
    assert endpoint.take(at(10, Frame(0x183, bytes(8), kind))) == []
    assert endpoint.foreign == [] and endpoint.bad == []


@pytest.mark.parametrize(
    ("can_id", "is_off"), [(0x040, True), (0x044, True), (0x004, False), (0x181, False)]
)
def test_an_error_frame_tells_bus_off_and_is_nobodys(can_id: int, is_off: bool) -> None:
    endpoint = in_sequence()
    endpoint.take(at(10, Frame(can_id, bytes(8), FrameKind.ERROR)))
    assert endpoint.is_bus_off is is_off
    assert endpoint.foreign == [] and endpoint.bad == []
    endpoint.take([])
    assert not endpoint.is_bus_off


def test_bus_off_is_not_forgotten_within_a_step() -> None:
    endpoint = in_sequence()
    frames = [Frame(0x040, bytes(8), FrameKind.ERROR), Frame(0x100, bytes(8), FrameKind.ERROR)]
    endpoint.take(at(10, *frames))
    assert endpoint.is_bus_off


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (steer(3), True),
        (Frame(STEER, bytes(8)), False),
        (Frame(STEER, steer(3).data, FrameKind.EXTENDED), False),
        (Frame(STEER, b"", FrameKind.REMOTE), False),
        (Frame(0x702, b"\5"), False),  # unprotected: anybody can say it
        (Frame(0x400, b"hello"), False),
    ],
)
def test_only_an_intact_protected_frame_can_be_a_forgery(frame: Frame, expected: bool) -> None:
    assert is_forged(frame) is expected


# What is sent, and what is wanted ----------------------------------------------------------------


def test_counters_run_from_0_to_14_for_each_message_apart() -> None:
    endpoint = Endpoint("Steering", ())
    counters = [endpoint.frame("STEER_STATUS", STATUS).data[1] for _ in range(31)]
    assert counters == [n % COUNTER_MODULO for n in range(31)]
    assert endpoint.frame("STEER_EMERGENCY_BRAKE", BRAKE).data[1] == 0


def test_an_unprotected_message_has_no_counter() -> None:
    endpoint = Endpoint("Steering", ())
    heartbeat = Heartbeat(state=HeartbeatState.STOPPED)
    assert [endpoint.frame("STEER_HEARTBEAT", heartbeat) for _ in range(2)] == [
        Frame(0x702, b"\4")
    ] * 2


def test_a_node_cannot_send_another_nodes_message() -> None:
    with pytest.raises(KeyError):
        Endpoint("Steering", ()).frame(
            "THROTTLE_STATUS", ThrottleStatus(wheel_speed_radps=0.0, applied_wheel_speed_radps=0.0)
        )


def test_acceptance_is_what_is_subscribed_and_what_is_own() -> None:
    endpoint = Endpoint("Steering", ["SUPERVISOR_STATE", "STEER_COMMAND"])
    assert endpoint.acceptance == {0x181, 0x202, 0x012, 0x082, 0x182, 0x282, 0x582, 0x702}
    assert sent_by("Steering") == endpoint.acceptance - {0x181, 0x202}


# Freshness ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("age_ns", "is_fresh"), [(0, True), (60 * MS, True), (60 * MS + 1, False)])
def test_a_message_is_fresh_up_to_exactly_its_time_out(age_ns: int, is_fresh: bool) -> None:
    endpoint = in_sequence()
    endpoint.take(at(100, steer(2)))
    assert endpoint.is_fresh("STEER_STATUS", 100 * MS + age_ns) is is_fresh
    assert endpoint.age_ns("STEER_STATUS", 100 * MS + age_ns) == age_ns


def test_a_message_that_never_came_is_not_fresh_and_has_no_age() -> None:
    endpoint = listening()
    endpoint.take(at(0, steer(0)))
    assert not endpoint.is_fresh("STEER_STATUS", 0)
    assert endpoint.age_ns("STEER_STATUS", 0) is None
    assert endpoint.get("STEER_STATUS", SteerStatus) is None


def test_bad_and_repeated_frames_refresh_nothing() -> None:
    endpoint = in_sequence()
    for now_ms in range(10, 200, 10):
        endpoint.take(at(now_ms, steer(1), Frame(STEER, bytes(8))))
    assert endpoint.age_ns("STEER_STATUS", 200 * MS) == 200 * MS


def test_a_message_asked_for_as_another_kind_is_the_programmers_error() -> None:
    endpoint = in_sequence()
    assert endpoint.get("STEER_STATUS", SteerStatus) == STATUS
    with pytest.raises(AssertionError):
        endpoint.get("STEER_STATUS", ThrottleStatus)


def test_names_and_identifiers_belong_together() -> None:
    ids: dict[str, Any] = {name: spec.can_id for name, spec in SPEC_OF_NAME.items()}
    assert ids == ID_OF_NAME and len(ids) == 44
    assert AliveState.OK in USABLE
