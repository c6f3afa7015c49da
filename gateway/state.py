"""What a planner sees of the car: typed, frozen, and honest about what is missing.

A value whose frame is older than the DBC's time-out is NaN or None, never the last one known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from dbc.endpoint import SPEC_OF_NAME, Endpoint
from dbc.messages import (
    BrakeDriver,
    BrakeStatus,
    ErrorCode,
    Heartbeat,
    HeartbeatState,
    Inhibit,
    Mode,
    MonitorReason,
    NodeState,
    Reason,
    Request,
    SafetyVerdict,
    SteerDriver,
    SteerStatus,
    SupervisorState,
    ThrottleDriver,
    ThrottleStatus,
)
from gateway.kinematics import Kinematics
from gateway.node_health import HealthByNode, NodeHealth
from gateway.poses import OdometryPose
from gateway.sentences import INHIBIT_TEXT, MONITOR_TEXT, REASON_TEXT

NS_PER_S: Final = 1_000_000_000
MS_PER_S: Final = 1000.0

LIMIT_REASONS: Final = frozenset(
    {
        MonitorReason.SPEED,
        MonitorReason.STEERING_ANGLE,
        MonitorReason.STEERING_RATE,
        MonitorReason.LATERAL_ACCELERATION,
        MonitorReason.LATERAL_JERK,
        MonitorReason.STEERING_DIVERGENCE,
        MonitorReason.SPEED_DIVERGENCE,
        MonitorReason.BRAKE_DIVERGENCE,
    }
)
"""Reasons whose `value` is what was measured, in thousandths of its limit."""

_FRAMES: Final[dict[str, tuple[str, str, type[Any] | None]]] = {
    "Supervisor": ("SUPERVISOR", "SUPERVISOR_STATE", None),
    "Steering": ("STEER", "STEER_STATUS", SteerDriver),
    "Throttle": ("THROTTLE", "THROTTLE_STATUS", ThrottleDriver),
    "BrakeServo": ("BRAKE", "BRAKE_STATUS", BrakeDriver),
    "SafetyMonitor": ("SAFETY_MONITOR", "SAFETY_VERDICT", None),
}
"""Per node: prefix of its messages, its protected 10 ms frame, the type of its driver frame."""

_NAMES_OF: Final = {
    node: (status, f"{prefix}_HEARTBEAT", f"{prefix}_DRIVER", kind)
    for node, (prefix, status, kind) in _FRAMES.items()
}
"""Per node: its 10 ms frame, its heartbeat, its driver frame if it has one, the latter's type."""

SUBSCRIBED: Final = tuple(
    name
    for prefix, status, driver in _FRAMES.values()
    for name in (
        status,
        f"{prefix}_HEARTBEAT",
        f"{prefix}_EMERGENCY_BRAKE",
        *((f"{prefix}_DRIVER",) if driver else ()),
    )
)
"""Messages from which the state is made."""

EMERGENCY_SENDER: Final = {
    SPEC_OF_NAME[f"{prefix}_EMERGENCY_BRAKE"].can_id: node
    for node, (prefix, _, _) in _FRAMES.items()
}
"""Node by the identifier of its EMERGENCY_BRAKE."""

MessageT = TypeVar("MessageT")


@dataclass(frozen=True, slots=True, kw_only=True)
class EmergencyReason:
    """Why there is, or was, an emergency brake."""

    node: str
    code: ErrorCode
    reason: Reason

    def __str__(self) -> str:
        """One line for a person."""
        return f"{self.node}: {REASON_TEXT[self.reason]} ({self.code.name})"


