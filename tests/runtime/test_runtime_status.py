"""What `dbw status` learns from listening, and waiting for the car to stand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import pytest

from canbus.canopen_protocol import NmtState
from canbus.frame import Frame, FrameKind, ReceivedFrame
from canbus.timing import frame_bits
from dbc.codec import FrameFault
from dbc.endpoint import SPEC_OF_NAME, Endpoint
from dbc.messages import (
    BrakeDriver,
    ErrorCode,
    Heartbeat,
    HeartbeatState,
    Inhibit,
    Mode,
    MonitorReason,
    NodeState,
    SafetyVerdict,
    SupervisorState,
    ThrottleStatus,
    Verdict,
)
from runtime.standstill import HEAR_NS_MAX, WANTED, is_standing, wait_for_standstill
from runtime.status import BusStatus, bus_load, listen, summarise
from tests.runtime.runtime_fakes import MS, FakeBus, FakeClock


def filled(kind: type[Any], **given: Any) -> Any:
    """A message with every signal zero but those given."""
    return kind(**{f.name: 0 for f in fields(kind)} | given)


class Sender:
    """Messages of any node, with running counters."""

    def __init__(self) -> None:
        self._endpoints: dict[str, Endpoint] = {}
        self.received: list[ReceivedFrame] = []

    def send(self, arrival_ns: int, name: str, message: Any) -> Frame:
        sender = SPEC_OF_NAME[name].sender
        assert sender is not None
        endpoint = self._endpoints.setdefault(sender, Endpoint(sender, []))
        frame = endpoint.frame(name, message)
        self.received.append(ReceivedFrame(arrival_ns, frame))
        return frame


def supervisor(mode: Mode, **given: Any) -> SupervisorState:
    state: SupervisorState = filled(
        SupervisorState, mode=mode, inhibit=given.pop("inhibit", Inhibit.NONE), **given
    )
    return state


def healthy() -> BusStatus:
    sender = Sender()
    for n in range(50):
        now_ns = n * 10 * MS
        state = supervisor(
            Mode.READY, inhibit=Inhibit.NOT_REQUESTED, er5=True, brake_authorised=True
        )
        sender.send(now_ns, "SUPERVISOR_STATE", state)
        verdict = filled(SafetyVerdict, verdict=Verdict.PERMIT, reason=MonitorReason.NONE)
        sender.send(now_ns, "SAFETY_VERDICT", verdict)
        throttle = filled(ThrottleStatus, wheel_speed_radps=3.0, applied_wheel_speed_radps=math.nan)
        sender.send(now_ns, "THROTTLE_STATUS", throttle)
        if n % 2:
            driver = filled(BrakeDriver, node_state=NodeState.ACTIVE, er3=True)
            sender.send(now_ns, "BRAKE_DRIVER", driver)
    sender.send(0, "BRAKE_HEARTBEAT", Heartbeat(state=HeartbeatState.PRE_OPERATIONAL))
    sender.send(0, "BRAKE_HEARTBEAT", Heartbeat(state=HeartbeatState.OPERATIONAL))
    return summarise(sender.received, 500 * MS)


def test_mode_codes_axes_and_verdict_are_the_newest_believable_ones() -> None:
    status = healthy()
    assert (status.mode, status.inhibit) == (Mode.READY, Inhibit.NOT_REQUESTED)
    assert status.codes == (ErrorCode.ER5,)
    assert status.authorised == ("brake",)
    assert (status.verdict, status.verdict_reason) == (Verdict.PERMIT, MonitorReason.NONE)
    assert status.wheel_speed_radps == pytest.approx(3.0, abs=0.01)
    assert math.isnan(status.steering_wheel_angle_rad) and math.isnan(status.brake_ratio)


def test_each_node_has_its_state_codes_and_rate() -> None:
    nodes = {node.name: node for node in healthy().nodes}
    assert list(nodes) == [
        "Supervisor",
        "Steering",
        "Throttle",
        "BrakeServo",
        "SafetyMonitor",
        "Gateway",
    ]
    brake = nodes["BrakeServo"]
    assert (brake.nmt, brake.state) == (NmtState.OPERATIONAL, NodeState.ACTIVE)
    assert brake.codes == (ErrorCode.ER3,)
    assert brake.frames_per_s == pytest.approx(54)
    assert nodes["Throttle"].is_heard and nodes["Throttle"].nmt is None
    assert not nodes["Steering"].is_heard and nodes["Steering"].state is None


def test_rates_and_bits_are_those_of_the_time_listened() -> None:
    status = healthy()
    assert status.frames == 177
    assert status.frames_per_s["SUPERVISOR_STATE"] == pytest.approx(100)
    assert status.frames_per_s["BRAKE_DRIVER"] == pytest.approx(50)
    assert "STEER_STATUS" not in status.frames_per_s
    assert bus_load(status, 500_000) == pytest.approx(status.bits_per_s / 500_000)
    assert 0.07 < bus_load(status, 500_000) < 0.1


def test_bits_are_exact() -> None:
    frame = Frame(0x123, bytes(range(8)))
    status = summarise([ReceivedFrame(0, frame)] * 10, 100 * MS)
    assert status.bits_per_s == pytest.approx(frame_bits(frame) * 100)


def test_what_nobody_should_send_is_listed() -> None:
    frames = [
        Frame(0x555, b"\x01"),
        Frame(0x123, b""),
        Frame(0x12345, bytes(8), FrameKind.EXTENDED),
        Frame(0x182, bytes(8), FrameKind.FD),
        Frame(0x183, bytes(7)),
        Frame(0x184, bytes(8)),
        Frame(0x004, bytes(8), FrameKind.ERROR),
    ]
    status = summarise([ReceivedFrame(0, frame) for frame in frames], 100 * MS)
    assert status.unknown_ids == (0x123, 0x182, 0x555, 0x12345)
    assert (status.frames, status.error_frames) == (6, 1)
    assert status.bad_frames[FrameFault.LENGTH] == 1
    assert status.bad_frames[FrameFault.CRC] == 1


def test_a_silent_bus_is_no_error() -> None:
    clock = FakeClock(5 * MS)
    bus = FakeBus(clock)
    status = listen(bus, clock, 300 * MS)
    assert clock.now_ns == 305 * MS
    assert (status.mode, status.verdict, status.frames) == (None, None, 0)
    assert not any(node.is_heard for node in status.nodes)
    assert bus.sent == []


def test_listening_ends_when_the_time_is_over_however_busy_the_bus() -> None:
    clock = FakeClock()
    bus = FakeBus(clock, [(t * MS, Frame(0x555)) for t in range(1, 1_000)])
    status = listen(bus, clock, 300 * MS)
    assert clock.now_ns == 300 * MS and status.frames == 300


Traffic = Callable[[int], list[tuple[str, Any]]]


def waited(traffic: Traffic, limit_ms: int = 5_000) -> tuple[bool, int, list[Frame]]:
    """Answer of the wait, its duration in ms, and what was sent."""
    clock, sender = FakeClock(), Sender()
    incoming = [
        (t * MS, sender.send(t * MS, name, message))
        for t in range(0, limit_ms, 10)
        for name, message in traffic(t)
    ]
    bus = FakeBus(clock, incoming)
    endpoint = Endpoint("Launcher", WANTED)
    stands = wait_for_standstill(bus, endpoint, clock, limit_ms * MS, lambda: False)
    return stands, clock.now_ns // MS, [frame for _, frame in bus.sent]


def wheels(radps: float) -> tuple[str, Any]:
    status = filled(ThrottleStatus, wheel_speed_radps=radps, applied_wheel_speed_radps=math.nan)
    return "THROTTLE_STATUS", status


def mode(value: Mode) -> tuple[str, Any]:
    return "SUPERVISOR_STATE", supervisor(value)


@pytest.mark.parametrize("value", [Mode.INIT, Mode.MANUAL, Mode.READY])
def test_nobody_waits_while_a_human_drives(value: Mode) -> None:
    stands, duration_ms, sent = waited(lambda t: [mode(value), wheels(20.0)])
    assert stands and duration_ms < 100 and sent == []


def test_a_driving_system_is_told_to_stop_until_it_obeys() -> None:
    def traffic(t: int) -> list[tuple[str, Any]]:
        value = Mode.AUTOMATIC if t < 250 else Mode.EMERGENCY
        return [mode(value), wheels(max(0.0, 20.0 - t / 100))]

    stands, duration_ms, sent = waited(traffic)
    assert stands and 1_950 <= duration_ms <= 2_050
    assert set(sent) == {Frame(0x001)} and len(sent) == 3


def test_the_wait_has_an_end() -> None:
    stands, duration_ms, _ = waited(lambda t: [mode(Mode.EMERGENCY), wheels(20.0)], 2_000)
    assert not stands and 2_000 <= duration_ms <= 2_020


def test_without_supervisor_the_ecus_brake_and_the_wheels_tell_when_it_is_over() -> None:
    stands, duration_ms, sent = waited(lambda t: [wheels(max(0.0, 10.0 - t / 100))])
    assert stands and 950 <= duration_ms <= 1_050 and sent == []


def test_a_dead_bus_is_not_waited_for() -> None:
    stands, duration_ms, sent = waited(lambda t: [])
    assert not stands and duration_ms <= HEAR_NS_MAX // MS + 20 and sent == []


@pytest.mark.parametrize("radps", [math.nan, 0.3, -0.3])
def test_unknown_or_turning_wheels_do_not_stand(radps: float) -> None:
    endpoint, sender = Endpoint("Launcher", WANTED), Sender()
    for n in range(2):
        sender.send(n, *wheels(radps))
    endpoint.take(sender.received)
    assert not is_standing(endpoint, MS)


def test_a_second_signal_cuts_the_wait_short() -> None:
    clock = FakeClock()
    endpoint = Endpoint("Launcher", WANTED)
    assert not wait_for_standstill(FakeBus(clock), endpoint, clock, 5_000 * MS, lambda: True)
    assert clock.now_ns == 0
