"""Causes in the motor drives of a car that has some: what its ECUs say, and what drives sent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from canbus.canopen_protocol import HEARTBEAT_ID, NmtState
from canbus.cia402 import EMCY_ID, POSITION_ID, VELOCITY_ID, OperationMode
from canbus.drive_client import SILENCE_NS
from canbus.frame import FrameKind
from canbus.node import PERIOD_NS
from telemetry.monitor.canopen_words import error_text
from telemetry.why.absence import deaf, unheard
from telemetry.why.evidence import SOON_NS, Evidence, node_text
from telemetry.why.incident import Cause, CauseKind, Claim
from telemetry.why.window import Heard
from vehicles import Vehicle
from vehicles.vehicle import DRIVE_NAMES

DRIVE_TEXT: Final = dict(
    zip(
        DRIVE_NAMES,
        ("the steering drive", "the left wheel's drive", "the right wheel's drive"),
        strict=True,
    )
)
ECU_OF_DRIVE: Final = dict(zip(DRIVE_NAMES, ("Steering", "Throttle", "Throttle"), strict=True))
MODE_OF_DRIVE: Final = dict(
    zip(
        DRIVE_NAMES,
        (OperationMode.PROFILE_POSITION, *[OperationMode.PROFILE_VELOCITY] * 2),
        strict=True,
    )
)
"""What an ECU uses its drive in (docs/drives.md)."""
STARTING: Final = (bytes([NmtState.INITIALISING]), bytes([NmtState.PRE_OPERATIONAL]))
"""Heartbeats of a drive that has no setting any more."""
AWAY_NS: Final = SILENCE_NS - PERIOD_NS
"""An ECU that looks every cycle calls a drive silent between this and a cycle more."""


def drives_of(vehicle: Vehicle, ecu: str) -> Mapping[int, str]:
    """Names of the drives that an ECU commands, by node id; none on most cars."""
    names = {} if vehicle.drives is None else vehicle.drives.names
    return {node_id: name for node_id, name in names.items() if ECU_OF_DRIVE[name] == ecu}


def motor_fault(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    """A motor driver that is wired, or a drive on the bus, which says by itself what is wrong."""
    drives = drives_of(evidence.vehicle, claim.node)
    if not drives:
        yield Cause(
            kind=CauseKind.MOTOR_FAULT, subject=claim.node, since_ns=claim.since_ns,
            trigger=claim.heard, text="the steering motor's driver reported a fault",
        )
        return
    is_found = False
    for row in evidence.window.between(claim.time_ns - SOON_NS, claim.time_ns):
        frame = row.frame
        name = drives.get(frame.can_id - EMCY_ID)
        error = int.from_bytes(frame.data[:2], "little")
        if name is not None and frame.kind is FrameKind.DATA and error:
            is_found = True
            yield Cause(
                kind=CauseKind.MOTOR_FAULT, subject=name, since_ns=row.time_ns, trigger=row,
                text=f"{DRIVE_TEXT[name]} reported a fault: {error_text(error)}",
            )
    if not is_found:
        yield Cause(
            kind=CauseKind.MOTOR_FAULT, subject=claim.node, since_ns=claim.since_ns,
            trigger=claim.heard, text=f"{node_text(claim.node)} found a motor drive in a fault, "
            "with a setting refused, or not switched on",
        )


def node_silent(evidence: Evidence, claim: Claim) -> Iterator[Cause]:
    """An ECU misses a drive; of who commands none, a node that is missing."""
    drives = drives_of(evidence.vehicle, claim.node)
    if not drives:
        yield from unheard(evidence, claim)
        return
    yield from _absences(evidence, drives, claim.time_ns) or [deaf(evidence, claim)]


def drives_away(evidence: Evidence, ecu: str, at_ns: int) -> list[Cause]:
    """An ECU's drives that were heard of and then fell silent, or have just started anew."""
    causes = _absences(evidence, drives_of(evidence.vehicle, ecu), at_ns)
    return [cause for cause in causes if cause.trigger is not None]


def _absences(evidence: Evidence, drives: Mapping[int, str], at_ns: int) -> list[Cause]:
    found = (_absent(evidence, at_ns, node_id, name) for node_id, name in drives.items())
    return [cause for cause in found if cause is not None]


def _absent(evidence: Evidence, at_ns: int, node_id: int, name: str) -> Cause | None:
    """Why a drive cannot be used, as far as it shows: anew, silent, in another mode; or None."""
    begin_ns = evidence.window.begin_ns
    newest: dict[int, Heard] = {}
    for row in evidence.window.between(begin_ns, at_ns):
        if row.frame.kind is FrameKind.DATA:
            newest[row.frame.can_id - node_id] = row
    beat, position = newest.get(HEARTBEAT_ID), newest.get(POSITION_ID)
    if beat is not None and beat.frame.data in STARTING and at_ns - beat.time_ns <= SOON_NS:
        return _cause(CauseKind.NODE_RESTARTED, name, beat, "started anew")
    told = [newest[base] for base in (POSITION_ID, VELOCITY_ID) if base in newest]
    last = max(told, key=lambda row: row.time_ns, default=None)
    if last is None:
        return _cause(CauseKind.NODE_SILENT, name, None, "was not heard at all")
    if at_ns - last.time_ns >= AWAY_NS:
        return _cause(CauseKind.NODE_SILENT, name, last, "fell silent")
    if position is not None and position.frame.data[-1:] != bytes([MODE_OF_DRIVE[name]]):
        return _cause(CauseKind.NOT_FOLLOWING, name, position, "was in another mode of operation")
    return None


def _cause(kind: CauseKind, name: str, trigger: Heard | None, what: str) -> Cause:
    return Cause(
        kind=kind, subject=name, since_ns=None if trigger is None else trigger.time_ns,
        trigger=trigger, text=f"{DRIVE_TEXT[name]} {what}",
    )