@dataclass(frozen=True, slots=True, kw_only=True)
class CarState:
    """The car at `time_ns` of the link's clock. SI units; positive turns left."""

    time_ns: int
    speed_mps: float
    """Centre of the rear axle, from the driven wheels; NaN when not available."""
    curvature_per_m: float
    """From the steering wheel's angle; NaN when not available."""
    steering_wheel_angle_rad: float
    yaw_rate_radps: float
    """Speed times curvature."""
    odometry: OdometryPose
    """Where the wheels say it is, and how far that may be off."""
    brake_position_ratio: float
    """Brake servo, 0 released, 1 full; NaN when not available."""
    mode: Mode | None
    """Driving mode; None when the supervisor is not heard."""
    is_engaged: bool
    """AUTOMATIC, and told so by a supervisor that is heard."""
    why_not_engaged: str
    """A sentence to act on; empty when engaged."""
    codes: tuple[ErrorCode, ...] | None
    """Codes latched by the supervisor; None when it is not heard."""
    reset_epoch: int | None
    emergency_reason: EmergencyReason | None
    """Of the newest EMERGENCY_BRAKE since the last reset or engagement."""
    node_health: Mapping[str, NodeHealth]
    """By the DBC's node names, the gateway itself included."""
    supervisor_state_age_s: float
    """Infinite before the first frame, as the other ages."""
    steering_age_s: float
    throttle_age_s: float
    brake_age_s: float
    verdict_age_s: float
    decision_age_s: float
    """Age of the planner's newest decision; NaN when there is none."""
    decision_age_limit_s: float
    """Limit in force, as the supervisor tells; NaN when it is not heard."""
    pending_request: Request


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class OwnSide:
    """What only the gateway knows: its part of the state."""

    heartbeat: Final[HeartbeatState]
    decision_age_s: Final[float]
    pending_request: Final[Request]
    emergency_reason: Final[EmergencyReason | None]
    foreign_name: Final[str]
    """Message of the gateway's own that somebody else sent of late; empty when none."""

    def __init__(
        self,
        *,
        heartbeat: HeartbeatState,
        decision_age_s: float,
        pending_request: Request,
        emergency_reason: EmergencyReason | None,
        foreign_name: str,
    ) -> None:
        self.heartbeat = heartbeat
        self.decision_age_s = decision_age_s
        self.pending_request = pending_request
        self.emergency_reason = emergency_reason
        self.foreign_name = foreign_name


def car_state(
    endpoint: Endpoint, kinematics: Kinematics, odometry: OdometryPose, now_ns: int, own: OwnSide
) -> CarState:
    """The state from the newest frames, leaving out what is too old."""
    supervisor = _fresh(endpoint, "SUPERVISOR_STATE", SupervisorState, now_ns)
    verdict = _fresh(endpoint, "SAFETY_VERDICT", SafetyVerdict, now_ns)
    steer = _fresh(endpoint, "STEER_STATUS", SteerStatus, now_ns)
    throttle = _fresh(endpoint, "THROTTLE_STATUS", ThrottleStatus, now_ns)
    brake = _fresh(endpoint, "BRAKE_STATUS", BrakeStatus, now_ns)
    wheel_angle_rad = math.nan if steer is None else steer.steering_wheel_angle_rad
    wheel_speed_radps = math.nan if throttle is None else throttle.wheel_speed_radps
    curvature_per_m = kinematics.curvature_per_m(wheel_angle_rad)
    speed_mps = kinematics.speed_mps(wheel_angle_rad, wheel_speed_radps)
    health = {node: _node_health(endpoint, node, now_ns) for node in _FRAMES}
    health["Gateway"] = NodeHealth(
        heartbeat=own.heartbeat, age_s=0.0, is_heard=True, node_state=None, codes=()
    )
    supervisor_age_s = _age_s(endpoint, "SUPERVISOR_STATE", now_ns)
    return CarState(
        time_ns=now_ns,
        speed_mps=speed_mps,
        curvature_per_m=curvature_per_m,
        steering_wheel_angle_rad=wheel_angle_rad,
        yaw_rate_radps=kinematics.yaw_rate_radps(speed_mps, curvature_per_m),
        odometry=odometry,
        brake_position_ratio=math.nan if brake is None else brake.servo_position_ratio,
        mode=None if supervisor is None else supervisor.mode,
        is_engaged=supervisor is not None and supervisor.mode is Mode.AUTOMATIC,
        why_not_engaged=why_not_engaged(supervisor, verdict, supervisor_age_s, own),
        codes=None if supervisor is None else codes_of(supervisor),
        reset_epoch=None if supervisor is None else supervisor.reset_epoch,
        emergency_reason=own.emergency_reason,
        node_health=HealthByNode(health),
        supervisor_state_age_s=supervisor_age_s,
        steering_age_s=health["Steering"].age_s,
        throttle_age_s=health["Throttle"].age_s,
        brake_age_s=health["BrakeServo"].age_s,
        verdict_age_s=health["SafetyMonitor"].age_s,
        decision_age_s=own.decision_age_s,
        decision_age_limit_s=(
            math.nan if supervisor is None else supervisor.decision_age_ms_max / MS_PER_S
        ),
        pending_request=own.pending_request,
    )


