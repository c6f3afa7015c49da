"""From the first sign of an incident, and the frames around it, to all that is told of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from canbus.frame import Frame
from dbc.messages import ErrorCode, Mode
from gateway.state import codes_of
from oracle.settings import Settings
from telemetry.why.actions import actions_of, brake_budgets, handover_budget
from telemetry.why.causes import causes_of
from telemetry.why.claims import claims_of
from telemetry.why.driver import wish_of
from telemetry.why.evidence import SOON_NS, Evidence, ms
from telemetry.why.incident import (
    Budget,
    Cause,
    CauseKind,
    Incident,
    Kind,
    Refusal,
)
from telemetry.why.window import Heard, Window
from vehicles import Vehicle


@dataclass(frozen=True, slots=True, kw_only=True)
class Sign:
    """The first frame that shows an incident.

    Attributes:
        kind: Of the incident.
        time_ns: Of that frame; of a request to engage, its first.
        mode_before: The driving mode until then; None: not heard.
        refusals: What stood against engaging.
    """

    kind: Kind
    time_ns: int
    mode_before: Mode | None
    refusals: tuple[Refusal, ...] = ()


def explain(
    sign: Sign, frames: Sequence[tuple[int, Frame]], vehicle: Vehicle, *, is_cut: bool
) -> Incident:
    """All that is told of one incident.

    Args:
        sign: Of it.
        frames: Of the second before it and the second after, as far as there are any.
        vehicle: What the nodes believe about the car.
        is_cut: The frames ended before its second after had passed.
    """
    window = Window(frames)
    mode_heard = _mode_after(window, sign)
    evidence = Evidence(
        window=window, claims=claims_of(window, sign.time_ns), at_ns=sign.time_ns,
        mode_before=sign.mode_before, vehicle=vehicle,
    )
    mode_after = None if mode_heard is None else mode_heard.content.mode
    causes = _causes(sign, evidence, mode_after)
    is_refusal = sign.kind is Kind.REFUSED_ENGAGEMENT
    return Incident(
        kind=sign.kind, time_ns=sign.time_ns, mode_before=sign.mode_before,
        mode_after=mode_after, mode_heard=mode_heard, causes=causes,
        claims=tuple(evidence.claims), actions=() if is_refusal else tuple(actions_of(evidence)),
        budgets=tuple(_budgets(sign, evidence, causes[0], mode_heard)),
        refusals=sign.refusals, codes=_codes(window, sign.time_ns),
        remarks=tuple(_remarks(sign, evidence, causes[0], is_cut=is_cut)),
        begin_ns=window.begin_ns, end_ns=window.end_ns,
    )


def _mode_after(window: Window, sign: Sign) -> Heard | None:
    """The frame that told the mode in which it led; a mode told for a moment does not count."""
    rows = [
        row for row in window.after("SUPERVISOR_STATE", sign.time_ns)
        if row.content.mode is not sign.mode_before
    ]
    if sign.kind is Kind.EMERGENCY_BRAKE:
        braking = [row for row in rows if row.content.mode is Mode.EMERGENCY]
        rows = braking or rows
    return rows[0] if rows else None


def _causes(sign: Sign, evidence: Evidence, mode_after: Mode | None) -> tuple[Cause, ...]:
    if sign.kind is Kind.REFUSED_ENGAGEMENT:
        return _refused(sign, evidence)
    if sign.kind is Kind.DISENGAGEMENT:
        return wish_of(evidence, mode_after)
    return causes_of(evidence)


def _refused(sign: Sign, evidence: Evidence) -> tuple[Cause, ...]:
    """What stood against it, the last that was told first: it is what stood until the end."""
    causes = tuple(
        Cause(
            kind=CauseKind.INHIBITED, subject=refusal.inhibit.name, since_ns=refusal.time_ns,
            trigger=evidence.window.newest("SUPERVISOR_STATE", refusal.time_ns), text=refusal.text,
        )
        for refusal in reversed(sign.refusals)
    )
    if causes:
        return causes
    is_heard = any(True for _ in evidence.window.after("SUPERVISOR_STATE", sign.time_ns))
    text = (
        "the request ended before the supervisor granted it" if is_heard
        else "no supervisor was heard"
    )
    return (
        Cause(kind=CauseKind.UNKNOWN, subject="", since_ns=None, trigger=None, text=text),
    )


def _budgets(
    sign: Sign, evidence: Evidence, cause: Cause, mode_heard: Heard | None
) -> Iterator[Budget]:
    settings = Settings.of(evidence.vehicle)
    if sign.kind is Kind.EMERGENCY_BRAKE:
        yield from brake_budgets(evidence, cause, settings)
    elif sign.kind is Kind.DISENGAGEMENT:
        yield from handover_budget(evidence, cause, mode_heard, settings)


def _codes(window: Window, at_ns: int) -> tuple[ErrorCode, ...]:
    """All codes that the supervisor told from the first sign on."""
    found: set[ErrorCode] = set()
    for row in window.after("SUPERVISOR_STATE", at_ns):
        found |= set(codes_of(row.content))
    return tuple(sorted(found))


def _remarks(
    sign: Sign, evidence: Evidence, cause: Cause, *, is_cut: bool
) -> Iterator[str]:
    window = evidence.window
    if sign.mode_before is None and sign.kind is not Kind.REFUSED_ENGAGEMENT:
        yield "the frames begin in the middle of it: what led to it is not among them"
    elif sign.time_ns - window.begin_ns < SOON_NS:
        yield f"only {ms(sign.time_ns - window.begin_ns)} before it are known"
    quiet = window.quiet(window.end_ns)
    if quiet is not None and cause.kind not in (CauseKind.BUS_SILENT, CauseKind.POWER_LOST):
        yield (
            f"nothing was heard for {ms(quiet[1] - quiet[0])}: a silent bus and a recorder that "
            "missed it look alike"
        )
    if is_cut and sign.kind is not Kind.REFUSED_ENGAGEMENT:
        yield f"the frames end {ms(window.end_ns - sign.time_ns)} after it began"
