"""Causes that are an absence: a node, a message, a decision that did not come."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from canbus.node import PERIOD_NS
from dbc.codec import FrameFault
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import SPECS, Mode, Reason
from gateway.state import message_name
from telemetry.why.evidence import NS_PER_MS, SOON_NS, Evidence, ms, node_text
from telemetry.why.incident import Cause, CauseKind, Claim
from telemetry.why.traffic import boot_of
from telemetry.why.window import Heard, Silence, Window

COMMANDS: Final = ("STEER_COMMAND", "THROTTLE_COMMAND", "BRAKE_COMMAND")
COMMAND_OF: Final = {"Steering": COMMANDS[0], "Throttle": COMMANDS[1], "BrakeServo": COMMANDS[2]}
COMMAND_AWAY_NS: Final = 50_000_000
"""Commands that stay away longer than this are said to be missing (`actuator_ecu.py`)."""
JUMP_MS: Final = 40.0
"""A decision cannot grow older by this much more than the time that passes."""
NEEDED: Final = tuple(
    spec.name for spec in SPECS.values() if spec.timeout_ns and spec.data_id is not None
)
"""Messages without which the car must not drive."""

WRONG: Final = {
    FrameFault.KIND: "of the wrong kind",
    FrameFault.LENGTH: "of the wrong length",
    FrameFault.CRC: "with a wrong CRC",
    FrameFault.SEQUENCE: "out of sequence",
    FrameFault.REPEATED: "repeated",
    FrameFault.VALUE: "with a value that cannot be",
}
assert set(WRONG) == set(FrameFault)


def silent(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    """Everything that had to come and did not, first what was overdue first."""
    silences = [
        silence for name in NEEDED
        if (silence := _silence(evidence, name, claim)) is not None
    ]
    silences.sort(key=lambda silence: (silence.overdue_ns, silence.last.time_ns))
    told: set[str] = set()
    for silence in silences:
        node = silence.spec.sender or ""
        if node not in told:
            cause = _of_silence(evidence.window, silence, node, claim.time_ns)
            if cause.kind is not CauseKind.MESSAGE_MISSING:
                told.add(node)
            yield cause


def _silence(evidence: Evidence, name: str, claim: Claim) -> Silence | None:
    """A message's silence at the time of the claim, if it began early enough to be its reason."""
    timeout_ns = SPEC_OF_NAME[name].timeout_ns
    if claim.reason is Reason.COMMAND_MISSING and name in COMMANDS:
        timeout_ns = min(timeout_ns, COMMAND_AWAY_NS)
    silence = evidence.window.silence(name, claim.time_ns, timeout_ns)
    if silence is None or silence.overdue_ns > claim.time_ns:
        return None
    return silence


def _of_silence(window: Window, silence: Silence, node: str, at_ns: int) -> Cause:
    last_ns, name = silence.last.time_ns, message_name(silence.spec.can_id)
    kind, text = CauseKind.MESSAGE_MISSING, f"{node_text(node)} did not send {name} any more"
    subject = silence.spec.name
    signs = list(window.sent_by(node, last_ns + PERIOD_NS, at_ns))
    boot = boot_of(window, node, last_ns)
    if silence.ignored:
        fault = silence.ignored[0].fault
        assert fault is not None
        kind = CauseKind.MESSAGE_UNUSABLE
        text = f"{node_text(node)}'s {name} came {WRONG[fault]}, and had to be ignored"
    elif boot is not None and not signs:
        kind, subject = CauseKind.NODE_RESTARTED, node
        text = f"{node_text(node)} fell silent, and started anew {ms(boot.time_ns - last_ns)} later"
    elif not signs:
        kind, subject = CauseKind.NODE_SILENT, node
        text = f"{node_text(node)} fell silent"
        if _told_bus_off(window, node, last_ns):
            kind, text = CauseKind.NODE_BUS_OFF, f"{node_text(node)} was off the bus (bus-off)"
    return Cause(kind=kind, subject=subject, since_ns=last_ns, trigger=silence, text=text)


def _told_bus_off(window: Window, node: str, from_ns: int) -> bool:
    """Whether a node says afterwards that it was bus-off."""
    return any(
        getattr(row.content, "reason", None) is Reason.BUS_OFF
        for row in window.sent_by(node, from_ns, window.end_ns)
    )


def unheard(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    """A node says that something is missing: it is, or the node does not hear."""
    causes = list(silent(evidence, claim))
    if causes:
        yield from causes
        return
    if claim.reason is Reason.SUPERVISOR_SILENT:
        state = evidence.window.newest("SUPERVISOR_STATE", claim.time_ns)
        if state is not None and state.content.mode is Mode.INIT:
            yield Cause(
                kind=CauseKind.NODE_RESTARTED, subject="Supervisor", since_ns=state.time_ns,
                trigger=state, text="the supervisor started anew while the car drove itself",
            )
            return
    yield deaf(evidence, claim)


def deaf(evidence: Evidence, claim: Claim) -> Cause:
    """Of a node that misses what was there: it does not hear."""
    name = "SUPERVISOR_STATE" if claim.about is None else claim.about.name
    trigger = evidence.window.newest(name, claim.time_ns)
    return Cause(
        kind=CauseKind.NODE_DEAF, subject=claim.node, since_ns=claim.since_ns, trigger=trigger,
        text=f"{node_text(claim.node)} no longer heard the bus: what it missed was there all the "
        "time",
    )


def no_command(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    """ER5: the commands do not come, or carry a decision that grows old."""
    if claim.reason is Reason.COMMAND_MISSING:
        causes = list(silent(evidence, claim))
        yield from causes or [deaf(evidence, claim)]
        return
    name = COMMAND_OF.get(claim.node, COMMANDS[0]) if claim.about is None else claim.about.name
    newest = evidence.window.newest(name, claim.time_ns)
    if newest is not None and _jumps(evidence.window, newest, name):
        yield Cause(
            kind=CauseKind.NODE_LATE, subject="Gateway", since_ns=newest.time_ns, trigger=newest,
            text="the gateway ran late, or its clock was set: the age of the planner's decision "
            f"in {name} jumped",
        )
        return
    causes = list(silent(evidence, claim))
    if any(cause.subject in (*COMMANDS, "Gateway") for cause in causes):
        yield from causes
        return
    yield Cause(
        kind=CauseKind.PLANNER_SILENT, subject="", since_ns=claim.since_ns, trigger=newest,
        text="the planner did not decide any more: the gateway's commands came, with a decision "
        "that grew old",
    )


def _jumps(window: Window, newest: Heard, name: str) -> bool:
    """Whether a decision's age grew by more than the time that passed, within the last frames."""
    before: Heard | None = None
    for row in window.after(name, newest.time_ns - SOON_NS):
        if row.time_ns > newest.time_ns:
            return False
        if before is not None:
            passed_ms = (row.time_ns - before.time_ns) / NS_PER_MS
            grown_ms = row.content.decision_age_ms - before.content.decision_age_ms
            if grown_ms - passed_ms > JUMP_MS:
                return True
        before = row
    return False


