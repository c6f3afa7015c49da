"""From what was said to what was wrong: a rule for every reason and every finding."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final

from dbc.endpoint import ID_OF_NAME, SPEC_OF_NAME
from dbc.messages import MonitorReason, NmtCommand, Reason, Request
from gateway.sentences import MONITOR_TEXT, REASON_TEXT
from gateway.state import message_name, verdict_text
from telemetry.why.absence import no_command, unheard
from telemetry.why.claims import FOLLOWING
from telemetry.why.drives import drives_away, motor_fault, node_silent
from telemetry.why.evidence import NS_PER_MS, SOON_NS, Evidence, Rule, node_text
from telemetry.why.incident import Cause, CauseKind, Claim
from telemetry.why.traffic import boot_of, intruded, repeated, strayed, whole_bus
from telemetry.why.window import Heard

TOGETHER_NS: Final = 60 * NS_PER_MS
"""Causes said within this of the first are told as having come together."""
GONE: Final = frozenset(
    {CauseKind.NODE_SILENT, CauseKind.NODE_RESTARTED, CauseKind.NODE_BUS_OFF}
)
READINGS: Final = {
    "Steering": (
        ("STEER_STATUS", "steering_wheel_angle_rad"), ("STEER_DRIVER", "torque_nm"),
    ),
    "Throttle": (("THROTTLE_STATUS", "wheel_speed_radps"), ("THROTTLE_DRIVER", "pedal_ratio")),
    "BrakeServo": (
        ("BRAKE_STATUS", "servo_position_ratio"), ("BRAKE_STATUS", "rear_wheel_speed_radps"),
        ("BRAKE_DRIVER", "pedal_ratio"),
    ),
}
"""By node, the signals that tell what its sensors read."""
IMPOSSIBLE: Final = 2.0
"""Times the envelope's rate: so fast turns no steering wheel, only a sensor's reading."""
AXLES_NS: Final = 500 * NS_PER_MS
"""Over this the axle whose speed changed more is the one that lies."""


def causes_of(evidence: Evidence) -> tuple[Cause, ...]:
    """The causes of an emergency brake: the first is the cause; never empty."""
    for rule in (whole_bus, intruded, repeated):
        found = list(rule(evidence))
        if found:
            return tuple(_distinct(found))
    found = list(_distinct(_of_claims(evidence))) or list(strayed(evidence))
    return tuple(found) or (_unknown(evidence),)


def _of_claims(evidence: Evidence) -> Iterator[Cause]:
    calls = evidence.calls
    first_ns = calls[0].time_ns if calls else evidence.at_ns
    own = [claim for claim in calls if not _is_following(claim)]
    own = [claim for claim in own if not _is_repetition(claim, own)]
    for claim in own:
        if claim.time_ns <= first_ns + TOGETHER_NS:
            rule = FINDING_RULES[claim.finding] if claim.finding else REASON_RULES[claim.reason]
            yield from rule(evidence, claim)
    if not own:
        yield from _of_reports(evidence)


def _is_following(claim: Claim) -> bool:
    return claim.reason in FOLLOWING and claim.reason is not Reason.FAILSAFE_FRAME


def _is_repetition(claim: Claim, others: list[Claim]) -> bool:
    """The supervisor passes on what others have called, with their reason."""
    return claim.node == "Supervisor" and any(
        other.node != claim.node and other.reason is claim.reason
        and other.time_ns < claim.time_ns
        for other in others
    )


def _of_reports(evidence: Evidence) -> Iterator[Cause]:
    """Nobody called with a reason of his own: who reports a code, or restarted?"""
    for claim in evidence.claims:
        is_near = claim.time_ns <= evidence.at_ns + SOON_NS
        if is_near and not claim.is_call and not _is_following(claim) and not claim.finding:
            rule = REASON_RULES[claim.reason]
            if claim.reason is not Reason.BAD_FRAME:
                yield from rule(evidence, claim)
    boot = boot_of(evidence.window, "Supervisor", evidence.at_ns - SOON_NS)
    if boot is not None:
        yield Cause(
            kind=CauseKind.NODE_RESTARTED, subject="Supervisor", since_ns=boot.time_ns,
            trigger=boot, text="the supervisor started anew and found the car driving itself",
        )


def _distinct(causes: Iterable[Cause]) -> Iterator[Cause]:
    """Each once; and of a node that is gone, its messages need not be told."""
    seen: set[tuple[CauseKind, str]] = set()
    gone: set[str] = set()
    for cause in causes:
        spec = SPEC_OF_NAME.get(cause.subject)
        is_of_gone = spec is not None and spec.sender in gone
        if (cause.kind, cause.subject) not in seen and not is_of_gone:
            seen.add((cause.kind, cause.subject))
            if cause.kind in GONE:
                gone.add(cause.subject)
            yield cause


def _unknown(evidence: Evidence) -> Cause:
    return Cause(
        kind=CauseKind.UNKNOWN, subject="", since_ns=None,
        trigger=evidence.calls[0].heard if evidence.calls else None,
        text=f"{_said(evidence.calls[0])}" if evidence.calls
        else "the frames do not tell what led to it",
    )


def _said(claim: Claim) -> str:
    """What a claim says, in the nodes' own words."""
    if claim.finding:
        return f"{node_text(claim.node)} found: {verdict_text(claim.heard.content)}"
    return REASON_TEXT[claim.reason]


