"""The bus in virtual time: arbitration by identifier, exact frame lengths, loss by choice.

First version: frames win by the lowest identifier and are never pre-empted (ISO 11898-1); error
frames and the controllers' error counters are not modelled yet.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from canbus.frame import Frame
from canbus.timing import DATA_BYTES_MAX, bits_time_ns, frame_bits, frame_bits_max
from simulation.kernel import Kernel

WIRE_PRIORITY: Final = 0
"""Frames end before nodes step at the same instant."""

LOAD_WINDOW_NS: Final = 100_000_000
"""Span over which the largest bus load is told."""


WireFrame = tuple[int, Frame]
"""True time at which the frame ended, and the frame."""


class Station(Protocol):
    """One controller on the wire."""

    name: str

    @property
    def acceptance(self) -> frozenset[int] | None:
        """Identifiers that its acceptance filter lets through; None for all."""
        ...

    inbox: list[WireFrame]
    """Frames that have ended on the wire since the station last looked."""


Filter = Callable[[int, str, Frame, str], bool]
"""`(true_ns, sender, frame, receiver)`: False loses the frame for this receiver."""
Witness = Callable[[int, str, Frame], None]
"""`(true_ns, sender, frame)`: sees every frame that was on the wire."""


class Wire:
    """One CAN bus. Every frame sent is heard by every other station."""

    def __init__(self, kernel: Kernel, bitrate_bps: int) -> None:
        self._kernel = kernel
        bits_max = frame_bits_max(DATA_BYTES_MAX, extended=True)
        self._span_ns_of_bits = [bits_time_ns(n, bitrate_bps) for n in range(bits_max + 1)]
        self._stations: list[Station] = []
        self._pending: list[tuple[int, int, str, Frame]] = []
        self._sequence = 0
        self._is_busy = False
        self._sender = ""
        self._frame = Frame(0)
        self._span_ns = 0
        self._routes: dict[int, tuple[str, list[Station]]] = {}
        self._window_end_ns = LOAD_WINDOW_NS
        self._window_busy_ns = 0
        self.filters: list[Filter] = []
        self.witnesses: list[Witness] = []
        self.frames = 0
        self.busy_ns = 0
        self.load_max = 0.0

    def attach(self, station: Station) -> None:
        """Adds a station; order of attachment is order of delivery."""
        self._stations.append(station)
        self._routes.clear()

    def send(self, true_ns: int, sender: str, frames: Sequence[Frame]) -> None:
        """Puts frames into the sender's queue; they leave by priority."""
        for frame in frames:
            self._sequence += 1
            heapq.heappush(self._pending, (frame.can_id, self._sequence, sender, frame))
        if frames and not self._is_busy:
            self._begin(true_ns)

    def _begin(self, true_ns: int) -> None:
        _, _, sender, frame = heapq.heappop(self._pending)
        self._is_busy = True
        self._sender, self._frame = sender, frame
        self._span_ns = self._span_ns_of_bits[frame_bits(frame)]
        self._kernel.at(true_ns + self._span_ns, WIRE_PRIORITY, self._end)

    def _end(self, true_ns: int) -> None:
        sender, frame = self._sender, self._frame
        self._is_busy = False
        self._account(true_ns, self._span_ns)
        for witness in self.witnesses:
            witness(true_ns, sender, frame)
        route = self._routes.get(frame.can_id)
        if route is None or route[0] != sender:
            route = self._route(sender, frame.can_id)
        receivers = route[1]
        item = (true_ns, frame)
        if not self.filters:
            for station in receivers:
                station.inbox.append(item)
        else:
            for station in receivers:
                if all(keep(true_ns, sender, frame, station.name) for keep in self.filters):
                    station.inbox.append(item)
        if self._pending:
            self._begin(true_ns)

    def _route(self, sender: str, can_id: int) -> tuple[str, list[Station]]:
        """The sender, and the stations that want these frames of his by their filters."""
        receivers = [
            station
            for station in self._stations
            if station.name != sender
            and (station.acceptance is None or can_id in station.acceptance)
        ]
        route = self._routes[can_id] = (sender, receivers)
        return route

    def _account(self, true_ns: int, span_ns: int) -> None:
        self.frames += 1
        self.busy_ns += span_ns
        if true_ns > self._window_end_ns:
            self.load_max = max(self.load_max, self._window_busy_ns / LOAD_WINDOW_NS)
            self._window_busy_ns = 0
            self._window_end_ns = true_ns - true_ns % LOAD_WINDOW_NS + LOAD_WINDOW_NS
        self._window_busy_ns += span_ns

    def load_mean(self, true_ns: int) -> float:
        """Share of the time since the start in which the wire was busy."""
        return self.busy_ns / true_ns if true_ns else 0.0
