"""Frames that wait for the bus: the lowest identifier first (ISO 11898-1, bitwise arbitration)."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

from canbus.bitstream import DATA_SHIFT, arbitration_key
from canbus.frame import Frame
from simulation.controller import Controller

Pending = tuple[int, int, Controller, Frame]
"""Arbitration key, number in the order of sending, sender, frame."""


class Arbitration:
    """All frames that take part.

    Attributes:
        pending: a heap; read it to see whether anything waits, and what is first.
    """

    __slots__ = ("_held", "_sequence", "pending")

    def __init__(self) -> None:
        self.pending: list[Pending] = []
        self._sequence = 0
        self._held: dict[Controller, list[Pending]] = {}

    def offer(self, controller: Controller, frame: Frame) -> None:
        """A frame takes part from now on; a held controller's when it is released."""
        self._sequence = sequence = self._sequence + 1
        key = frame.can_id << DATA_SHIFT if frame.kind == 0 else arbitration_key(frame)
        if self._held and controller in self._held:
            self._held[controller].append((key, sequence, controller, frame))
        else:
            heappush(self.pending, (key, sequence, controller, frame))

    def put_back(self, entries: list[Pending]) -> None:
        """Frames that did not go through take part again, in their old order."""
        for entry in entries:
            heappush(self.pending, entry)

    def take_twins(self, winner: Pending) -> list[Pending]:
        """Other controllers' frames with the winner's key; one's own second frame has to wait."""
        taken = [winner]
        own: list[Pending] = []
        while self.pending and self.pending[0][0] == winner[0]:
            entry = heappop(self.pending)
            is_own = any(entry[2] is other[2] for other in taken)
            (own if is_own else taken).append(entry)
        self.put_back(own)
        return taken[1:]

    def withdraw(self, controller: Controller) -> list[Pending]:
        """Takes a controller's frames out, held ones too."""
        withdrawn = [entry for entry in self.pending if entry[2] is controller]
        self.pending[:] = [entry for entry in self.pending if entry[2] is not controller]
        heapify(self.pending)
        return withdrawn + self._held.pop(controller, [])

    def hold(self, controller: Controller) -> None:
        """Its frames, present and future, wait for `release`."""
        self._held[controller] = self.withdraw(controller)

    def release(self, controller: Controller) -> None:
        """They take part again."""
        self.put_back(self._held.pop(controller, []))
