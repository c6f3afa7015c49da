"""Causes that show in the traffic itself: strangers, repeats, a full bus, an empty one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Final

from canbus.timing import frame_time_ns
from dbc.codec import FrameFault
from dbc.endpoint import SPEC_OF_NAME, sent_by
from dbc.messages import SPECS, HeartbeatState, MonitorReason, Reason
from gateway.state import message_name
from telemetry.why.evidence import SOON_NS, Evidence, ms, node_text
from telemetry.why.incident import Cause, CauseKind, Claim
from telemetry.why.window import Heard, Window

FLOOD_SHARE_MIN: Final = 0.5
"""Of the wire's time: our whole traffic is a quarter of it."""
BURST_NS: Final = 50_000_000
BURST_FRAMES_MIN: Final = 16
"""Of one identifier within `BURST_NS`: ours come five times, with every one doubled ten."""
BOOTS_MIN: Final = 3
"""So many nodes do not restart together by chance."""
COUNTER_FAULTS: Final = frozenset({FrameFault.REPEATED, FrameFault.SEQUENCE})


def whole_bus(evidence: Evidence) -> Iterator[Cause]:
    """What strikes all at once: a flood, a loss of power, a bus on which nothing gets through."""
    yield from _flooded(evidence)
    quiet = evidence.window.quiet(evidence.at_ns)
    if quiet is None or evidence.at_ns - quiet[1] > SOON_NS:
        return
    begin_ns, end_ns = quiet
    last = evidence.window.between(begin_ns, begin_ns)[-1]
    span = f"nothing at all was heard for {ms(end_ns - begin_ns)}"
    boots = _boots(evidence.window, begin_ns)
    if len(boots) >= BOOTS_MIN:
        yield Cause(
            kind=CauseKind.POWER_LOST, subject="", since_ns=begin_ns, trigger=last,
            text=f"the nodes lost their power: {span}, then {len(boots)} of them started anew",
        )
    else:
        yield Cause(
            kind=CauseKind.BUS_SILENT, subject="", since_ns=begin_ns, trigger=last,
            text=f"the bus carried nothing any more: {span} (disturbed, unplugged, or not recorded)"
        )


def _boots(window: Window, from_ns: int) -> dict[str, Heard]:
    """First boot-up of each node from a time on."""
    boots: dict[str, Heard] = {}
    for row in window.between(from_ns, window.end_ns):
        if row.spec is not None and row.spec.sender and row.spec.name.endswith("_HEARTBEAT"):
            is_boot = row.content is not None and row.content.state is HeartbeatState.BOOT_UP
            if is_boot:
                boots.setdefault(row.spec.sender, row)
    return boots


def boot_of(window: Window, node: str, from_ns: int) -> Heard | None:
    """The first boot-up of a node from a time on."""
    return _boots(window, from_ns).get(node)


def _flooded(evidence: Evidence) -> Iterator[Cause]:
    """One identifier that fills the wire."""
    begin_ns = evidence.at_ns - SOON_NS
    rows = evidence.window.between(begin_ns, evidence.at_ns)
    counts = Counter(row.frame.can_id for row in rows)
    for can_id, count in counts.most_common(1):
        some = [row for row in rows if row.frame.can_id == can_id]
        bitrate_bps = round(evidence.vehicle.bus.bitrate_bps)
        busy_ns = sum(frame_time_ns(row.frame, bitrate_bps) for row in some)
        if busy_ns > FLOOD_SHARE_MIN * SOON_NS:
            yield Cause(
                kind=CauseKind.BUS_FLOODED, subject=f"0x{can_id:03X}",
                since_ns=some[0].time_ns, trigger=some[0],
                text=f"somebody filled the bus with {message_name(can_id)}: {count} frames within "
                f"{ms(SOON_NS)}, so that little else got through",
            )


