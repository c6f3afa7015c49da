"""The bits of a classical CAN frame one by one, for what happens in the middle of a frame.

Lengths alone are in `timing.py`, by tables; this is for the rare frame that is disturbed, or that
two controllers send at once (ISO 11898-1).
"""

from __future__ import annotations

from typing import Final

from canbus.frame import Frame, FrameKind
from canbus.timing import CRC_BITS, crc15, header_bits

DOMINANT: Final = 0
RECESSIVE: Final = 1
DATA_SHIFT: Final = 20
"""A data frame's arbitration key is its identifier, shifted so."""
STUFF_RUN: Final = 5
"""After so many equal bits the sender puts in one of the other level."""
TAIL: Final = (RECESSIVE, DOMINANT, RECESSIVE, *[RECESSIVE] * 7)
"""CRC delimiter, acknowledge slot (somebody acknowledges), its delimiter, end of frame."""
ACK_SLOT_FROM_END: Final = 9
"""Position of the acknowledge slot, counted back from the end of the frame."""


def arbitration_key(frame: Frame) -> int:
    """What decides who may go on sending: the frame with the lowest key (ISO 11898-1).

    Base identifier, then RTR or SRR, then IDE, then the rest of a 29-bit identifier: a data frame
    goes before a remote one, both before any extended frame with the same first 11 bits.
    """
    if frame.kind is FrameKind.EXTENDED:
        base, rest = frame.can_id >> 18, frame.can_id & 0x3FFFF
        return base << DATA_SHIFT | 0b11 << 18 | rest
    return frame.can_id << DATA_SHIFT | (frame.kind is FrameKind.REMOTE) << 19


def frame_stream(frame: Frame) -> list[int]:
    """Every bit on the wire from the start of frame to the end of frame, stuff bits in.

    Of classical frames alone: `timing.frame_bits` refuses others.
    """
    length = len(frame.data)
    bits, count = header_bits(frame.can_id, frame.kind, length)
    bits = bits << 8 * length | int.from_bytes(frame.data, "big")
    count += 8 * length
    bits = bits << CRC_BITS | crc15(bits, count)
    count += CRC_BITS
    return [*stuffed([bits >> place & 1 for place in range(count - 1, -1, -1)]), *TAIL]


def stuffed(bits: list[int]) -> list[int]:
    """The bits with the stuff bits put in."""
    out: list[int] = []
    run = 0
    for bit in bits:
        run = run + 1 if out and bit == out[-1] else 1
        out.append(bit)
        if run == STUFF_RUN:
            out.append(1 - bit)
            run = 1
    return out


def run_length(stream: list[int], end: int) -> int:
    """How many equal bits stand at the end of `stream[:end]`."""
    run = 0
    while run < end and stream[end - 1 - run] == stream[end - 1]:
        run += 1
    return run
