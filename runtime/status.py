"""What the vehicle bus says about itself, from listening for a moment. Sends nothing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from canbus.bus import Bus
from canbus.canopen_protocol import HEARTBEAT_ID, NmtState, heartbeat_state
from canbus.frame import FrameKind, ReceivedFrame
from canbus.node import NODE_IDS
from canbus.timing import frame_bits
from dbc.codec import FrameFault
from dbc.endpoint import Endpoint
from dbc.messages import (
    SPECS,
    BrakeStatus,
    ErrorCode,
    Inhibit,
    Mode,
    MonitorReason,
    NodeState,
    SafetyVerdict,
    SteerStatus,
    SupervisorState,
    ThrottleStatus,
    Verdict,
)
from dbc.spec import NAN
from runtime.clock import NS_PER_S, Clock

LISTEN_NS = 500_000_000
"""Ten heartbeats, fifty 10 ms frames."""

CODES = tuple(code for code in ErrorCode if code is not ErrorCode.NONE)

_DRIVER_MESSAGE = {
    "Steering": "STEER_DRIVER",
    "Throttle": "THROTTLE_DRIVER",
    "BrakeServo": "BRAKE_DRIVER",
}
"""Which message carries a node's state and codes; the other nodes have none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeStatus:
    """One node, as the bus shows it.

    Attributes:
        name: its DBC name.
        is_heard: whether it sent anything at all.
        nmt: state in its newest heartbeat; None without one.
        state: its own state; None for a node that sends none, or without a believable frame.
        codes: codes it reports.
        frames_per_s: all it sent.
    """

    name: str
    is_heard: bool
    nmt: NmtState | None
    state: NodeState | None
    codes: tuple[ErrorCode, ...]
    frames_per_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BusStatus:
    """The vehicle bus over a moment.

    Attributes:
        duration_s: how long was listened.
        frames: frames heard, error frames not counted.
        error_frames: error frames heard.
        bits_per_s: on the wire, stuff bits included; divided by the bitrate it is the bus load.
        mode: the supervisor's; None when it is not heard.
        inhibit: why the car is not in AUTOMATIC.
        codes: codes the supervisor has latched.
        authorised: axes it authorises, of "steering", "throttle", "brake".
        verdict: the safety monitor's; None when it is not heard.
        verdict_reason: its reason.
        steering_wheel_angle_rad: measured; NaN when unknown.
        wheel_speed_radps: measured at the driven wheels; NaN when unknown.
        brake_ratio: measured servo position; NaN when unknown.
        nodes: all nodes, by node id.
        frames_per_s: by message name, of the messages heard.
        bad_frames: ignored frames of ours, by fault.
        unknown_ids: identifiers nobody should send, in rising order.
    """

    duration_s: float
    frames: int
    error_frames: int
    bits_per_s: float
    mode: Mode | None
    inhibit: Inhibit | None
    codes: tuple[ErrorCode, ...]
    authorised: tuple[str, ...]
    verdict: Verdict | None
    verdict_reason: MonitorReason | None
    steering_wheel_angle_rad: float
    wheel_speed_radps: float
    brake_ratio: float
    nodes: tuple[NodeStatus, ...]
    frames_per_s: dict[str, float]
    bad_frames: dict[FrameFault, int]
    unknown_ids: tuple[int, ...]


def listen(bus: Bus, clock: Clock, duration_ns: int = LISTEN_NS) -> BusStatus:
    """Listens to the vehicle bus and sums up.

    Args:
        bus: the vehicle bus, open, without an acceptance filter.
        clock: the bus's clock.
        duration_ns: how long; at least one heartbeat's time-out tells most.

    Returns:
        The summary. A silent bus is no error: then nothing is heard of anybody.
    """
    begin_ns = clock()
    received: list[ReceivedFrame] = []
    while (passed_ns := clock() - begin_ns) < duration_ns:
        received += bus.receive(duration_ns - passed_ns)
    return summarise(received, clock() - begin_ns)


