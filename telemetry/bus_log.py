"""Every frame of a drive, kept small: 20 bytes each, where frames as objects take 300."""

from __future__ import annotations

from array import array
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
        self._times_ns = array("q")
        self._ids = array("I")
        self._kinds = bytearray()
        self._lengths = bytearray()
        self._data = bytearray()
        self.left_out = 0

    def __call__(self, true_ns: int, sender: str, frame: Frame) -> None:
        """Takes one frame in; the sender is not kept, for a log does not know it."""
        self.add(true_ns, frame)

    def __len__(self) -> int:
        """Frames kept."""
        return len(self._times_ns)

    @property
    def end_s(self) -> float:
        """Time of the newest frame; 0 for an empty log."""
        return self._times_ns[-1] / 1e9 if self._times_ns else 0.0

    def add(self, time_ns: int, frame: Frame) -> None:
        """Takes one frame in; times never go back."""
        data = frame.data
        if len(data) > DATA_BYTES_MAX or frame.kind in (FrameKind.FD, FrameKind.ERROR):
            self.left_out += 1
            return
        self._times_ns.append(time_ns)
        self._ids.append(frame.can_id)
        self._kinds.append(frame.kind)
        self._lengths.append(len(data))
        self._data += data.ljust(DATA_BYTES_MAX, b"\0")

    def frames(self) -> Iterator[tuple[int, Frame]]:
        """`(time_ns, frame)` of every frame kept, oldest first."""
        for index, time_ns in enumerate(self._times_ns):
            start = index * DATA_BYTES_MAX
            data = bytes(self._data[start : start + self._lengths[index]])
            yield time_ns, Frame(self._ids[index], data, FrameKind(self._kinds[index]))

    def frames_of(self, can_id: int) -> Iterator[tuple[int, Frame]]:
        """The same for one identifier; data frames alone."""
        for index, found in enumerate(self._ids):
            if found == can_id and self._kinds[index] == FrameKind.DATA:
                start = index * DATA_BYTES_MAX
                data = bytes(self._data[start : start + self._lengths[index]])
                yield self._times_ns[index], Frame(can_id, data)

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
        first_ns, span_ns = self._times_ns[0], self._times_ns[-1] - self._times_ns[0]
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
