"""When a node stepped, found in the log of its bus.

A node tells its actuator something in every cycle, and sends its cyclic message, at once after its
step. So each of these frames is a step, as is the boot-up, which most nodes send alone: they are
silent until the supervisor has started them. A cyclic frame is told from a stranger's by the alive
counter, for the node's counts on. Where frames are missing, the counter says how many steps lie in
between.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from canbus.canopen_protocol import HEARTBEAT_ID
from canbus.frame import Frame, ReceivedFrame
from canbus.node import NODE_IDS, PERIOD_NS
from dbc.codec import Decoded, decode
from dbc.messages import SPECS
from dbc.protection import COUNTER_MODULO

LEAD_NS: Final = 300_000
"""From the beginning of a step to its first frame in the log: what a step takes, two tenths to one
millisecond on a computer that runs Python."""
RESTART_NS: Final = COUNTER_MODULO * PERIOD_NS // 2
"""After so long a silence a counter tells nothing of the steps between."""


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the node.

    Attributes:
        now_ns: When it began, in the log's time.
        frame_ns: When its cyclic frame arrived; None where that is not in the log.
    """

    now_ns: int
    frame_ns: int | None


def boot_up_of(node: str) -> Frame:
    """What a node sends when it has been started (CiA 301)."""
    return Frame(HEARTBEAT_ID + NODE_IDS[node], b"\x00")


def cyclic_id(node: str) -> int:
    """The identifier of what a node sends in every cycle."""
    own = [spec for spec in SPECS.values() if spec.sender == node]
    found = [spec.can_id for spec in own if spec.cycle_ns == PERIOD_NS]
    assert len(found) == 1, f"{node}: {found}"
    return found[0]


def find_steps(
    node: str,
    vehicle_bus: Sequence[ReceivedFrame],
    commands: Sequence[ReceivedFrame] = (),
) -> list[Step]:
    """The steps of a node in order, from its first start on; none if it is not started.

    Args:
        node: The DBC's name.
        vehicle_bus: Every frame of the log in order of time.
        commands: What the node told its actuator over the harness, in order of time: sent before
            anything else, and without waiting for other nodes' frames, so these tell the time best.
    """
    boot_up = boot_up_of(node)
    starts_ns = [item.arrival_ns for item in vehicle_bus if item.frame == boot_up]
    if not starts_ns:
        return []
    cyclic = _cyclic_arrivals(node, vehicle_bus)
    command_ns = [item.arrival_ns for item in commands]
    arrivals = _with_commands(command_ns, cyclic)
    for arrival in (*(_Arrival(time_ns, None) for time_ns in starts_ns), *cyclic):
        if arrival.frame_ns is None:
            _add(arrivals, arrival)
    for start_ns in starts_ns:
        _fill(arrivals, start_ns, frozenset(command_ns))
    begin_ns = starts_ns[0] - PERIOD_NS // 2
    return [
        Step(arrival.time_ns - LEAD_NS, arrival.frame_ns)
        for arrival in arrivals
        if arrival.time_ns > begin_ns
    ]


class _Arrival(NamedTuple):
    """When the first frame after a step arrived, and the cyclic one if it is in the log."""

    time_ns: int
    frame_ns: int | None


def _cyclic_arrivals(node: str, vehicle_bus: Iterable[ReceivedFrame]) -> list[_Arrival]:
    wanted, boot_up = cyclic_id(node), boot_up_of(node)
    arrivals: list[_Arrival] = []
    counter: int | None = None
    for item in vehicle_bus:
        if item.frame == boot_up:
            counter = None  # it counts from anew
        if item.frame.can_id != wanted:
            continue
        decoded = decode(item.frame)
        if not isinstance(decoded, Decoded) or decoded.counter is None:
            continue
        time_ns = item.arrival_ns
        if arrivals and counter is not None:
            count = (decoded.counter - counter) % COUNTER_MODULO
            silence_ns = time_ns - arrivals[-1].time_ns
            if silence_ns < RESTART_NS:
                if not _is_plausible(count, silence_ns):
                    continue
                arrivals += _between(arrivals[-1].time_ns, time_ns, count)
        counter = decoded.counter
        arrivals.append(_Arrival(time_ns, time_ns))
    return arrivals


def _is_plausible(count: int, silence_ns: int) -> bool:
    """Whether so many steps fit into a time; a node that is late skips cycles, so fewer do."""
    return 1 <= count <= silence_ns // PERIOD_NS + 1 and (count > 1 or silence_ns > PERIOD_NS // 4)


def _between(from_ns: int, to_ns: int, count: int) -> list[_Arrival]:
    """Steps whose frames are missing in the log, spread evenly."""
    span_ns = to_ns - from_ns
    return [_Arrival(from_ns + span_ns * n // count, None) for n in range(1, count)]


def _with_commands(command_ns: Sequence[int], cyclic: Iterable[_Arrival]) -> list[_Arrival]:
    """A step for each command and for each cyclic frame; most of them share one."""
    frame_of: dict[int, int | None] = dict.fromkeys(command_ns)
    for arrival in cyclic:
        if arrival.frame_ns is None:
            continue
        place = bisect_right(command_ns, arrival.frame_ns)
        time_ns = command_ns[place - 1] if place else arrival.frame_ns
        is_far = arrival.frame_ns - time_ns >= PERIOD_NS // 2
        if is_far or frame_of.get(time_ns) is not None:
            time_ns = arrival.frame_ns
        frame_of[time_ns] = arrival.frame_ns
    return [_Arrival(time_ns, frame_of[time_ns]) for time_ns in sorted(frame_of)]


def _add(arrivals: list[_Arrival], new: _Arrival) -> None:
    """Puts a sign of a step among the others, unless one of them is of the same step."""
    place = bisect_left(arrivals, new.time_ns, key=lambda arrival: arrival.time_ns)
    near = arrivals[max(0, place - 1) : place + 1]
    if all(abs(arrival.time_ns - new.time_ns) > PERIOD_NS // 2 for arrival in near):
        arrivals.insert(place, new)


def _fill(arrivals: list[_Arrival], start_ns: int, command_ns: frozenset[int]) -> None:
    """Puts steps between a start and the next sign of a node that said nothing but its boot-up.

    One whose first step has a command or a cyclic frame shows every step, and has none between.
    """
    first = bisect_left(arrivals, start_ns - PERIOD_NS // 2, key=lambda arrival: arrival.time_ns)
    if first + 1 >= len(arrivals):
        return
    start, after = arrivals[first : first + 2]
    is_silent = start.frame_ns is None and start.time_ns not in command_ns
    if is_silent and after.frame_ns is not None:
        from_ns, to_ns = start.time_ns, after.time_ns
        count = max(1, round((to_ns - from_ns) / PERIOD_NS))
        arrivals[first + 1 : first + 1] = _between(from_ns, to_ns, count)
