"""An incident in words a driver understands."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import fields
from enum import IntEnum
from typing import Any, Final

from dbc.messages import Mode
from gateway.sentences import MONITOR_TEXT, REASON_TEXT
from gateway.state import message_name
from telemetry.why.evidence import NS_PER_MS, ms, node_text
from telemetry.why.incident import Action, Cause, Claim, Deed, Incident, Kind
from telemetry.why.window import Heard, Silence

Clock = Callable[[int], str]
"""A time in words: `12.340 s`."""

DEED_TEXT: Final[dict[Deed, str]] = {
    Deed.CALLED: "called for an emergency brake",
    Deed.VERDICT: "gave the verdict",
    Deed.MODE: "changed to",
    Deed.STATE: "went to",
    Deed.HELD_STEERING: "held the steering wheel at",
    Deed.COASTED: "let the steering coast",
    Deed.CUT_TORQUE: "cut the drive torque",
    Deed.SET_BRAKE: "told the servo to brake fully",
    Deed.BRAKE_FULL: "had the brake full on, servo at",
    Deed.STOOD: "told that the rear wheels stand",
    Deed.SILENT: "was heard for the last time",
}
assert set(DEED_TEXT) == set(Deed)
BECAUSE: Final = {
    Kind.EMERGENCY_BRAKE: "The car braked because",
    Kind.REFUSED_ENGAGEMENT: "The car did not engage:",
}
assert {*BECAUSE, Kind.DISENGAGEMENT} == set(Kind)


def summary(incident: Incident, clock: Clock) -> str:
    """One or two sentences: what happened, why, since when, who said so."""
    cause = incident.cause
    begin = BECAUSE.get(incident.kind, "")
    if incident.kind is Kind.DISENGAGEMENT:
        begin = "The drive ended" if incident.mode_after is not Mode.STOPPING else (
            "The car began a controlled stop"
        )
        begin += " because"
    text = f"{begin} {cause.text}"
    silence = cause.trigger if isinstance(cause.trigger, Silence) else None
    if silence is not None:
        text += (
            f": its last {silence.spec.name} came at {clock(silence.last.time_ns)} and was overdue "
            f"{ms(silence.timeout_ns)} later"
        )
    elif cause.since_ns is not None and incident.kind is not Kind.REFUSED_ENGAGEMENT:
        text += f", from {clock(cause.since_ns)} on"
    first = incident.first_said
    if first is None:
        return f"{text}."
    return f"{text}. {_said_first(incident, first, clock)}"


def _said_first(incident: Incident, first: Claim, clock: Clock) -> str:
    """Who called for the brake, with the finding that belongs to it."""
    finding = next(
        (claim for claim in incident.claims
         if claim.is_call and claim.finding and claim.node == first.node), first,
    )
    said = MONITOR_TEXT[finding.finding] if finding.finding else REASON_TEXT[first.reason]
    code = f" ({first.code.name})" if first.reason else ""
    about = f": {message_name(finding.identifier)}" if finding.about is not None else ""
    node = node_text(first.node)
    return f"At {clock(first.time_ns)} {node} said so first: {said}{about}{code}."


def lines_of(incident: Incident, clock: Clock) -> Iterator[str]:
    """All there is to tell, the summary first."""
    modes = f"{_mode(incident.mode_before)} -> {_mode(incident.mode_after)}"
    kind = incident.kind.replace("_", " ")
    codes = f", {' '.join(code.name for code in incident.codes)}" if incident.codes else ""
    is_refusal = incident.kind is Kind.REFUSED_ENGAGEMENT
    yield f"{clock(incident.time_ns)}  {kind}" + ("" if is_refusal else f", {modes}{codes}")
    yield f"  {summary(incident, clock)}"
    for remark in incident.remarks:
        yield f"  note: {remark}"
    for cause in incident.causes[1:]:
        since = "" if cause.since_ns is None else f" ({clock(cause.since_ns)})"
        yield f"  also: {cause.text}{since}"
    yield from _trigger(incident.cause, clock)
    for budget in incident.budgets:
        took = "not within a second" if budget.took_ns is None else ms(budget.took_ns)
        verdict = "kept" if budget.is_kept else "EXCEEDED"
        yield f"  time: {budget.name} {took} of {ms(budget.limit_ns)}: {verdict}"
    for action in incident.actions:
        yield f"  {_relative(action.time_ns - incident.time_ns)}  {_did(action)}"


def _trigger(cause: Cause, clock: Clock) -> Iterator[str]:
    if isinstance(cause.trigger, Silence):
        silence = cause.trigger
        back = "not heard again" if silence.back_ns is None else (
            f"back at {clock(silence.back_ns)}"
        )
        yield (
            f"  missing: {message_name(silence.spec.can_id)}, time-out {ms(silence.timeout_ns)}, "
            f"overdue since {clock(silence.overdue_ns)}, {back}"
        )
        yield f"  last: {frame_text(silence.last, clock)}"
        for row in silence.ignored[:1]:
            yield f"  ignored: {frame_text(row, clock)}"
    elif cause.trigger is not None:
        yield f"  frame: {frame_text(cause.trigger, clock)}"


def frame_text(row: Heard, clock: Clock) -> str:
    """A frame with its time, bytes and content."""
    name = message_name(row.frame.can_id)
    wrong = "" if row.fault is None else f" [{row.fault.name.lower()}]"
    values = "" if row.content is None else "  " + " ".join(
        f"{key}={value}" for key, value in signals_of(row.content).items()
    )
    data = row.frame.data.hex(" ").upper()
    return f"{clock(row.time_ns)} {name} [{len(row.frame.data)}] {data}{wrong}{values}".rstrip()


def signals_of(content: Any) -> dict[str, float | int | bool | str | None]:
    """Signals by name; enumerations by name, None for "not available"."""
    return {field.name: _value(getattr(content, field.name)) for field in fields(content)}


def _value(value: Any) -> float | int | bool | str | None:
    if isinstance(value, IntEnum):
        return value.name
    if isinstance(value, float):
        return None if math.isnan(value) else round(value, 6)
    return value if isinstance(value, bool | int) else str(value)


def _did(action: Action) -> str:
    text = DEED_TEXT[action.deed]
    detail = f" {action.detail}" if action.detail else ""
    if action.deed is Deed.CALLED:
        detail = f" ({action.detail})"
    return f"{node_text(action.node).removeprefix('the ')} {text}{detail}"


def _mode(mode: Mode | None) -> str:
    return "?" if mode is None else mode.name


def _relative(span_ns: int) -> str:
    return f"{span_ns / NS_PER_MS:+8.1f} ms"


