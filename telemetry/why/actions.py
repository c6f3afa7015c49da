"""What each node did from the first sign on, and when; and how long that took."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from canbus.node import NODE_IDS
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import Mode, NodeState, Verdict
from oracle.hazards import FULL_RATIO
from oracle.settings import SENSED_NS, SILENT_NS, Settings
from telemetry.why.absence import COMMANDS
from telemetry.why.evidence import NS_PER_MS, NS_PER_S, Evidence
from telemetry.why.incident import Action, Budget, Cause, CauseKind, Deed
from telemetry.why.window import Heard, Silence

DRIVERS: Final = {
    "Steering": "STEER_DRIVER", "Throttle": "THROTTLE_DRIVER", "BrakeServo": "BRAKE_DRIVER"
}
SAFE: Final = frozenset({NodeState.SAFE_ALONE, NodeState.EMERGENCY})
FULL: Final = 1.0
STANDING_RADPS: Final = 0.5
"""Of the rear wheels: some 0.15 m/s, what `oracle.settings` takes for standing."""
LIFE_NS: Final = SPEC_OF_NAME["SUPERVISOR_HEARTBEAT"].timeout_ns
"""A node that lives has sent its heartbeat by then."""
MARGIN_NS: Final = SILENT_NS - SPEC_OF_NAME["SUPERVISOR_STATE"].timeout_ns
"""What is allowed beyond a time-out: a cycle and the wire."""


def actions_of(evidence: Evidence) -> list[Action]:
    """In order of time."""
    found = [
        *_called(evidence), *_modes(evidence), *_states(evidence), *_steering(evidence),
        *_torque(evidence), *_brake(evidence), *_silent(evidence),
    ]
    return sorted(found, key=lambda action: (action.time_ns, NODE_IDS.get(action.node, 0)))


def _called(evidence: Evidence) -> Iterator[Action]:
    told: set[str] = set()
    for claim in evidence.calls:
        if claim.finding:
            detail = f"{Verdict.BRAKE.name} {claim.finding.name}"
            yield Action(
                time_ns=claim.time_ns, node=claim.node, deed=Deed.VERDICT, detail=detail
            )
        elif claim.node not in told:
            told.add(claim.node)
            detail = f"{claim.code.name} {claim.reason.name}"
            yield Action(time_ns=claim.time_ns, node=claim.node, deed=Deed.CALLED, detail=detail)


def _modes(evidence: Evidence) -> Iterator[Action]:
    mode = evidence.mode_before
    for row in evidence.window.after("SUPERVISOR_STATE", evidence.at_ns):
        if row.content.mode is not mode:
            mode = row.content.mode
            yield Action(
                time_ns=row.time_ns, node="Supervisor", deed=Deed.MODE, detail=row.content.mode.name
            )


def _states(evidence: Evidence) -> Iterator[Action]:
    for node, name in DRIVERS.items():
        newest = evidence.window.newest(name, evidence.at_ns - 1)
        state = None if newest is None else newest.content.node_state
        for row in evidence.window.after(name, evidence.at_ns):
            if row.content.node_state is not state:
                state = row.content.node_state
                detail = row.content.node_state.name
                yield Action(time_ns=row.time_ns, node=node, deed=Deed.STATE, detail=detail)


def _first(evidence: Evidence, name: str, signal: str, is_it: object) -> Heard | None:
    assert callable(is_it)
    for row in evidence.window.after(name, evidence.at_ns):
        if is_it(getattr(row.content, signal)):
            return row
    return None


def _steering(evidence: Evidence) -> Iterator[Action]:
    signal = "applied_steering_wheel_angle_rad"
    before = evidence.window.newest("STEER_STATUS", evidence.at_ns)
    if before is None or math.isnan(getattr(before.content, signal)):
        return  # it did not steer
    coasts = _first(evidence, "STEER_STATUS", signal, math.isnan)
    if coasts is not None:
        yield Action(time_ns=coasts.time_ns, node="Steering", deed=Deed.COASTED)
        return
    rows = list(evidence.window.after("STEER_STATUS", evidence.at_ns))
    if rows:
        angle_rad = getattr(rows[-1].content, signal)
        yield Action(
            time_ns=rows[0].time_ns, node="Steering", deed=Deed.HELD_STEERING,
            detail=f"{angle_rad:.2f} rad",
        )


def _torque(evidence: Evidence) -> Iterator[Action]:
    signal = "applied_wheel_speed_radps"
    before = evidence.window.newest("THROTTLE_STATUS", evidence.at_ns)
    if before is None or math.isnan(getattr(before.content, signal)):
        return
    cut = _first(evidence, "THROTTLE_STATUS", signal, math.isnan)
    if cut is not None:
        yield Action(time_ns=cut.time_ns, node="Throttle", deed=Deed.CUT_TORQUE)


def _brake(evidence: Evidence) -> Iterator[Action]:
    asked = _first(evidence, "BRAKE_STATUS", "applied_position_ratio", lambda ratio: ratio >= FULL)
    full = _first(evidence, "BRAKE_STATUS", "servo_position_ratio", lambda r: r >= FULL_RATIO)
    if asked is not None:
        yield Action(time_ns=asked.time_ns, node="BrakeServo", deed=Deed.SET_BRAKE)
    if full is not None and asked is not None:
        detail = f"{full.content.servo_position_ratio:.2f}"
        yield Action(
            time_ns=full.time_ns, node="BrakeServo", deed=Deed.BRAKE_FULL, detail=detail
        )
    before = evidence.window.newest("BRAKE_STATUS", evidence.at_ns)
    if before is None or not abs(before.content.rear_wheel_speed_radps) > STANDING_RADPS:
        return
    stood = _first(
        evidence, "BRAKE_STATUS", "rear_wheel_speed_radps", lambda v: abs(v) <= STANDING_RADPS
    )
    if stood is not None:
        yield Action(time_ns=stood.time_ns, node="BrakeServo", deed=Deed.STOOD)


def _silent(evidence: Evidence) -> Iterator[Action]:
    """Nodes of which nothing is heard from the first sign on."""
    window, at_ns = evidence.window, evidence.at_ns
    if window.end_ns - at_ns < LIFE_NS:
        return
    for node in NODE_IDS:
        before = list(window.sent_by(node, window.begin_ns, at_ns))
        if before and not any(True for _ in window.sent_by(node, at_ns + 1, window.end_ns)):
            yield Action(time_ns=before[-1].time_ns, node=node, deed=Deed.SILENT)


def brake_budgets(evidence: Evidence, cause: Cause, settings: Settings) -> Iterator[Budget]:
    """From the cause to the first call, and from the call to the full brake."""
    calls = evidence.calls
    if not calls:
        return
    first = calls[0]
    if isinstance(cause.trigger, Silence):
        limit_ns = cause.trigger.timeout_ns + MARGIN_NS
        if cause.trigger.spec.name in COMMANDS:
            limit_ns = max(limit_ns, _decision_limit_ns(evidence) + MARGIN_NS)
        took_ns = first.time_ns - cause.trigger.last.time_ns
        yield Budget(name="last frame to emergency brake", took_ns=took_ns, limit_ns=limit_ns)
    elif cause.kind is CauseKind.PLANNER_SILENT:
        took_ns = first.time_ns - first.since_ns
        limit_ns = _decision_limit_ns(evidence) + MARGIN_NS
        yield Budget(name="last decision to emergency brake", took_ns=took_ns, limit_ns=limit_ns)
    elif cause.since_ns is not None and cause.kind in SENSED:
        took_ns = first.time_ns - min(cause.since_ns, first.since_ns)
        yield Budget(name="cause to emergency brake", took_ns=took_ns, limit_ns=SENSED_NS)
    full = _first(
        evidence, "BRAKE_STATUS", "servo_position_ratio", lambda ratio: ratio >= FULL_RATIO
    )
    yield Budget(
        name="emergency brake to full brake",
        took_ns=None if full is None else max(full.time_ns - first.time_ns, 0),
        limit_ns=settings.servo_travel_ns + SENSED_NS,
    )


SENSED: Final = frozenset(
    {
        CauseKind.SENSOR, CauseKind.EMERGENCY_STOP, CauseKind.FAILSAFE, CauseKind.NMT_COMMAND,
        CauseKind.MOTOR_FAULT, CauseKind.FOREIGN_SENDER,
        CauseKind.PLANNER_REQUEST, CauseKind.DRIVER,
    }
)
"""Causes that are seen at once: an event, not a silence, and not a limit that must be exceeded for
a while."""


def _decision_limit_ns(evidence: Evidence) -> int:
    """The decision-age limit in force, as the supervisor told it last; 0: not heard."""
    state = evidence.window.newest("SUPERVISOR_STATE", evidence.at_ns)
    if state is None:
        return 0
    told_ms: float = state.content.decision_age_ms_max
    command_ns = round(evidence.vehicle.times.command_timeout_s * NS_PER_S)
    return min(round(told_ms * NS_PER_MS), command_ns)


def handover_budget(
    evidence: Evidence, cause: Cause, mode_heard: Heard | None, settings: Settings
) -> Iterator[Budget]:
    """From the driver's touch, which is debounced before it is told, to MANUAL."""
    if cause.kind is not CauseKind.DRIVER or cause.since_ns is None or mode_heard is None:
        return
    if mode_heard.content.mode is Mode.MANUAL:
        yield Budget(
            name="touch to MANUAL", took_ns=mode_heard.time_ns - cause.since_ns,
            limit_ns=settings.driver_wins_ns,
        )
