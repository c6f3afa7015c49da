"""Messages to frames and back, with the protection the DBC asks for.

Encoding a value that its signal cannot carry is the caller's mistake and raises. A bad frame is the
bus's and comes back as a `FrameFault`, never as an exception.
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
from typing import Any, NamedTuple

from canbus.frame import Frame, FrameKind
from dbc.messages import SPECS
from dbc.protection import COUNTER_BYTE, PROTECTED_LENGTH, is_intact, protect
from dbc.spec import MessageSpec, SignalRangeError

DECODE_CACHE_SIZE = 1024


class FrameFault(IntEnum):
    """Why a frame of ours was ignored (ER0)."""

    KIND = 1
    LENGTH = 2
    CRC = 3
    SEQUENCE = 4
    REPEATED = 5
    VALUE = 6


class Decoded(NamedTuple):
    """A frame's content; `counter` is None for a message without protection."""

    spec: MessageSpec
    counter: int | None
    message: Any


def encode(spec: MessageSpec, message: Any, counter: int = 0) -> Frame:
    """The frame that carries the message.

    Raises:
        SignalRangeError: A value outside its signal's range, or NaN where the signal has no code
            for "not available".
    """
    payload = spec.pack(message)
    if spec.data_id is None:
        return Frame(spec.can_id, payload.to_bytes(spec.length, "little"))
    data = bytearray(payload.to_bytes(PROTECTED_LENGTH, "little"))
    return Frame(spec.can_id, protect(data, spec.data_id, counter))


def decode(frame: Frame) -> Decoded | FrameFault | None:
    """Content of a frame; why it cannot be used; or None for an identifier that is not ours."""
    spec = SPECS.get(frame.can_id)
    if spec is None:
        return None
    if frame.kind is not FrameKind.DATA:
        return FrameFault.KIND
    return decode_data(spec.can_id, frame.data)


@lru_cache(maxsize=DECODE_CACHE_SIZE)
def decode_data(can_id: int, data: bytes) -> Decoded | FrameFault:
    """Content of a data frame whose identifier is one of ours.

    Pure, so the receivers of one process share the work of decoding one frame."""
    spec = SPECS[can_id]
    if len(data) != spec.length:
        return FrameFault.LENGTH
    counter = None
    if spec.data_id is not None:
        if not is_intact(data, spec.data_id):
            return FrameFault.CRC
        counter = data[COUNTER_BYTE] & 0x0F
    try:
        return Decoded(spec, counter, spec.unpack(int.from_bytes(data, "little")))
    except (SignalRangeError, KeyError):
        return FrameFault.VALUE
