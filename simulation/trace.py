"""What happened on the wire: a running hash, and a log that can-utils read."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator
from typing import Final

from canbus.frame import Frame

_HEAD: Final = struct.Struct("<QIBB")

TraceRow = tuple[int, str, Frame]


HASHED_BYTES: Final = 1 << 14
"""So much is gathered before it is hashed: many short pieces would cost more than their bytes."""


class Trace:
    """A witness of the wire. Two runs with one seed have one hash.

    Attributes:
        rows: `(true_ns, sender, frame)` of every frame, if kept.
    """

    def __init__(self, *, keep: bool = True) -> None:
        self._hash = hashlib.sha256()
        self._gathered = bytearray()
        self._keep = keep
        self.rows: list[TraceRow] = []

    def __call__(self, true_ns: int, sender: str, frame: Frame) -> None:
        """Takes one frame in."""
        data = frame.data
        gathered = self._gathered
        gathered += _HEAD.pack(true_ns, frame.can_id, frame.kind, len(data))
        gathered += data
        gathered += sender.encode()
        if len(gathered) >= HASHED_BYTES:
            self._hash_gathered()
        if self._keep:
            self.rows.append((true_ns, sender, frame))

    def _hash_gathered(self) -> None:
        self._hash.update(self._gathered)
        self._gathered.clear()

    @property
    def sha256(self) -> str:
        """Hash of time, sender, identifier, kind and data of all frames so far."""
        self._hash_gathered()
        return self._hash.hexdigest()


def candump_lines(rows: Iterable[TraceRow], channel: str, start_s: float = 0.0) -> Iterator[str]:
    """The rows in the format of `candump -L`: `(12.345678) can0 184#0011...`."""
    start_us = round(start_s * 1e6)
    for true_ns, _, frame in rows:
        seconds, micros = divmod(start_us + true_ns // 1000, 1_000_000)
        yield f"({seconds:010d}.{micros:06d}) {channel} {frame}"
