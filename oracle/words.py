"""What the numbers in the frames mean, written a second time; a test compares with the DBC."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Mode(IntEnum):
    """SUPERVISOR_STATE.mode."""

    INIT = 0
    MANUAL = 1
    READY = 2
    AUTOMATIC = 3
    STOPPING = 4
    EMERGENCY = 5


class NodeState(IntEnum):
    """*_DRIVER.node_state."""

    STARTING = 0
    RELEASED = 1
    ACTIVE = 2
    SAFE_ALONE = 3
    EMERGENCY = 4


class Verdict(IntEnum):
    """SAFETY_VERDICT.verdict."""

    DENY = 0
    PERMIT = 1
    BRAKE = 2


class Request(IntEnum):
    """MODE_REQUEST.request."""

    NONE = 0
    ENGAGE = 1
    DISENGAGE = 2
    RESET = 3
    EMERGENCY_STOP = 4


class HeartbeatState(IntEnum):
    """*_HEARTBEAT.state (CiA 301)."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """NMT.command (CiA 301)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


DRIVING: Final = frozenset({Mode.AUTOMATIC, Mode.STOPPING})
"""The car drives itself."""
HUMAN: Final = frozenset({Mode.MANUAL, Mode.READY})
"""A human drives, or may; INIT is left out: a restarted supervisor finds the relay as it was."""
AT_WORK: Final = frozenset({NodeState.ACTIVE, NodeState.SAFE_ALONE, NodeState.EMERGENCY})
"""States of an actuator node in which a code that it raises is latched."""

ER4_OR_ER6: Final = 1 << 4 | 1 << 6
ER0: Final = 1 << 0

AXES: Final = {"STEER": "Steering", "THROTTLE": "Throttle", "BRAKE": "BrakeServo"}
"""Prefix of an actuator node's messages, and its name."""

BRAKE_FRAMES: Final = tuple(
    f"{prefix}_EMERGENCY_BRAKE"
    for prefix in ("SUPERVISOR", "STEER", "THROTTLE", "BRAKE", "SAFETY_MONITOR", "GATEWAY")
)
HEARTBEATS: Final = {
    "SUPERVISOR_HEARTBEAT": "Supervisor",
    "STEER_HEARTBEAT": "Steering",
    "THROTTLE_HEARTBEAT": "Throttle",
    "BRAKE_HEARTBEAT": "BrakeServo",
    "SAFETY_MONITOR_HEARTBEAT": "SafetyMonitor",
    "GATEWAY_HEARTBEAT": "Gateway",
}
"""By message, the node that sends it."""

NEVER_NS: Final = -(1 << 62)
"""Long before anything."""
NS_PER_MS: Final = 1_000_000
NS_PER_S: Final = 1_000_000_000
GAP_NS: Final = 25 * NS_PER_MS
"""Two states of the supervisor further apart may hide a third."""
