"""Why the car braked: who said so first, from the bus log alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import SPECS, Reason, Verdict
from gateway.sentences import REASON_TEXT
from gateway.state import verdict_text
from telemetry.bus_log import BusLog
from telemetry.signals import messages_of

EMERGENCY_NAMES = tuple(
    spec.name for spec in SPECS.values() if spec.name.endswith("_EMERGENCY_BRAKE")
)

FOLLOWING_REASONS = frozenset(
    {
        Reason.NODE_EMERGENCY,
        Reason.FAILSAFE_FRAME,
        Reason.VERDICT_BRAKE,
        Reason.ADOPTED,
        Reason.BRAKING_IN_PROGRESS,
    }
)
"""Reasons that only repeat somebody else's: never the first while there is another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EmergencyCause:
    """The first node that wanted an emergency brake, and why."""

    time_s: float
    node: str
    text: str
    is_following: bool = False

    def __str__(self) -> str:
        """One line for a person."""
        return f"{self.node} at {self.time_s:.3f} s: {self.text}"


def first_cause(log: BusLog, from_s: float = 0.0) -> EmergencyCause | None:
    """The earliest EMERGENCY_BRAKE, BRAKE verdict or FAILSAFE frame; None when there is none.

    Args:
        log: Of the whole drive.
        from_s: Earlier frames do not count.
    """
    found = (cause for cause in _causes(log) if cause.time_s >= from_s)
    return min(found, key=lambda cause: (cause.is_following, cause.time_s), default=None)


def _causes(log: BusLog) -> Iterator[EmergencyCause]:
    for name in EMERGENCY_NAMES:
        for time_s, brake in messages_of(log, name):
            yield EmergencyCause(
                # The cause is older than the frame by what the frame itself tells.
                time_s=time_s - brake.cause_age_ms * 1e-3,
                node=SPEC_OF_NAME[name].sender or name,
                text=f"{REASON_TEXT[brake.reason]} ({brake.code.name})",
                is_following=brake.reason in FOLLOWING_REASONS,
            )
    for time_s, verdict in messages_of(log, "SAFETY_VERDICT"):
        if verdict.verdict is Verdict.BRAKE:
            yield EmergencyCause(time_s=time_s, node="SafetyMonitor", text=verdict_text(verdict))
    for time_ns, _ in log.frames_of(SPEC_OF_NAME["FAILSAFE"].can_id):
        text = "a FAILSAFE frame (0x001) was on the bus"
        yield EmergencyCause(time_s=time_ns / 1e9, node="somebody", text=text)
