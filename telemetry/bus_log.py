"""Every frame of a drive, kept small: 22 bytes each, where frames as objects take 300."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from canbus.frame import Frame, FrameKind
from canbus.timing import frame_time_ns
from dbc.messages import SPECS
from simulation.trace import TraceRow

LOAD_WINDOW_NS: Final = 100_000_000
"""Span over which the largest bus load is told."""

DATA_BYTES_MAX: Final = 8

_ROW: Final = struct.Struct("<qIBB8s")
"""Time in ns, identifier, kind, length, data (filled up with zeros)."""
_LEFT_OUT: Final = frozenset({FrameKind.FD, FrameKind.ERROR})

STRANGER: Final = "stranger"
"""Sender of an identifier that is nobody's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BusLoad:
    """How busy the wire was, as shares of the time, 0 to 1."""

    mean: float
    max: float
    """Over the busiest whole 100 ms."""


class BusLog:
    """Frames in the order in which they were on the wire.

    A witness of a simulated wire (`simulation.wire.Witness`), or fed by a `BusRecorder`. Data
    frames of up to 8 bytes and remote frames are kept; others (FD, error frames) are counted in
    `left_out`: a log of `candump -L` has no line for them that all tools read.
    """

    def __init__(self) -> None:
        self._rows = bytearray()
        self.left_out = 0

    def __call__(self, true_ns: int, sender: str, frame: Frame) -> None:
        """Takes one frame in; the sender is not kept, for a log does not know it."""
        self.add(true_ns, frame)

    def __len__(self) -> int:
        """Frames kept."""
        return len(self._rows) // _ROW.size

    def _time_ns(self, index: int) -> int:
        """Time of the first frame (0) or the newest (-1)."""
        start = index % len(self) * _ROW.size
        time_ns: int = _ROW.unpack_from(self._rows, start)[0]
        return time_ns

    @property
    def end_s(self) -> float:
        """Time of the newest frame; 0 for an empty log."""
        return self._time_ns(-1) / 1e9 if self._rows else 0.0

    def add(self, time_ns: int, frame: Frame) -> None:
        """Takes one frame in; times never go back."""
        data, kind = frame.data, frame.kind
        if len(data) > DATA_BYTES_MAX or kind in _LEFT_OUT:
            self.left_out += 1
            return
        self._rows += _ROW.pack(time_ns, frame.can_id, kind, len(data), data)

    def frames(self) -> Iterator[tuple[int, Frame]]:
        """`(time_ns, frame)` of every frame kept, oldest first."""
        for time_ns, can_id, kind, length, data in _ROW.iter_unpack(self._rows):
            yield time_ns, Frame(can_id, data[:length], FrameKind(kind))

    def frames_of(self, can_id: int) -> Iterator[tuple[int, Frame]]:
        """The same for one identifier; data frames alone."""
        for time_ns, found, kind, length, data in _ROW.iter_unpack(self._rows):
            if found == can_id and kind == FrameKind.DATA:
                yield time_ns, Frame(can_id, data[:length])

    def rows(self) -> Iterator[TraceRow]:
        """`(time_ns, sender, frame)`, the sender by the DBC."""
        for time_ns, frame in self.frames():
            spec = SPECS.get(frame.can_id)
            yield time_ns, STRANGER if spec is None else spec.sender or STRANGER, frame

    def load(self, bitrate_bps: int) -> BusLoad:
        """Bus load between the first frame and the last, from exact frame lengths.

        Args:
            bitrate_bps: Of the bus.

        Returns:
            Zero for a log of less than two windows: too little to tell a share from.
        """
        if len(self) < 2:
            return BusLoad(mean=0.0, max=0.0)
        first_ns = self._time_ns(0)
        span_ns = self._time_ns(-1) - first_ns
        windows = span_ns // LOAD_WINDOW_NS
        if windows < 2:
            return BusLoad(mean=0.0, max=0.0)
        busy_ns = [0] * (windows + 1)
        for time_ns, frame in self.frames():
            place = (time_ns - first_ns) // LOAD_WINDOW_NS
            busy_ns[place] += frame_time_ns(frame, bitrate_bps)
        return BusLoad(
            mean=sum(busy_ns) / span_ns,
            max=max(busy_ns[:-1]) / LOAD_WINDOW_NS,  # the last window is not a whole one
        )