def intruded(evidence: Evidence) -> Iterator[Cause]:
    """A message that comes from two senders, by the word of who owns it or of the monitor."""
    for claim in evidence.claims:
        if claim.time_ns > evidence.at_ns + SOON_NS:
            return
        is_told = claim.finding is MonitorReason.FOREIGN_SENDER
        if not is_told and claim.reason is not Reason.FOREIGN_SENDER:
            continue
        name = claim.about.name if is_told and claim.about is not None else ""
        name = name or _disturbed_message(evidence, claim)
        if not name:
            continue
        odd = _first_odd(evidence.window, name, evidence.at_ns - SOON_NS)
        spec = SPEC_OF_NAME[name]
        yield Cause(
            kind=CauseKind.FOREIGN_SENDER, subject=name,
            since_ns=None if odd is None else odd.time_ns, trigger=odd,
            text=f"somebody else sent {message_name(spec.can_id)}, which is "
            f"{node_text(spec.sender)}'s alone",
        )
        return


def strayed(evidence: Evidence) -> Iterator[Cause]:
    """Nobody says why, but a message came out of step, intact, just before: from a second sender.

    Two senders of one identifier may drive its owner off the bus before it can tell.
    """
    for row in evidence.window.between(evidence.at_ns - SOON_NS, evidence.at_ns):
        if row.spec is not None and row.content is not None and row.fault in COUNTER_FAULTS:
            yield Cause(
                kind=CauseKind.FOREIGN_SENDER, subject=row.spec.name, since_ns=row.time_ns,
                trigger=row,
                text=f"{message_name(row.spec.can_id)} came out of step, as from somebody else "
                f"than {node_text(row.spec.sender)}",
            )
            return


def _disturbed_message(evidence: Evidence, claim: Claim) -> str:
    """Which message of the claimant's own shows the stranger: two senders count out of step."""
    counts: Counter[str] = Counter()
    for can_id in sent_by(claim.node):
        name = SPECS[can_id].name
        for row in evidence.window.ignored(name):
            is_near = abs(row.time_ns - claim.time_ns) <= SOON_NS
            counts[name] += is_near and row.fault in COUNTER_FAULTS
    name, count = max(counts.items(), key=lambda item: item[1], default=("", 0))
    return name if count else ""


def _first_odd(window: Window, name: str, from_ns: int) -> Heard | None:
    """The first frame of a message out of its sequence; of a pair, the one that came too soon."""
    return next(
        (row for row in window.ignored(name)
         if row.time_ns >= from_ns and row.fault in COUNTER_FAULTS),
        None,
    )


def repeated(evidence: Evidence) -> Iterator[Cause]:
    """A message of ours more often than the DBC allows."""
    named = {
        claim.identifier for claim in evidence.calls
        if claim.finding is MonitorReason.RATE_TOO_HIGH
    }
    begin_ns = evidence.at_ns - SOON_NS
    rows = evidence.window.between(begin_ns, evidence.at_ns + BURST_NS)
    for can_id in named or _bursts(rows):
        some = [row for row in rows if row.frame.can_id == can_id]
        spec = SPECS.get(can_id)
        if spec is None or not some:
            continue
        repeats = [row for row in some if row.fault is FrameFault.REPEATED]
        first = repeats[0] if repeats else some[0]
        yield Cause(
            kind=CauseKind.MESSAGE_REPEATED, subject=spec.name, since_ns=first.time_ns,
            trigger=first,
            text=f"{node_text(spec.sender)}'s {message_name(can_id)} came {len(some)} times within "
            f"{ms(some[-1].time_ns - some[0].time_ns)}, {len(repeats)} of them the same frame again"
        )


def _bursts(rows: list[Heard]) -> list[int]:
    """Identifiers that came far too often within a short span."""
    found: list[int] = []
    recent: dict[int, list[int]] = {}
    for row in rows:
        times_ns = recent.setdefault(row.frame.can_id, [])
        times_ns.append(row.time_ns)
        while row.time_ns - times_ns[0] > BURST_NS:
            times_ns.pop(0)
        if len(times_ns) >= BURST_FRAMES_MIN and row.frame.can_id not in found:
            found.append(row.frame.can_id)
    return found
