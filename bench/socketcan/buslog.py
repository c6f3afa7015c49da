"""What a log of `candump -L` proves about our own frames: none lost, none late."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from canbus.frame import Frame
from canbus.timing import frame_bits
from dbc.endpoint import STOPPING_IDS
from dbc.messages import SPECS
from dbc.protection import COUNTER_BYTE, COUNTER_MODULO
from runtime.clock import NS_PER_MS, NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """The frames of one identifier.

    Attributes:
        name: the message's.
        cycle_ms: its period in the DBC; 0 for what is sent on change.
        frames: how many there were.
        lost: how many are missing by the alive counter; None without a counter.
        periods_ms: median, 99th percentile and longest distance of two frames.
    """

    name: str
    cycle_ms: float
    frames: int
    lost: int | None
    periods_ms: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class BusLog:
    """All of it.

    Attributes:
        span_s: from the first frame to the last.
        bits: of all frames, exact.
        brakes: EMERGENCY_BRAKE and FAILSAFE frames.
        streams: by identifier.
    """

    span_s: float
    bits: int
    brakes: int
    streams: dict[int, Stream]

    @property
    def frames(self) -> int:
        """All of them."""
        return sum(stream.frames for stream in self.streams.values())


def read_bus_log(lines: Iterable[str], begin_s: float, end_s: float) -> BusLog:
    """Judges the data frames of ours between two times of the log's clock."""
    stamps_ns: dict[int, list[int]] = defaultdict(list)
    counters: dict[int, list[int]] = defaultdict(list)
    bits = 0
    for line in lines:
        stamp, _, text = line.split()[:3]
        if not begin_s <= float(stamp[1:-1]) < end_s:
            continue
        can_id, data = int(text[:3], 16), bytes.fromhex(text[4:])
        assert text[3] == "#" and can_id in SPECS, line
        seconds, micros = stamp[1:-1].split(".")
        stamps_ns[can_id].append(int(seconds) * NS_PER_S + int(micros) * 1000)
        bits += frame_bits(Frame(can_id, data))
        if SPECS[can_id].data_id is not None:
            counters[can_id].append(data[COUNTER_BYTE] & 0x0F)
    streams = {
        can_id: _stream(can_id, stamps_ns[can_id], counters.get(can_id))
        for can_id in sorted(stamps_ns)
    }
    return BusLog(
        span_s=end_s - begin_s,
        bits=bits,
        brakes=sum(len(stamps_ns.get(can_id, ())) for can_id in STOPPING_IDS),
        streams=streams,
    )


def _stream(can_id: int, stamps_ns: list[int], counters: list[int] | None) -> Stream:
    spec = SPECS[can_id]
    periods_ms = np.diff(stamps_ns) / NS_PER_MS
    low, high = np.percentile(periods_ms, (50, 99)) if len(periods_ms) else (0.0, 0.0)
    return Stream(
        name=spec.name,
        cycle_ms=spec.cycle_ns / NS_PER_MS,
        frames=len(stamps_ns),
        lost=None if counters is None else lost_frames(counters),
        periods_ms=(float(low), float(high), float(max(periods_ms, default=0.0))),
    )


def lost_frames(counters: list[int]) -> int:
    """How many frames are missing between those with these alive counters.

    A multiple of 15 lost in a row goes unseen: the longest period tells of that.
    """
    steps = np.diff(counters)
    return int(np.sum((steps - 1) % COUNTER_MODULO))
