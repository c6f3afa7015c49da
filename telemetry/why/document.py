"""Incidents as JSON. The keys are documented in `docs/telemetry.md`, and stay as they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from telemetry.why.incident import Action, Budget, Cause, Claim, Incident
from telemetry.why.window import Heard, Silence
from telemetry.why.words import Clock, signals_of, summary

VERSION: Final = 1
"""Raised when a key changes its meaning or goes; new keys leave it."""
NS_PER_S: Final = 1e9
NS_PER_MS: Final = 1e6

Json = dict[str, Any]


def incident_json(
    incident: Incident, number: int, origin_ns: int, clock: Clock, commands: Sequence[str] = ()
) -> Json:
    """One incident.

    Args:
        incident: To be told.
        number: From 1 on, in order.
        origin_ns: What all times in seconds count from.
        clock: Times in words, for the summary.
        commands: That show or replay this stretch.
    """
    parts, first = _Parts(origin_ns), incident.first_said
    return {
        "number": number,
        "kind": incident.kind.value,
        "at_s": parts.at_s(incident.time_ns),
        "summary": summary(incident, clock),
        "mode_before": None if incident.mode_before is None else incident.mode_before.name,
        "mode_after": None if incident.mode_after is None else incident.mode_after.name,
        "mode_frame": parts.trigger(incident.mode_heard),
        "codes": [code.name for code in incident.codes],
        "cause": parts.cause(incident.cause),
        "other_causes": [parts.cause(item) for item in incident.causes[1:]],
        "first_said": None if first is None else parts.claim(first),
        "said": [parts.claim(item) for item in incident.claims],
        "actions": [parts.action(item) for item in incident.actions],
        "times": [_budget(item) for item in incident.budgets],
        "why_not_engaged": [
            {"at_s": parts.at_s(item.time_ns), "inhibit": item.inhibit.name, "text": item.text}
            for item in incident.refusals
        ],
        "notes": list(incident.remarks),
        "begin_s": parts.at_s(incident.begin_ns),
        "end_s": parts.at_s(incident.end_ns),
        "commands": list(commands),
    }


class _Parts:
    """The parts of an incident, their times from one origin on."""

    def __init__(self, origin_ns: int) -> None:
        self._origin_ns = origin_ns

    def at_s(self, time_ns: int | None) -> float | None:
        return None if time_ns is None else round((time_ns - self._origin_ns) / NS_PER_S, 6)

    def frame(self, row: Heard) -> Json:
        return {
            "type": "frame",
            "at_s": self.at_s(row.time_ns),
            "id": f"0x{row.frame.can_id:03X}",
            "message": None if row.spec is None else row.spec.name,
            "sender": None if row.spec is None else row.spec.sender,
            "data": row.frame.data.hex().upper(),
            "signals": None if row.content is None else signals_of(row.content),
            "ignored_for": None if row.fault is None else row.fault.name,
        }

    def trigger(self, found: Heard | Silence | None) -> Json | None:
        if found is None:
            return None
        if isinstance(found, Heard):
            return self.frame(found)
        return {
            "type": "absence",
            "id": f"0x{found.spec.can_id:03X}",
            "message": found.spec.name,
            "sender": found.spec.sender,
            "last": self.frame(found.last),
            "timeout_ms": found.timeout_ns / NS_PER_MS,
            "overdue_since_s": self.at_s(found.overdue_ns),
            "back_at_s": self.at_s(found.back_ns),
            "ignored": [self.frame(row) for row in found.ignored],
        }

    def cause(self, item: Cause) -> Json:
        return {
            "kind": item.kind.value, "subject": item.subject, "since_s": self.at_s(item.since_ns),
            "text": item.text, "trigger": self.trigger(item.trigger),
        }

    def claim(self, item: Claim) -> Json:
        return {
            "at_s": self.at_s(item.time_ns), "node": item.node, "code": item.code.name,
            "reason": item.reason.name, "finding": item.finding.name,
            "about": None if item.about is None else item.about.name,
            "cause_since_s": self.at_s(item.since_ns), "is_call": item.is_call,
            "frame": self.frame(item.heard),
        }

    def action(self, item: Action) -> Json:
        return {
            "at_s": self.at_s(item.time_ns), "node": item.node, "did": item.deed.value,
            "detail": item.detail,
        }


def _budget(item: Budget) -> Json:
    return {
        "name": item.name,
        "took_ms": None if item.took_ns is None else round(item.took_ns / NS_PER_MS, 3),
        "limit_ms": item.limit_ns / NS_PER_MS,
        "is_kept": item.is_kept,
    }
