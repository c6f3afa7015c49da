"""Logs of `candump -L` (can-utils), line by line: `(1700000000.123456) vcan0 184#0011223344556677`.

What cannot be read is counted and passed over; the first such line is told.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from canbus.frame import Frame, FrameKind

_LINE: Final = re.compile(
    r"\((\d+)\.(\d{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})(##?)"
    r"(R[0-9A-Fa-f]?|[0-9A-Fa-f]*)(?:_[0-9A-Fa-f])?(?:\s+[RT])?\s*"
)
_ERROR_FLAG: Final = 0x2000_0000
"""Linux can.h: CAN_ERR_FLAG, which candump prints in the identifier."""
_ERROR_MASK: Final = 0x1FFF_FFFF
NS_PER_S: Final = 1_000_000_000


class LogError(OSError):
    """A log that cannot be read at all; one line with path and reason."""


class CandumpLog:
    """A log being read.

    Args:
        path: The file.
        channel: Only frames of this interface; None: of all.

    Attributes:
        lines: Read so far, empty ones and comments left out.
        frames: Frames among them.
        unreadable: Lines that are none.
        first_unreadable: Number and text of the first of them.
    """

    def __init__(self, path: Path, channel: str | None = None) -> None:
        self.path = path
        self.lines = self.frames = self.unreadable = 0
        self.first_unreadable: tuple[int, str] | None = None
        self._channel = channel

    def read(self) -> Iterator[tuple[int, Frame]]:
        """`(time_ns, frame)` of every frame, in the order of the file.

        Raises:
            LogError: The file cannot be opened or read.
        """
        try:
            with self.path.open(encoding="ascii", errors="replace") as file:
                yield from self._frames(file)
        except OSError as error:
            raise LogError(f"{self.path} cannot be read: {error.strerror or error}") from error

    def _frames(self, lines: Iterable[str]) -> Iterator[tuple[int, Frame]]:
        for number, line in enumerate(lines, 1):
            text = line.strip()
            if not text or text.startswith("#"):
                continue
            self.lines += 1
            found = parse_line(text)
            if found is None:
                self.unreadable += 1
                self.first_unreadable = self.first_unreadable or (number, text[:60])
                continue
            time_ns, channel, frame = found
            if self._channel in (None, channel):
                self.frames += 1
                yield time_ns, frame


def parse_line(text: str) -> tuple[int, str, Frame] | None:
    """Time, interface and frame of one line; None if it is none."""
    found = _LINE.fullmatch(text)
    if found is None:
        return None
    seconds, fraction, channel, digits, mark, data = found.groups()
    time_ns = int(seconds) * NS_PER_S + int(fraction.ljust(9, "0"))
    can_id, kind = int(digits, 16), FrameKind.DATA
    if len(digits) == 8:
        is_error = bool(can_id & _ERROR_FLAG)
        kind, can_id = (FrameKind.ERROR if is_error else FrameKind.EXTENDED), can_id & _ERROR_MASK
    if mark == "##":
        kind, data = FrameKind.FD, data[1:]  # the first digit holds flags
    elif data.startswith("R"):
        kind, data = (FrameKind.EXTENDED if len(digits) == 8 else FrameKind.REMOTE), ""
    if len(data) % 2:
        return None
    return time_ns, channel, Frame(can_id, bytes.fromhex(data), kind)