def summarise(received: Sequence[ReceivedFrame], duration_ns: int) -> BusStatus:
    """Sums up frames of the vehicle bus that were received within `duration_ns`, above 0."""
    assert duration_ns > 0, "no time was listened"
    endpoint = Endpoint("Listener", [spec.name for spec in SPECS.values()])
    endpoint.take(received)
    duration_s = duration_ns / NS_PER_S
    frames = [item.frame for item in received if item.frame.kind is not FrameKind.ERROR]
    classical = [frame for frame in frames if frame.kind is not FrameKind.FD]
    known = [f for f in frames if f.can_id in SPECS and f.kind is FrameKind.DATA]
    counts = Counter(frame.can_id for frame in known)
    state = endpoint.get("SUPERVISOR_STATE", SupervisorState)
    verdict = endpoint.get("SAFETY_VERDICT", SafetyVerdict)
    steering = endpoint.get("STEER_STATUS", SteerStatus)
    throttle = endpoint.get("THROTTLE_STATUS", ThrottleStatus)
    brake = endpoint.get("BRAKE_STATUS", BrakeStatus)
    strange = {frame.can_id for frame in frames} - {frame.can_id for frame in known}
    return BusStatus(
        duration_s=duration_s,
        frames=len(frames),
        error_frames=len(received) - len(frames),
        bits_per_s=sum(map(frame_bits, classical)) / duration_s,
        mode=None if state is None else state.mode,
        inhibit=None if state is None else state.inhibit,
        codes=_codes(state),
        authorised=_authorised(state),
        verdict=None if verdict is None else verdict.verdict,
        verdict_reason=None if verdict is None else verdict.reason,
        steering_wheel_angle_rad=NAN if steering is None else steering.steering_wheel_angle_rad,
        wheel_speed_radps=NAN if throttle is None else throttle.wheel_speed_radps,
        brake_ratio=NAN if brake is None else brake.servo_position_ratio,
        nodes=tuple(_node(name, endpoint, received, counts, duration_s) for name in NODE_IDS),
        frames_per_s={SPECS[i].name: counts[i] / duration_s for i in sorted(counts)},
        bad_frames={fault: count for fault, count in endpoint.counts.items() if count},
        unknown_ids=tuple(sorted(strange)),
    )


def _codes(message: Any) -> tuple[ErrorCode, ...]:
    """Codes that a message with the signals er0 to er6 reports."""
    if message is None:
        return ()
    return tuple(code for code in CODES if getattr(message, f"er{code.value}"))


def _authorised(state: SupervisorState | None) -> tuple[str, ...]:
    if state is None:
        return ()
    axes = {
        "steering": state.steering_authorised,
        "throttle": state.throttle_authorised,
        "brake": state.brake_authorised,
    }
    return tuple(axis for axis, is_authorised in axes.items() if is_authorised)


def _node(
    name: str,
    endpoint: Endpoint,
    received: Sequence[ReceivedFrame],
    counts: Counter[int],
    duration_s: float,
) -> NodeStatus:
    heartbeat_id = HEARTBEAT_ID + NODE_IDS[name]
    nmt = None
    for item in received:
        if item.frame.can_id == heartbeat_id:
            nmt = heartbeat_state(item.frame) or nmt
    sent = sum(count for can_id, count in counts.items() if SPECS[can_id].sender == name)
    message = None
    if name in _DRIVER_MESSAGE:
        found = endpoint.newest(_DRIVER_MESSAGE[name])
        message = None if found is None else found.content
    return NodeStatus(
        name=name,
        is_heard=sent > 0,
        nmt=nmt,
        state=None if message is None else message.node_state,
        codes=_codes(message),
        frames_per_s=sent / duration_s,
    )


def bus_load(status: BusStatus, bitrate_bps: float) -> float:
    """Share of the bus in use, 0 to 1; NaN for a bitrate that is not positive."""
    return status.bits_per_s / bitrate_bps if bitrate_bps > 0 else math.nan
