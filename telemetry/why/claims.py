"""Who said what: every wish to brake and every report of a code, in the order of the frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from dbc.endpoint import FAILSAFE_ID, SPEC_OF_NAME, STOPPING_IDS
from dbc.messages import ErrorCode, MonitorReason, Reason, Verdict
from telemetry.why.incident import Claim
from telemetry.why.window import Heard, Window

NS_PER_MS: Final = 1_000_000

FOLLOWING: Final = frozenset(
    {
        Reason.NODE_EMERGENCY,
        Reason.FAILSAFE_FRAME,
        Reason.VERDICT_BRAKE,
        Reason.ADOPTED,
        Reason.BRAKING_IN_PROGRESS,
    }
)
"""Reasons that only repeat somebody else's: no cause of their own while there is another."""

VERDICT_ID: Final = SPEC_OF_NAME["SAFETY_VERDICT"].can_id
EMCY_IDS: Final = frozenset(
    spec.can_id for spec in SPEC_OF_NAME.values() if spec.name.endswith("_EMCY")
)
SOMEBODY: Final = "somebody"
"""Sender of a frame that anybody may send."""


def claims_of(window: Window, from_ns: int) -> list[Claim]:
    """The first frame of each thing that each node said from a time on, in order."""
    claims: list[Claim] = []
    said: set[tuple[object, ...]] = set()
    for row in window.between(from_ns, window.end_ns):
        claim = claim_of(row)
        if claim is None:
            continue
        key = (claim.node, row.frame.can_id, claim.code, claim.reason, claim.finding)
        if key not in said:
            said.add(key)
            claims.append(claim)
    return claims


def claim_of(row: Heard) -> Claim | None:
    """What a frame claims; None for one that claims nothing."""
    can_id, content = row.frame.can_id, row.content
    if content is None:
        return None
    if can_id in STOPPING_IDS:
        since_ns = row.time_ns - content.cause_age_ms * NS_PER_MS
        return _claim(row, content.code, content.reason, since_ns, is_call=True)
    if can_id in EMCY_IDS and content.er_code is not ErrorCode.NONE:
        return _claim(row, content.er_code, content.reason, row.time_ns, is_call=False)
    if can_id == VERDICT_ID and content.reason is not MonitorReason.NONE:
        return Claim(
            heard=row, node="SafetyMonitor", code=ErrorCode.NONE, reason=Reason.NONE,
            finding=content.reason, identifier=content.identifier, since_ns=row.time_ns,
            is_call=content.verdict is Verdict.BRAKE,
        )
    if can_id == FAILSAFE_ID:
        return _claim(row, ErrorCode.NONE, Reason.FAILSAFE_FRAME, row.time_ns, is_call=True)
    return None


def _claim(
    row: Heard, code: ErrorCode, reason: Reason, since_ns: int, *, is_call: bool
) -> Claim:
    assert row.spec is not None
    return Claim(
        heard=row, node=row.spec.sender or SOMEBODY, code=code, reason=reason,
        finding=MonitorReason.NONE, identifier=0, since_ns=since_ns, is_call=is_call,
    )


def calls(claims: list[Claim]) -> Iterator[Claim]:
    """Wishes to brake alone."""
    return (claim for claim in claims if claim.is_call)
