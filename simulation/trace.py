"""What happened on the wire: a running hash, and a log that can-utils read."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator
from typing import Final

from canbus.frame import Frame

_HEAD: Final = struct.Struct("<QIBB")

TraceRow = tuple[int, str, Frame]


class Trace:
    """A witness of the wire. Two runs with one seed have one hash.

    Attributes:
        rows: `(true_ns, sender, frame)` of every frame, if kept.
    """

    def __init__(self, *, keep: bool = True) -> None:
        self._hash = hashlib.sha256()
        self._keep = keep
        self.rows: list[TraceRow] = []

    def __call__(self, true_ns: int, sender: str, frame: Frame) -> None:
        """Takes one frame in."""
        head = _HEAD.pack(true_ns, frame.can_id, frame.kind, len(frame.data))
        self._hash.update(head + frame.data + sender.encode())
        if self._keep:
            self.rows.append((true_ns, sender, frame))

    @property
    def sha256(self) -> str:
        """Hash of time, sender, identifier, kind and data of all frames so far."""
        return self._hash.hexdigest()


def candump_lines(rows: Iterable[TraceRow], channel: str, start_s: float = 0.0) -> Iterator[str]:
    """The rows in the format of `candump -L`: `(12.345678) can0 184#0011...`."""
    start_us = round(start_s * 1e6)
    for true_ns, _, frame in rows:
        seconds, micros = divmod(start_us + true_ns // 1000, 1_000_000)
        yield f"({seconds:010d}.{micros:06d}) {channel} {frame}"
