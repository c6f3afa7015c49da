"""A CAN frame as plain data. Standard library only: everything else may import this."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

CAN_ID_MAX = 0x7FF
"""Largest 11-bit identifier (ISO 11898-1)."""


class FrameKind(IntEnum):
    """What a controller may hand us. Our own traffic is DATA alone; the rest is a counted event."""

    DATA = 0
    REMOTE = 1
    EXTENDED = 2
    FD = 3
    ERROR = 4


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame. `data` is at most 8 bytes for everything but FD; empty for REMOTE."""

    can_id: int
    data: bytes = b""
    kind: FrameKind = FrameKind.DATA

    def __str__(self) -> str:
        """The frame as `candump -L` writes it: `184#0011223344556677`."""
        if self.kind is FrameKind.REMOTE:
            return f"{self.can_id:03X}#R"
        width = 3 if self.kind in (FrameKind.DATA, FrameKind.FD) else 8
        hash_mark = "##0" if self.kind is FrameKind.FD else "#"
        return f"{self.can_id:0{width}X}{hash_mark}{self.data.hex().upper()}"


class ReceivedFrame(NamedTuple):
    """A frame with the time at which it arrived, on the receiver's own clock."""

    arrival_ns: int
    frame: Frame