def codes_of(message: Any) -> tuple[ErrorCode, ...]:
    """The codes ER0-ER6 whose bits are set in a message that carries them."""
    flags = (
        message.er0, message.er1, message.er2, message.er3, message.er4, message.er5, message.er6
    )
    if True not in flags:
        return ()
    return tuple([ErrorCode(n) for n, is_set in enumerate(flags) if is_set])


def why_not_engaged(
    supervisor: SupervisorState | None,
    verdict: SafetyVerdict | None,
    supervisor_age_s: float,
    own: OwnSide,
) -> str:
    """The sentence for `CarState.why_not_engaged`."""
    if supervisor is None:
        since = (
            "nothing heard yet"
            if math.isinf(supervisor_age_s)
            else f"silent for {supervisor_age_s:.2f} s"
        )
        return f"no supervisor on the bus ({since}): is it running, on this interface and channel?"
    if supervisor.mode is Mode.AUTOMATIC:
        return ""
    if own.foreign_name:
        return f"somebody else sends {own.foreign_name}: stop the other gateway on this bus"
    if supervisor.mode is Mode.STOPPING:
        return "a controlled stop is under way: wait until the car stands"
    text = INHIBIT_TEXT[supervisor.inhibit]
    if supervisor.inhibit is Inhibit.VERDICT_DENY:
        text = f"{text}: {verdict_text(verdict)}"
    if supervisor.inhibit is Inhibit.CODE_LATCHED and (codes := codes_of(supervisor)):
        text = f"{text} ({', '.join(code.name for code in codes)})"
    if supervisor.mode is Mode.EMERGENCY:
        cause = "" if own.emergency_reason is None else f" ({own.emergency_reason})"
        text = f"emergency brake{cause}: {text}"
    return text


def verdict_text(verdict: SafetyVerdict | None) -> str:
    """What the safety monitor has found, in words; None: it is not heard."""
    if verdict is None:
        return "its verdict no longer comes"
    text = MONITOR_TEXT[verdict.reason]
    if verdict.reason in LIMIT_REASONS:
        return f"{text} ({verdict.value / 1000:.2f} of the limit)"
    return f"{text} ({message_name(verdict.identifier)})" if verdict.identifier else text


_NAMES: Final = {spec.can_id: spec.name for spec in SPEC_OF_NAME.values()}


def message_name(can_id: int) -> str:
    """The DBC's name of an identifier, with its number."""
    return f"{_NAMES.get(can_id, 'identifier')} 0x{can_id:03X}"


def _fresh(
    endpoint: Endpoint, name: str, kind: type[MessageT], now_ns: int
) -> MessageT | None:
    return endpoint.get(name, kind) if endpoint.is_fresh(name, now_ns) else None


def _age_s(endpoint: Endpoint, name: str, now_ns: int) -> float:
    age_ns = endpoint.age_ns(name, now_ns)
    return math.inf if age_ns is None else age_ns / NS_PER_S


def _node_health(endpoint: Endpoint, node: str, now_ns: int) -> NodeHealth:
    status, heartbeat_name, driver_name, driver_kind = _NAMES_OF[node]
    heartbeat = _fresh(endpoint, heartbeat_name, Heartbeat, now_ns)
    node_state: NodeState | None = None
    codes: tuple[ErrorCode, ...] | None = ()
    if driver_kind is not None:
        driver = _fresh(endpoint, driver_name, driver_kind, now_ns)
        node_state = None if driver is None else driver.node_state
        codes = None if driver is None else codes_of(driver)
    return NodeHealth(
        heartbeat=None if heartbeat is None else heartbeat.state,
        age_s=_age_s(endpoint, status, now_ns),
        is_heard=endpoint.is_fresh(status, now_ns),
        node_state=node_state,
        codes=codes,
    )
