"""The supervisor's decisions as pure functions: why not engage, why not reset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from dbc.messages import ErrorCode, Inhibit, Mode, NodeState, Verdict


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Situation:
    """All that decides over engaging and resetting, as seen in one step."""

    mode: Final[Mode]
    alive: Final[Mapping[str, bool]]
    """Its protected frames come in time."""
    heard: Final[Mapping[str, bool]]
    """Its heartbeat comes in time."""
    operational: Final[Mapping[str, bool]]
    configuration_equal: Final[Mapping[str, bool | None]]
    node_states: Final[Mapping[str, NodeState]]
    codes: Final[frozenset[ErrorCode]]
    """Reported by any node, latched or not."""
    blocking_codes: Final[frozenset[ErrorCode]]
    """Whose cause is there now and must be gone before a reset."""
    verdict: Final[Verdict | None]
    """None: missing or stale."""
    is_driver_active: Final[bool]
    is_emergency_stop_pressed: Final[bool]
    has_foreign_frames: Final[bool]
    is_planner_period_allowed: Final[bool]
    speed_mps: Final[float]
    """Faster of the two axles; NaN when unknown."""
    is_standing: Final[bool]
    engage_speed_mps_max: Final[float]

    def __init__(
        self,
        *,
        mode: Mode,
        alive: Mapping[str, bool],
        heard: Mapping[str, bool],
        operational: Mapping[str, bool],
        configuration_equal: Mapping[str, bool | None],
        node_states: Mapping[str, NodeState],
        codes: frozenset[ErrorCode],
        blocking_codes: frozenset[ErrorCode],
        verdict: Verdict | None,
        is_driver_active: bool,
        is_emergency_stop_pressed: bool,
        has_foreign_frames: bool,
        is_planner_period_allowed: bool,
        speed_mps: float,
        is_standing: bool,
        engage_speed_mps_max: float,
    ) -> None:
        self.mode = mode
        self.alive = alive
        self.heard = heard
        self.operational = operational
        self.configuration_equal = configuration_equal
        self.node_states = node_states
        self.codes = codes
        self.blocking_codes = blocking_codes
        self.verdict = verdict
        self.is_driver_active = is_driver_active
        self.is_emergency_stop_pressed = is_emergency_stop_pressed
        self.has_foreign_frames = has_foreign_frames
        self.is_planner_period_allowed = is_planner_period_allowed
        self.speed_mps = speed_mps
        self.is_standing = is_standing
        self.engage_speed_mps_max = engage_speed_mps_max


def _node_inhibit(prefix: str, node: str) -> Inhibit:
    names = {"Steering": "STEERING", "Throttle": "THROTTLE", "BrakeServo": "BRAKE_SERVO",
             "SafetyMonitor": "SAFETY_MONITOR", "Gateway": "GATEWAY"}
    return Inhibit[f"{prefix}_{names[node]}"]


def missing_node(situation: Situation) -> Inhibit | None:
    """The first node that is silent, not started, or of another configuration."""
    for node, is_alive in situation.alive.items():
        is_equal = situation.configuration_equal[node]
        if situation.operational[node] and is_equal is False:
            return _node_inhibit("CONFIGURATION", node)  # also why its frames cannot be read
        if not situation.operational[node] and situation.heard[node]:
            return _node_inhibit("NOT_OPERATIONAL", node)
        if not situation.operational[node] or not is_alive:
            return _node_inhibit("MISSING", node)
        if is_equal is None:
            return _node_inhibit("CONFIGURATION", node)  # not told yet
    return None


def engage_inhibit(situation: Situation) -> Inhibit:
    """Why READY may not become AUTOMATIC, most basic first; NOT_REQUESTED when nothing is left."""
    if (missing := missing_node(situation)) is not None:
        return missing
    rules = (
        (situation.is_emergency_stop_pressed, Inhibit.EMERGENCY_STOP_PRESSED),
        (bool(situation.codes), Inhibit.CODE_LATCHED),
        (situation.has_foreign_frames, Inhibit.FOREIGN_FRAME),
        (situation.verdict is None, Inhibit.VERDICT_MISSING),
        (situation.verdict is not Verdict.PERMIT, Inhibit.VERDICT_DENY),
        (situation.is_driver_active, Inhibit.DRIVER_INPUT),
        (set(situation.node_states.values()) != {NodeState.RELEASED}, Inhibit.NODE_UNRELEASED),
        (not situation.is_planner_period_allowed, Inhibit.PLANNER_PERIOD),
        (not situation.speed_mps <= situation.engage_speed_mps_max, Inhibit.TOO_FAST),
        (situation.mode is not Mode.READY, Inhibit.PRESS_BUTTON),
    )
    for holds, reason in rules:
        if holds:
            return reason
    return Inhibit.NOT_REQUESTED


ACTUATOR_NODES: Final = ("Steering", "Throttle", "BrakeServo")


def reset_inhibit(situation: Situation) -> Inhibit:
    """Why a reset is not granted; NONE when it is. The monitor and the gateway are not asked."""
    for node in ACTUATOR_NODES:
        if not situation.alive[node]:
            return _node_inhibit("MISSING", node)
    rules = (
        (not situation.is_standing, Inhibit.MOVING),
        (situation.is_emergency_stop_pressed, Inhibit.EMERGENCY_STOP_PRESSED),
        (bool(situation.blocking_codes), Inhibit.NODE_UNHEALTHY),
    )
    return next((reason for holds, reason in rules if holds), Inhibit.NONE)


def inhibit(situation: Situation) -> Inhibit:
    """What SUPERVISOR_STATE tells: why the car is not in AUTOMATIC, or why not to be reset."""
    if situation.mode in (Mode.AUTOMATIC, Mode.STOPPING):
        return Inhibit.NONE
    if situation.mode is Mode.EMERGENCY:
        blocked = reset_inhibit(situation)
        return Inhibit.CODE_LATCHED if blocked is Inhibit.NONE else blocked
    if situation.mode is Mode.INIT:
        return missing_node(situation) or Inhibit.STARTING
    return engage_inhibit(situation)
