"""What cuts a frame short, and how long the error frame then takes, bit by bit (ISO 11898-1).

Whoever sees an error sends a flag of six equal bits, which breaks the stuffing rule for all others,
who then send theirs; the delimiter follows. Lengths run from the start of frame to its end.
"""

from __future__ import annotations

from dataclasses import dataclass

from canbus.bitstream import ACK_SLOT_FROM_END, DOMINANT, RECESSIVE, frame_stream, run_length
from canbus.frame import Frame
from simulation.controller import Count

FLAG_BITS = 6
DELIMITER_BITS = 8
FD_FORMAT_BIT = 14
"""Where a classical controller sees that a frame is of the FD format, without stuff bits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """Noise on the wire while a frame is sent.

    Attributes:
        bit: which bit of the frame is seen wrong, counted from the start of frame, stuff bits
            in; taken modulo the frame's length.
        receiver: the only controller that sees it; None: the sender does, as all others do.
    """

    bit: int
    receiver: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameError:
    """How a frame ended.

    Attributes:
        bits: from its start of frame to the end of the error delimiter.
        count: how its sender counts it.
        finder: the receiver that saw it alone, if any.
    """

    bits: int
    count: Count = Count.SEND_ERROR
    finder: str | None = None


def disturbed(frame: Frame, bit: int, *, is_passive: bool = False) -> FrameError:
    """The sender reads a bit back as the opposite of what it sent.

    Args:
        frame: what it sends.
        bit: modulo the frame's length.
        is_passive: the sender is error-passive: its flag is six recessive bits.
    """
    stream = frame_stream(frame)
    bit %= len(stream)
    seen = [*stream[:bit], 1 - stream[bit]]
    level = RECESSIVE if is_passive else DOMINANT
    run = run_length(seen, len(seen)) if seen[-1] == level else 0
    # the others see the sixth equal bit, and send their own flags after it
    return FrameError(bits=bit + 1 + max(FLAG_BITS - run, 0) + FLAG_BITS + DELIMITER_BITS)


def found_by(receiver: str, frame: Frame, bit: int) -> FrameError:
    """One receiver alone sees a wrong bit and sends its flag; the sender sees that."""
    stream = frame_stream(frame)
    return FrameError(bits=_answered(stream, bit % (len(stream) - 1)), finder=receiver)


def collided(frames: list[Frame]) -> FrameError | None:
    """Frames with one identifier, sent at once; None if they are the same to the last bit.

    The sender of the recessive bit sees the dominant one where they first differ, and sends its
    flag; the other sees that at its next recessive bit.
    """
    streams = [frame_stream(frame) for frame in frames]
    for bit, levels in enumerate(zip(*streams, strict=False)):
        if DOMINANT in levels and RECESSIVE in levels:
            dominant = next(stream for stream in streams if stream[bit] == DOMINANT)
            return FrameError(bits=_answered(dominant, bit))
    return None


def not_acknowledged(frame: Frame) -> FrameError:
    """Nobody else is there: the acknowledge slot stays recessive, and the sender's flag alone."""
    bit = len(frame_stream(frame)) - ACK_SLOT_FROM_END
    return FrameError(bits=bit + 1 + FLAG_BITS + DELIMITER_BITS, count=Count.NOT_ACKNOWLEDGED)


def foreign_format() -> FrameError:
    """An FD frame on a bus of classical controllers: all refuse it at its format bit."""
    return FrameError(bits=FD_FORMAT_BIT + 1 + 2 * FLAG_BITS + DELIMITER_BITS)


def _answered(stream: list[int], bit: int) -> int:
    """Somebody else's flag begins after `bit`: it is seen at the next recessive bit of ours."""
    seen = stream.index(RECESSIVE, bit + 1)
    return seen + 1 + FLAG_BITS + DELIMITER_BITS
