"""A CAN frame as plain data. Standard library only: everything else may import this.

Plain data that is made many times a second is a dataclass with `Final` fields and a constructor
written out: immutable for the type checker, and when compiled also at run time. The constructor
that `dataclass(frozen=True)` writes takes several times as long, and is never compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

CAN_ID_MAX: Final = 0x7FF
"""Largest 11-bit identifier (ISO 11898-1)."""


class FrameKind(IntEnum):
    """What a controller may hand us. Our own traffic is DATA alone; the rest is a counted event."""

    DATA = 0
    REMOTE = 1
    EXTENDED = 2
    FD = 3
    ERROR = 4


@dataclass(slots=True, init=False, unsafe_hash=True)
class Frame:
    """One frame. `data` is at most 8 bytes for everything but FD; empty for REMOTE."""

    can_id: Final[int]
    data: Final[bytes]
    kind: Final[FrameKind]

    def __init__(
        self, can_id: int, data: bytes = b"", kind: FrameKind = FrameKind.DATA
    ) -> None:
        self.can_id = can_id
        self.data = data
        self.kind = kind

    def __str__(self) -> str:
        """The frame as `candump -L` writes it: `184#0011223344556677`."""
        if self.kind is FrameKind.REMOTE:
            return f"{self.can_id:03X}#R"
        width = 3 if self.kind in (FrameKind.DATA, FrameKind.FD) else 8
        hash_mark = "##0" if self.kind is FrameKind.FD else "#"
        return f"{self.can_id:0{width}X}{hash_mark}{self.data.hex().upper()}"


@dataclass(slots=True, init=False, unsafe_hash=True)
class ReceivedFrame:
    """A frame with the time at which it arrived, on the receiver's own clock."""

    arrival_ns: Final[int]
    frame: Final[Frame]

    def __init__(self, arrival_ns: int, frame: Frame) -> None:
        self.arrival_ns = arrival_ns
        self.frame = frame
