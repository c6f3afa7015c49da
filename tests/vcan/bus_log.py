"""What candump writes down while tests run."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from canbus.frame import Frame, ReceivedFrame
from dbc.codec import Decoded, decode
from runtime.harness import decode_harness

HARNESS_BUS = "vcan1"
BLOCK_BYTES = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One line of `candump -L`."""

    time_s: float
    channel: str
    can_id: int
    data: bytes

    @property
    def content(self) -> Any:
        """The message, or None for what is none of ours or cannot be used."""
        frame = Frame(self.can_id, self.data)
        if self.channel == HARNESS_BUS:
            reading = decode_harness(ReceivedFrame(0, frame))
            return None if reading is None else reading.content
        decoded = decode(frame)
        return decoded.message if isinstance(decoded, Decoded) else None


@contextmanager
def candump(path: Path, *channels: str) -> Iterator[None]:
    """Writes down what is on these networks, a line at a time, so that it can be read meanwhile."""
    with path.open("wb") as log:
        process = subprocess.Popen(
            ["stdbuf", "-oL", "candump", "-D", "-L", "-r", "4000000", *channels], stdout=log
        )
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def read_log(path: Path, since_s: float = 0.0) -> list[Line]:
    """Whole lines so far, those since then."""
    lines: list[Line] = []
    for text in _backwards(path):
        stamp, channel, frame = text.split()[:3]
        time_s = float(stamp.strip("()"))
        if time_s < since_s:
            break
        can_id, _, data = frame.partition("#")
        lines.append(
            Line(
                time_s=time_s, channel=channel, can_id=int(can_id, 16),
                data=b"" if data.startswith("R") else bytes.fromhex(data),
            )
        )
    lines.reverse()
    return lines


def _backwards(path: Path) -> Iterator[str]:
    """Whole lines of a file that grows all the time, the last one first."""
    with path.open("rb") as file:
        end = file.seek(0, os.SEEK_END)
        begun = b""
        is_newest = True
        while end > 0:
            begin = max(0, end - BLOCK_BYTES)
            file.seek(begin)
            begun, *lines = (file.read(end - begin) + begun).split(b"\n")
            if is_newest and lines:
                lines.pop()  # not written to its end
                is_newest = False
            yield from (line.decode() for line in reversed(lines))
            end = begin
        if begun and not is_newest:
            yield begun.decode()
