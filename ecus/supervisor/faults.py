"""What calls for the emergency brake while the car drives itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from dbc.endpoint import SPEC_OF_NAME, STOPPING_IDS, Endpoint, Message
from dbc.messages import (
    BrakeStatus,
    ErrorCode,
    NodeState,
    Reason,
    SafetyVerdict,
    SteerDriver,
    SteerStatus,
    Verdict,
)
from ecus.common.codes import Cause
from ecus.supervisor.nodes import ACTUATORS, Nodes
from ecus.supervisor.params import SupervisorParams
from vehicles.vehicle import DriverPolicy

ACTIVATION_NS: Final = 100_000_000
"""Time the actuator nodes have to become ACTIVE after AUTOMATIC begins."""

BRAKING_RATIO_MIN: Final = 0.02
NS_PER_MS: Final = 1_000_000


def driving_faults(
    now_ns: int,
    driving_ns: int,
    messages: Sequence[Message],
    nodes: Nodes,
    endpoint: Endpoint,
    params: SupervisorParams,
) -> list[Cause]:
    """All faults seen in this step, what the nodes themselves report first."""
    return [
        *reported_faults(messages),
        *silence_faults(now_ns, nodes),
        *state_faults(now_ns, driving_ns, nodes),
        *verdict_faults(now_ns, endpoint),
        *policy_faults(now_ns, endpoint, params),
    ]


def reported_faults(messages: Sequence[Message]) -> list[Cause]:
    """EMERGENCY_BRAKE frames of other nodes, with the code and age that they tell."""
    return [
        Cause(
            code=message.content.code,
            reason=message.content.reason,
            seen_ns=message.arrival_ns - message.content.cause_age_ms * NS_PER_MS,
        )
        for message in messages
        if message.can_id in STOPPING_IDS
    ]


def silence_faults(now_ns: int, nodes: Nodes) -> list[Cause]:
    """ER2: a node's frames missing, a node restarted, or a node not OPERATIONAL."""
    faults = []
    for name, watch in nodes.watches.items():
        has_booted = watch.take_boot()
        if not nodes.alive[name] or has_booted:
            is_monitor = name == "SafetyMonitor"
            reason = Reason.VERDICT_MISSING if is_monitor else Reason.NODE_SILENT
            since_ns = nodes.newest_loss_ns(name, now_ns)
            faults.append(Cause(code=ErrorCode.ER2, reason=reason, seen_ns=since_ns))
        elif not watch.is_operational:
            faults.append(Cause(code=ErrorCode.ER2, reason=Reason.NMT_COMMAND, seen_ns=now_ns))
    return faults


def state_faults(now_ns: int, driving_ns: int, nodes: Nodes) -> list[Cause]:
    """An actuator node that is in a safe state by itself, or does not drive when it should."""
    faults = []
    states = nodes.states
    for name in ACTUATORS:
        state = states.get(name)
        is_due = driving_ns > ACTIVATION_NS
        if state in (NodeState.SAFE_ALONE, NodeState.EMERGENCY) or (
            is_due and state is not NodeState.ACTIVE
        ):
            faults.append(
                Cause(code=ErrorCode.ER1, reason=Reason.NODE_EMERGENCY, seen_ns=now_ns)
            )
    return faults


def verdict_faults(now_ns: int, endpoint: Endpoint) -> list[Cause]:
    """Anything but PERMIT is a veto while driving."""
    verdict = endpoint.get("SAFETY_VERDICT", SafetyVerdict)
    if verdict is None or verdict.verdict is Verdict.PERMIT:
        return []
    return [Cause(code=ErrorCode.ER1, reason=Reason.VERDICT_BRAKE, seen_ns=now_ns)]


def policy_faults(now_ns: int, endpoint: Endpoint, params: SupervisorParams) -> list[Cause]:
    """UWA: the driver steers against the system, or brakes while the system does not."""
    is_against = params.driver_steers_against is DriverPolicy.EMERGENCY and steers_against(endpoint)
    is_alone = params.driver_brakes_alone is DriverPolicy.EMERGENCY and brakes_alone(endpoint)
    if not is_against and not is_alone:
        return []
    return [Cause(code=ErrorCode.ER1, reason=Reason.DRIVER_AGAINST_SYSTEM, seen_ns=now_ns)]


def steers_against(endpoint: Endpoint) -> bool:
    """The driver's torque and the system's wish to turn point opposite ways."""
    driver = endpoint.get("STEER_DRIVER", SteerDriver)
    status = endpoint.get("STEER_STATUS", SteerStatus)
    if driver is None or status is None or not driver.driver_active:
        return False
    wish_rad = status.applied_steering_wheel_angle_rad - status.steering_wheel_angle_rad
    return wish_rad * driver.torque_nm < 0.0


def brakes_alone(endpoint: Endpoint) -> bool:
    """The driver brakes and the system does not."""
    driver = endpoint.newest("BRAKE_DRIVER")
    status = endpoint.get("BRAKE_STATUS", BrakeStatus)
    if driver is None or status is None or not driver.content.driver_active:
        return False
    applied = status.applied_position_ratio
    return math.isnan(applied) or applied < BRAKING_RATIO_MIN


assert SPEC_OF_NAME["SAFETY_VERDICT"].timeout_ns == 60_000_000
