"""How long a classical CAN frame takes, and the longest a frame can wait for the bus.

Lengths are exact: stuff bits are counted from the actual bits, CRC-15 included (ISO 11898-1).
They run from start of frame to the end of the interframe space, as in the response-time
literature; a receiver has the frame `INTERFRAME_SPACE_BITS` earlier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from canbus.frame import CAN_ID_MAX, Frame, FrameKind

CRC_POLYNOMIAL: Final = 0x4599
"""CRC-15 of classical CAN (ISO 11898-1)."""
INTERFRAME_SPACE_BITS: Final = 3
FIXED_TAIL_BITS: Final = 10
"""Never stuffed: CRC delimiter, acknowledge slot and delimiter, seven bits end of frame."""
ERROR_SIGNAL_BITS_MAX: Final = 23
"""Error flag (6) echoed by the others (up to 6), delimiter (8), interframe space (3)."""
STANDARD_HEADER_BITS: Final = 19
"""Start of frame, identifier 11, RTR, IDE, r0, DLC 4."""
EXTENDED_HEADER_BITS: Final = 39
"""Start of frame, identifier 11, SRR, IDE, identifier 18, RTR, r1, r0, DLC 4."""
CRC_BITS: Final = 15
DATA_BYTES_MAX: Final = 8

_CRC_MASK: Final = 0x7FFF
_NS_PER_S: Final = 1_000_000_000


def _stuff(state: int, bits: int, count: int) -> tuple[int, int]:
    """Stuff bits that `count` bits (most significant first) cause, and the state after them.

    A state is `level * 4 + run - 1`: the level of the last bit on the wire and how often it has
    been repeated, 1 to 4. At the fifth repetition the complement goes out, and starts a new run.
    """
    stuffed = 0
    level, run = state >> 2, (state & 3) + 1
    for position in range(count - 1, -1, -1):
        bit = (bits >> position) & 1
        run = run + 1 if bit == level else 1
        level = bit
        if run == 5:
            stuffed += 1
            level, run = 1 - level, 1
    return stuffed, level * 4 + run - 1


def _crc(crc: int, bits: int, count: int) -> int:
    """CRC-15 register after `count` more bits, most significant first."""
    for position in range(count - 1, -1, -1):
        feedback = ((bits >> position) & 1) ^ (crc >> 14)
        crc = (crc << 1) & _CRC_MASK
        if feedback:
            crc ^= CRC_POLYNOMIAL
    return crc


# For each state (times 256) and byte: the stuff bits the byte causes, and the state after it, in
# its place for the next look-up. The end of the CRC has 7 bits: for them the stuff bits alone.
_STUFF_MASK: Final = 0x3
_STATE_MASK: Final = 0x700
_STUFF_OF_BYTE: Final[list[int]] = []
_STUFF_OF_TAIL: Final[list[int]] = []
for _state in range(8):
    for _value in range(256):
        _stuffed, _after = _stuff(_state, _value, 8)
        _STUFF_OF_BYTE.append(_stuffed | _after << 8)
    _STUFF_OF_TAIL.extend(_stuff(_state, _value, 7)[0] for _value in range(128))

# The CRC is linear: it is the sum (XOR) of what each byte contributes at its own place.
_CRC_OF_BYTE: Final = [_crc(0, value, 8) for value in range(256)]
_CRC_BY_BYTES_BEHIND: Final = [_CRC_OF_BYTE]
for _ in range(DATA_BYTES_MAX - 1):
    _CRC_BY_BYTES_BEHIND.append(
        [crc << 8 & _CRC_MASK ^ _CRC_OF_BYTE[crc >> 7] for crc in _CRC_BY_BYTES_BEHIND[-1]]
    )
_CRC_TABLES: Final = [_CRC_BY_BYTES_BEHIND[:length][::-1] for length in range(DATA_BYTES_MAX + 1)]


def header_bits(can_id: int, kind: FrameKind, length: int) -> tuple[int, int]:
    """Start of frame to length code as a number, and how many bits that is."""
    if kind is FrameKind.EXTENDED:
        base, rest = can_id >> 18, can_id & 0x3FFFF
        return base << 27 | 0b11 << 25 | rest << 7 | length, EXTENDED_HEADER_BITS
    return can_id << 7 | (kind is FrameKind.REMOTE) << 6 | length, STANDARD_HEADER_BITS


def crc15(bits: int, count: int) -> int:
    """CRC-15 of `count` bits, most significant first (ISO 11898-1)."""
    return _crc(0, bits, count)


class _Header:
    """What is known of a frame without its data, and the lengths found for some data."""

    __slots__ = ("bits", "crc", "crc_tables", "known", "state")

    def __init__(self, can_id: int, kind: FrameKind, length: int) -> None:
        bits, count = header_bits(can_id, kind, length)
        # Start of frame is dominant after a recessive bus: it starts the first run.
        stuffed, state = _stuff(0, bits, count - 1)
        self.bits = (
            stuffed + count + 8 * length + CRC_BITS + FIXED_TAIL_BITS + INTERFRAME_SPACE_BITS
        )
        self.state = state << 8
        self.crc = _crc(_crc(0, bits, count), 0, 8 * length)
        self.crc_tables = _CRC_TABLES[length]
        self.known: dict[bytes, int] = {}


_HEADERS_MAX: Final = 4096
_LENGTHS_PER_HEADER: Final = 256
_headers: Final[dict[int, _Header]] = {}


def _new_header(key: int, can_id: int, kind: FrameKind, length: int) -> _Header:
    """The header of a frame, checked and remembered."""
    if kind > FrameKind.EXTENDED or length > DATA_BYTES_MAX:
        raise ValueError(f"no classical frame: {kind.name} with {length} bytes")
    if can_id >> (29 if kind is FrameKind.EXTENDED else 11):
        raise ValueError(f"identifier {can_id:#x} does not fit a {kind.name} frame")
    if len(_headers) >= _HEADERS_MAX:
        _headers.clear()
    header = _headers[key] = _Header(can_id, kind, length)
    return header


def frame_bits(frame: Frame) -> int:
    """Exact length of a classical frame on the wire in bits, stuffing and interframe space in.

    Args:
        frame: DATA or REMOTE (11-bit identifier) or EXTENDED (29-bit, data). A remote frame is
            taken as one with DLC 0.

    Raises:
        ValueError: an FD or ERROR frame, an identifier out of range or more than 8 data bytes.
    """
    data = frame.data
    key = (frame.can_id << 3 | frame.kind) << 7 | len(data)
    header = _headers.get(key)
    if header is None:
        header = _new_header(key, frame.can_id, frame.kind, len(data))
    known = header.known
    bits = known.get(data)
    if bits is None:
        if len(known) >= _LENGTHS_PER_HEADER:
            known.clear()
        bits = known[data] = _count_bits(header, data)
    return bits


def _count_bits(header: _Header, data: bytes) -> int:
    bits, state, crc, table = header.bits, header.state, header.crc, _STUFF_OF_BYTE
    crc_tables = header.crc_tables
    for place, value in enumerate(data):
        entry = table[state | value]
        bits += entry & _STUFF_MASK
        state = entry & _STATE_MASK
        crc ^= crc_tables[place][value]
    entry = table[state | crc >> 7]
    tail = _STUFF_OF_TAIL[(entry & _STATE_MASK) >> 1 | crc & 0x7F]
    return bits + (entry & _STUFF_MASK) + tail


def frame_bits_max(length: int, *, extended: bool = False) -> int:
    """Longest a frame with `length` data bytes can be, interframe space included.

    Davis, Burns, Bril and Lukkien 2007, equation 1: g + 8s + 13 + floor((g + 8s - 1) / 4) with
    g = 34 (11-bit) or 54 (29-bit).

    Raises:
        ValueError: `length` is not 0 to 8.
    """
    if not 0 <= length <= DATA_BYTES_MAX:
        raise ValueError(f"length: {length} bytes; a classical frame holds 0 to {DATA_BYTES_MAX}")
    stuffable = (EXTENDED_HEADER_BITS if extended else STANDARD_HEADER_BITS) + CRC_BITS + 8 * length
    return stuffable + (stuffable - 1) // 4 + FIXED_TAIL_BITS + INTERFRAME_SPACE_BITS


def bits_time_ns(bits: int, bitrate: int) -> int:
    """Duration of `bits` at `bitrate` (bit/s) in ns, rounded up."""
    return -(-bits * _NS_PER_S // bitrate)


def frame_time_ns(frame: Frame, bitrate: int) -> int:
    """Time `frame` keeps the bus busy at `bitrate` (bit/s), interframe space included, in ns."""
    return bits_time_ns(frame_bits(frame), bitrate)


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageTiming:
    """A periodic message, as the response-time analysis sees it.

    Attributes:
        can_id: identifier, which is also the priority: the smaller wins.
        length: data bytes, 0 to 8.
        period_ns: shortest time between two queuings.
        jitter_ns: how much later than its nominal time a message may be queued.
        extended: 29-bit identifier.
    """

    can_id: int
    length: int
    period_ns: int
    jitter_ns: int = 0
    extended: bool = False

    def __post_init__(self) -> None:
        """Refuse what the analysis is not defined for."""
        if self.period_ns <= 0 or self.jitter_ns < 0:
            raise ValueError(
                f"message {self.can_id:#x}: period {self.period_ns} ns must be above 0, "
                f"jitter {self.jitter_ns} ns at least 0"
            )


def _priority(message: MessageTiming) -> tuple[int, bool, int]:
    """Arbitration order: 11 base bits, then standard before extended, then the other 18."""
    if message.extended:
        return message.can_id >> 18, True, message.can_id & 0x3FFFF
    assert message.can_id <= CAN_ID_MAX, "11-bit identifier"
    return message.can_id, False, 0


def bus_load(messages: Sequence[MessageTiming], bitrate: int) -> float:
    """Share of the bus that `messages` take with all frames at their longest, 0 to 1 (or more)."""
    return sum(_time_max_ns(message, bitrate) / message.period_ns for message in messages)


def response_times_ns(messages: Sequence[MessageTiming], bitrate: int) -> dict[int, int]:
    """Worst time from a message's nominal queuing to its end on the wire, per identifier, in ns.

    Davis, Burns, Bril and Lukkien 2007, "Controller Area Network (CAN) schedulability analysis:
    refuted, revisited and revised", equations 6 to 14 (all instances in the busy period, not
    the first alone). Assumes priority queues without transmit aborts, and no errors.

    Raises:
        ValueError: an identifier appears twice, or the bus is overloaded down to some priority, so
            that no bound exists.
    """
    ordered = sorted(messages, key=_priority)
    for first, second in pairwise(sorted(message.can_id for message in ordered)):
        if first == second:
            raise ValueError(f"identifier {first:#x} appears twice")
    times = [_time_max_ns(message, bitrate) for message in ordered]
    result: dict[int, int] = {}
    for index, message in enumerate(ordered):
        if bus_load(ordered[: index + 1], bitrate) >= 1:
            raise ValueError(f"bus overloaded at {message.can_id:#x}: no bound on its response")
        blocking_ns = max(times[index + 1 :], default=0)
        result[message.can_id] = _response_ns(
            ordered[: index + 1], times, blocking_ns, bits_time_ns(1, bitrate)
        )
    return result


def _time_max_ns(message: MessageTiming, bitrate: int) -> int:
    return bits_time_ns(frame_bits_max(message.length, extended=message.extended), bitrate)


def _response_ns(
    ordered: Sequence[MessageTiming], times: Sequence[int], blocking_ns: int, bit_ns: int
) -> int:
    """Response time of the last of `ordered`, whose others all outrank it."""
    own, own_ns = ordered[-1], times[len(ordered) - 1]
    above = list(zip(ordered[:-1], times, strict=False))

    busy_ns = 0
    longer_ns = own_ns
    while longer_ns != busy_ns:
        busy_ns = longer_ns
        longer_ns = blocking_ns + sum(
            -(-(busy_ns + message.jitter_ns) // message.period_ns) * time_ns
            for message, time_ns in (*above, (own, own_ns))
        )

    worst_ns = 0
    for instance in range(-(-(busy_ns + own.jitter_ns) // own.period_ns)):
        wait_ns, longer_ns = -1, blocking_ns + instance * own_ns
        while longer_ns != wait_ns:
            wait_ns = longer_ns
            longer_ns = (
                blocking_ns
                + instance * own_ns
                + sum(
                    -(-(wait_ns + message.jitter_ns + bit_ns) // message.period_ns) * time_ns
                    for message, time_ns in above
                )
            )
        worst_ns = max(worst_ns, own.jitter_ns + wait_ns - instance * own.period_ns + own_ns)
    return worst_ns