# Reasons of EMERGENCY_BRAKE and EMCY ----------------------------------------------------------


def _late(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    yield Cause(
        kind=CauseKind.NODE_LATE, subject=claim.node, since_ns=claim.since_ns,
        trigger=claim.heard, text=f"{node_text(claim.node)} ran late: its computer is overloaded, "
        "or its clock was set",
    )


def _sensor(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    """Which reading of the node, or of the message found, is not there."""
    node = claim.node if claim.about is None else claim.about.sender or claim.node
    away = drives_away(evidence, node, claim.time_ns)
    if away:  # who told it what it reads
        yield from away
        return
    subject, trigger = _lost_reading(evidence, node, claim.time_ns)
    what = f"{subject} could not be read" if subject else "a sensor was out of bounds"
    yield Cause(
        kind=CauseKind.SENSOR, subject=subject or node, since_ns=claim.since_ns,
        trigger=trigger or claim.heard, text=f"a sensor of {node_text(node)} failed: {what}",
    )


def _lost_reading(evidence: Evidence, node: str, at_ns: int) -> tuple[str, Heard | None]:
    for name, signal in READINGS.get(node, ()):
        for row in evidence.window.after(name, at_ns - SOON_NS // 2):
            if row.time_ns > at_ns + SOON_NS:
                break
            if math.isnan(getattr(row.content, signal)):
                return f"{name}.{signal}", row
    return "", None


def _simple(kind: CauseKind, text: str, *, has_subject: bool = True) -> Rule:
    """A reason that says all there is to say; `{node}` is who said it."""

    def rule(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
        yield Cause(
            kind=kind, subject=claim.node if has_subject else "", since_ns=claim.since_ns,
            trigger=claim.heard, text=text.format(node=node_text(claim.node)),
        )

    return rule


def _nmt(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    commands = [
        row for row in evidence.window.usable("NMT")
        if abs(row.time_ns - claim.time_ns) <= SOON_NS
        and row.content.command is not NmtCommand.START
    ]
    what = commands[-1].content.command.name if commands else "a command"
    yield Cause(
        kind=CauseKind.NMT_COMMAND, subject=claim.node, since_ns=claim.since_ns,
        trigger=commands[-1] if commands else claim.heard,
        text=f"{node_text(claim.node)} was told over the bus to stop (NMT {what})",
    )


def _requested(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    requests = [
        row for row in evidence.window.usable("MODE_REQUEST")
        if row.time_ns <= claim.time_ns and row.content.request is Request.EMERGENCY_STOP
    ]
    yield Cause(
        kind=CauseKind.PLANNER_REQUEST, subject="", since_ns=claim.since_ns,
        trigger=requests[0] if requests else claim.heard,
        text="the planner asked for an emergency brake",
    )


def _plain(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    yield Cause(
        kind=CauseKind.UNKNOWN, subject=claim.node, since_ns=claim.since_ns, trigger=claim.heard,
        text=f"{node_text(claim.node)} said: {_said(claim)}",
    )


def _nothing(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    return iter(())


_K = CauseKind
REASON_RULES: Final[dict[Reason, Rule]] = {
    Reason.NONE: _plain,
    Reason.EMERGENCY_STOP_INPUT: _simple(
        _K.EMERGENCY_STOP, "the emergency stop was pressed", has_subject=False
    ),
    Reason.FAILSAFE_FRAME: _simple(
        _K.FAILSAFE, "somebody sent the global fail-safe command", has_subject=False
    ),
    Reason.NODE_EMERGENCY: _nothing,
    Reason.VERDICT_BRAKE: _nothing,
    Reason.VERDICT_MISSING: unheard,
    Reason.PLANNER_SILENT: no_command,
    Reason.COMMAND_MISSING: no_command,
    Reason.SUPERVISOR_SILENT: unheard,
    Reason.NODE_SILENT: node_silent,
    Reason.LATE: _late,
    Reason.OVERRUNS: _late,
    Reason.MOTOR_FAULT: motor_fault,
    Reason.SENSOR_OUT_OF_BOUNDS: _sensor,
    Reason.SERVO_ON_TOO_LONG: _simple(_K.BRAKE_SERVO, "the brake servo was on for too long"),
    Reason.SERVO_STUCK: _simple(_K.BRAKE_SERVO, "the brake servo did not follow"),
    Reason.FOREIGN_SENDER: _simple(
        _K.FOREIGN_SENDER, "somebody else sent a message that is {node}'s alone"
    ),
    Reason.NMT_COMMAND: _nmt,
    Reason.BUS_OFF: _simple(_K.NODE_BUS_OFF, "{node} was off the bus (bus-off)"),
    Reason.DRIVER_AGAINST_SYSTEM: _simple(
        _K.DRIVER, "the driver acted against the system", has_subject=False
    ),
    Reason.REQUESTED: _requested,
    Reason.BAD_FRAME: _plain,
    Reason.ADOPTED: _nothing,
    Reason.BRAKING_IN_PROGRESS: _nothing,
}
assert set(REASON_RULES) == set(Reason)


# Findings of the safety monitor ---------------------------------------------------------------


def _follows_not(node: str) -> Rule:
    def rule(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
        subject = node or _lying_axle(evidence, claim)
        shown = _shown(evidence, claim)
        if subject:
            text = (
                f"{node_text(subject)} was not where it was sent: "
                f"{verdict_text(claim.heard.content)}"
            )
        else:
            text = "front and rear wheels told different speeds"
        yield Cause(
            kind=_K.NOT_FOLLOWING, subject=subject, since_ns=claim.since_ns, trigger=shown,
            text=text,
        )

    return rule


def _lying_axle(evidence: Evidence, claim: Claim) -> str:
    """Of two speeds that differ, the node whose reading changed more of late."""
    if claim.identifier != ID_OF_NAME["BRAKE_STATUS"]:
        return "Throttle"
    changes = {}
    for node, name, signal in (
        ("Throttle", "THROTTLE_STATUS", "wheel_speed_radps"),
        ("BrakeServo", "BRAKE_STATUS", "rear_wheel_speed_radps"),
    ):
        before = evidence.window.newest(name, claim.time_ns - AXLES_NS)
        now = evidence.window.newest(name, claim.time_ns)
        if before is None or now is None:
            return ""
        changes[node] = abs(getattr(now.content, signal) - getattr(before.content, signal))
    return max(changes, key=lambda node: changes[node])


def _shown(evidence: Evidence, claim: Claim) -> Heard:
    """The newest frame that a finding is about, as it was when it was found."""
    if claim.about is None:
        return claim.heard
    return evidence.window.newest(claim.about.name, claim.time_ns) or claim.heard


def _envelope(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    subject = None if claim.about is None else claim.about.sender
    yield Cause(
        kind=_K.ENVELOPE, subject=subject or "", since_ns=claim.since_ns,
        trigger=_shown(evidence, claim), text=verdict_text(claim.heard.content),
    )


def _steering_rate(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    """A wheel that turns too fast, or a reading that jumps as no wheel can."""
    name, signal = READINGS["Steering"][0]
    limit_radps = IMPOSSIBLE * evidence.vehicle.envelope.wheel_rate_radps_max
    before: Heard | None = None
    for row in evidence.window.after(name, claim.time_ns - SOON_NS):
        if row.time_ns > claim.time_ns:
            break
        if before is not None and row.time_ns > before.time_ns:
            span_s = (row.time_ns - before.time_ns) * 1e-9
            step_rad = abs(getattr(row.content, signal) - getattr(before.content, signal))
            if step_rad > limit_radps * span_s:
                yield Cause(
                    kind=_K.SENSOR, subject=f"{name}.{signal}", since_ns=row.time_ns, trigger=row,
                    text=f"the steering angle's reading jumped by {step_rad:.2f} rad within "
                    f"{span_s * 1e3:.0f} ms, as no wheel can: its sensor",
                )
                return
        before = row
    yield from _envelope(evidence, claim)


def _rule_broken(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    yield Cause(
        kind=_K.MODE_RULE, subject="Supervisor", since_ns=claim.since_ns,
        trigger=_shown(evidence, claim), text=verdict_text(claim.heard.content),
    )


def _stopped(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    """The stop line, or a FAILSAFE frame."""
    if claim.about is not None:
        failsafes = evidence.window.usable("FAILSAFE")
        near = [row for row in failsafes if abs(row.time_ns - claim.time_ns) <= SOON_NS]
        yield Cause(
            kind=_K.FAILSAFE, subject="", since_ns=claim.since_ns,
            trigger=near[0] if near else claim.heard,
            text="somebody sent the global fail-safe command",
        )
        return
    yield from REASON_RULES[Reason.EMERGENCY_STOP_INPUT](evidence, claim)


def _found(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    about = f" ({message_name(claim.identifier)})" if claim.identifier else ""
    yield Cause(
        kind=_K.UNKNOWN, subject="", since_ns=claim.since_ns, trigger=_shown(evidence, claim),
        text=f"the safety monitor found: {MONITOR_TEXT[claim.finding]}{about}",
    )


_R = MonitorReason
FINDING_RULES: Final[dict[MonitorReason, Rule]] = {
    _R.NONE: _found,
    _R.STARTING: _found,
    _R.FRAME_MISSING: unheard,
    _R.FRAME_LATE: unheard,
    _R.UNKNOWN_IDENTIFIER: _found,
    _R.RATE_TOO_HIGH: _found,
    _R.BAD_FRAME: _found,
    _R.SPEED: _envelope,
    _R.STEERING_ANGLE: _envelope,
    _R.STEERING_RATE: _steering_rate,
    _R.LATERAL_ACCELERATION: _envelope,
    _R.LATERAL_JERK: _envelope,
    _R.STEERING_DIVERGENCE: _follows_not("Steering"),
    _R.SPEED_DIVERGENCE: _follows_not(""),
    _R.BRAKE_DIVERGENCE: _follows_not("BrakeServo"),
    _R.COMMAND_STALE: no_command,
    _R.MODE_RULE: _rule_broken,
    _R.EMERGENCY_STOP: _stopped,
    _R.FOREIGN_SENDER: _found,
    _R.AUTHORISATION_RULE: _rule_broken,
    _R.LATE: _late,
    _R.VALUE_NOT_AVAILABLE: _sensor,
    _R.ERROR_REPORTED: _found,
}
assert set(FINDING_RULES) == set(MonitorReason)
