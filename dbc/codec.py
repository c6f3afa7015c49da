"""Messages to frames and back, with the protection the DBC asks for.

Encoding a value that its signal cannot carry is the caller's mistake and raises. A bad frame is the
bus's and comes back as a `FrameFault`, never as an exception.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

from canbus.frame import Frame, FrameKind
from dbc.messages import SPECS
from dbc.protection import COUNTER_BYTE, COUNTER_MODULO, COUNTER_SHIFT, is_intact, with_crc
from dbc.spec import MessageSpec, SignalRangeError

MEMORY_PER_ID: Final = 256
"""Contents remembered per identifier: nodes repeat themselves, and all of them read the same."""


class FrameFault(IntEnum):
    """Why a frame of ours was ignored (ER0)."""

    KIND = 1
    LENGTH = 2
    CRC = 3
    SEQUENCE = 4
    REPEATED = 5
    VALUE = 6


@dataclass(slots=True, init=False, unsafe_hash=True)
class Decoded:
    """A frame's content; `counter` is None for a message without protection."""

    spec: Final[MessageSpec]
    counter: Final[int | None]
    message: Final[Any]

    def __init__(self, spec: MessageSpec, counter: int | None, message: Any) -> None:
        self.spec = spec
        self.counter = counter
        self.message = message


_ENCODED: Final[defaultdict[str, dict[int, Frame]]] = defaultdict(dict)
"""What `encode` remembers, by the message's name and its content with the counter."""


def encode(spec: MessageSpec, message: Any, counter: int = 0) -> Frame:
    """The frame that carries the message.

    Raises:
        SignalRangeError: A value outside its signal's range, or NaN where the signal has no code
            for "not available".
    """
    return encode_bits(spec, spec.pack(message), counter)


def encode_bits(spec: MessageSpec, bits: int, counter: int = 0) -> Frame:
    """The same for a message that has been packed already."""
    if spec.data_id is not None:
        assert 0 <= counter < COUNTER_MODULO
        bits |= counter << COUNTER_SHIFT
    known = _ENCODED[spec.name]
    frame = known.get(bits)
    if frame is None:
        if len(known) >= MEMORY_PER_ID:
            known.clear()
        frame = known[bits] = Frame(spec.can_id, frame_data(spec, bits))
    return frame


def frame_data(spec: MessageSpec, bits: int) -> bytes:
    """Data of a frame for its packed content, counter in: what `encode_bits` remembers."""
    if spec.data_id is None:
        return bits.to_bytes(spec.length, "little")
    return with_crc(bits, spec.data_id)


def decode(frame: Frame) -> Decoded | FrameFault | None:
    """Content of a frame; why it cannot be used; or None for an identifier that is not ours."""
    spec = SPECS.get(frame.can_id)
    if spec is None:
        return None
    if frame.kind is not FrameKind.DATA:
        return FrameFault.KIND
    return decode_data(spec.can_id, frame.data)


DECODED: Final[dict[int, dict[bytes, Decoded | FrameFault]]] = {can_id: {} for can_id in SPECS}
"""What `decode_data` remembers, by identifier and data."""


def decode_data(can_id: int, data: bytes) -> Decoded | FrameFault:
    """Content of a data frame whose identifier is one of ours.

    Pure, so the receivers of one process share the work of decoding one frame."""
    known = DECODED[can_id]
    decoded = known.get(data)
    if decoded is None:
        if len(known) >= MEMORY_PER_ID:
            known.clear()
        decoded = known[data] = decode_anew(SPECS[can_id], data)
    return decoded


def decode_anew(spec: MessageSpec, data: bytes) -> Decoded | FrameFault:
    """The same without remembering."""
    if len(data) != spec.length:
        return FrameFault.LENGTH
    counter: int | None = None
    if spec.data_id is not None:
        if not is_intact(data, spec.data_id):
            return FrameFault.CRC
        counter = data[COUNTER_BYTE] & 0x0F
    try:
        return Decoded(spec, counter, spec.unpack(int.from_bytes(data, "little")))
    except (SignalRangeError, KeyError):
        return FrameFault.VALUE
