"""What of a log is to be replayed: channels and messages; it is read anew for each loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from canbus.frame import ReceivedFrame
from telemetry.logs.frames import FrameColumns, LogFrame
from telemetry.monitor.known import Catalogue
from telemetry.monitor.selection import Selection
from telemetry.replay.through_node import Record, ReplayError


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Frames of a log.

    Attributes:
        chunks: Reads the log, each time from its beginning.
        selection: Which frames are wanted.
        catalogue: The messages that the selection names.
    """

    chunks: Callable[[], Iterator[FrameColumns]]
    selection: Selection
    catalogue: Catalogue

    def frames(self) -> Iterator[LogFrame]:
        """Those that are wanted, in the order of the log."""
        for chunk in self.chunks():
            for frame in chunk.frames():
                heard = frame.heard()
                known = self.catalogue.find(heard.channel, heard.word)
                if self.selection.passes(heard, known):
                    yield frame

    def words(self) -> set[tuple[str, int]]:
        """Channel and identifier, with its flags, of all of them."""
        found: set[tuple[str, int]] = set()
        for chunk in self.chunks():
            keys = np.stack([chunk.channel, chunk.flags, chunk.can_id], axis=1)
            _, first = np.unique(keys, axis=0, return_index=True)
            for frame in chunk.take(first).frames():
                heard = frame.heard()
                known = self.catalogue.find(heard.channel, heard.word)
                if self.selection.wants(heard.channel, heard.word, known):
                    found.add((heard.channel, heard.word))
        return found


def record_of(frames: Iterator[LogFrame], channel: str, harness_channel: str) -> Record:
    """The two buses of a log.

    Raises:
        ReplayError: One of them is not in it.
    """
    buses: dict[str, list[ReceivedFrame]] = {}
    for frame in frames:
        buses.setdefault(frame.channel, []).append(ReceivedFrame(frame.time_ns, frame.frame()))
    for name, what in ((channel, "the vehicle bus"), (harness_channel, "the harness")):
        if name not in buses:
            raise ReplayError(
                f"{what}, {name}, is not in this log, which has {_names(sorted(buses))}: "
                "a node is replayed from both, the second for its sensors"
            )
    ordered = (sorted(buses[n], key=lambda i: i.arrival_ns) for n in (channel, harness_channel))
    vehicle_bus, harness = ordered
    return Record(vehicle_bus=vehicle_bus, harness=harness)


def _names(names: Sequence[str]) -> str:
    return ", ".join(names) or "no frames"
