"""Causes in the motor drives of a car that has some: what its ECUs say, and what drives sent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from canbus.canopen_protocol import HEARTBEAT_ID, NmtState
from canbus.cia402 import EMCY_ID, SENT_IDS
from canbus.frame import FrameKind
from telemetry.monitor.canopen_words import error_text
from telemetry.why.absence import unheard
from telemetry.why.evidence import NS_PER_MS, SOON_NS, Evidence, node_text
from telemetry.why.incident import Cause, CauseKind, Claim
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
BOOT_UP: Final = bytes([NmtState.INITIALISING])
AWAY_NS: Final = 50 * NS_PER_MS
"""A drive sends every 20 ms; its ECU misses it after 60."""


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
    causes = drives_away(evidence, claim.node, claim.time_ns)
    yield from causes or [
        Cause(
            kind=CauseKind.UNKNOWN, subject=claim.node, since_ns=claim.since_ns,
            trigger=claim.heard, text=f"{node_text(claim.node)} found a motor drive not ready: in "
            "another mode, or not switched on",
        )
    ]


def drives_away(evidence: Evidence, ecu: str, at_ns: int) -> list[Cause]:
    """An ECU's drives that had fallen silent by then, or just started anew."""
    found = (
        _of_drive(evidence, at_ns, node_id, name)
        for node_id, name in drives_of(evidence.vehicle, ecu).items()
    )
    return [cause for cause in found if cause is not None]


def _of_drive(evidence: Evidence, at_ns: int, node_id: int, name: str) -> Cause | None:
    sent = {base + node_id for base in SENT_IDS}
    begin_ns = evidence.window.begin_ns
    rows = [
        row for row in evidence.window.between(begin_ns, at_ns)
        if row.frame.can_id in sent and row.frame.kind is FrameKind.DATA
    ]
    for row in rows:
        is_boot = row.frame.can_id == HEARTBEAT_ID + node_id and row.frame.data == BOOT_UP
        if is_boot and at_ns - row.time_ns <= SOON_NS:
            return Cause(
                kind=CauseKind.NODE_RESTARTED, subject=name, since_ns=row.time_ns, trigger=row,
                text=f"{DRIVE_TEXT[name]} started anew",
            )
    last = rows[-1] if rows else None
    since_ns = begin_ns if last is None else last.time_ns
    if at_ns - since_ns < AWAY_NS:
        return None
    return Cause(
        kind=CauseKind.NODE_SILENT, subject=name, since_ns=since_ns, trigger=last,
        text=f"{DRIVE_TEXT[name]} fell silent",
    )
