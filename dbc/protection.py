"""End-to-end protection of frames: CRC, alive counter and the receiver's judgement of them.

AUTOSAR E2E Profile 1 (AUTOSAR FO R22-11, PRS E2E Protocol): CRC-8 SAE J1850 in byte 0, a counter
0-14 in the low nibble of byte 1, the data id in the CRC (mode BOTH). The CRC is added up from
tables that the library fills; the counter's state machine is the table below.

What it can claim: a repeated frame, and a loss within the counter's window, are always seen; about
one in 256 random corruptions passes the CRC. A frame recorded earlier whose counter happens to fit
cannot be told from a new one: only authentication excludes replay.
"""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import Final

from e2e.p01 import e2e_p01_protect

COUNTER_MODULO: Final = 15
COUNTER_INVALID: Final = 15
COUNTER_BYTE: Final = 1
COUNTER_SHIFT: Final = 8
"""Place of the counter in the payload as a little-endian integer."""
PROTECTED_LENGTH: Final = 8


def _library_crc(data: bytes, data_id: int) -> int:
    """CRC as the library computes it."""
    payload = bytearray(data)
    e2e_p01_protect(payload, data_id, increment_counter=False)
    return payload[0]


# The CRC is linear: it is the sum (XOR) of what the data id and each byte contribute at their own
# places. A table for each byte behind the CRC; the data ids' shares are added as they come.
_NOTHING: Final = bytes(PROTECTED_LENGTH)


def _table(place: int) -> list[int]:
    return [
        _library_crc(bytes(value if place == n else 0 for n in range(PROTECTED_LENGTH)), 0)
        ^ _library_crc(_NOTHING, 0)
        for value in range(256)
    ]


_T1: Final = _table(1)
_T2: Final = _table(2)
_T3: Final = _table(3)
_T4: Final = _table(4)
_T5: Final = _table(5)
_T6: Final = _table(6)
_T7: Final = _table(7)
_crc_of_id: Final[dict[int, int]] = {}


def crc(data: bytes, data_id: int) -> int:
    """CRC-8 of 8 bytes; byte 0, where it goes, plays no part."""
    of_id = _crc_of_id.get(data_id)
    if of_id is None:
        of_id = _crc_of_id[data_id] = _library_crc(_NOTHING, data_id)
    return (
        of_id ^ _T1[data[1]] ^ _T2[data[2]] ^ _T3[data[3]]
        ^ _T4[data[4]] ^ _T5[data[5]] ^ _T6[data[6]] ^ _T7[data[7]]
    )


def protect(payload: bytes | bytearray, data_id: int, counter: int) -> bytes:
    """The payload with counter and CRC put in.

    Args:
        payload: 8 bytes; the low nibble of byte 1 must be zero. Byte 0 is overwritten.
        data_id: The DBC's E2EDataId.
        counter: 0 to 14.
    """
    assert len(payload) == PROTECTED_LENGTH and 0 <= counter < COUNTER_MODULO
    bits = int.from_bytes(payload, "little") & ~0xFF | counter << COUNTER_SHIFT
    return with_crc(bits, data_id)


def with_crc(bits: int, data_id: int) -> bytes:
    """The frame's data for a payload as a little-endian integer, counter in, CRC still zero."""
    return (bits | crc(bits.to_bytes(PROTECTED_LENGTH, "little"), data_id)).to_bytes(
        PROTECTED_LENGTH, "little"
    )


def is_intact(data: bytes, data_id: int) -> bool:
    """Whether the CRC fits data and data id, and the counter is a valid one."""
    return data[0] == crc(data, data_id) and data[COUNTER_BYTE] & 0x0F != COUNTER_INVALID


class Step(Enum):
    """How far a frame's counter is from the last one accepted."""

    FIRST = 0
    SAME = 1
    NEXT = 2
    SKIPPED_ONE = 3
    JUMP = 4
    CORRUPT = 5


class AliveState(IntEnum):
    """The receiver's judgement after a frame."""

    INITIAL = 0
    OK = 1
    REPEATED = 2
    LOST_ONE = 3
    WRONG_SEQUENCE = 4
    ERROR = 5


USABLE: Final = frozenset({AliveState.OK, AliveState.LOST_ONE})
"""Only in these states may the frame's content be used."""

_A, _S = AliveState, Step
# A first frame only tells where the counter stands. After a jump (the sender restarted, two frames
# lost, one injected) a frame in sequence is wanted before content is trusted again. Corrupt frames
# tell nothing about the counter, so the next good one shows as LOST_ONE.
STATE_AFTER: Final[dict[bool, dict[Step, AliveState]]] = {
    True: {  # in sequence so far
        _S.FIRST: _A.WRONG_SEQUENCE,
        _S.SAME: _A.REPEATED,
        _S.NEXT: _A.OK,
        _S.SKIPPED_ONE: _A.LOST_ONE,
        _S.JUMP: _A.WRONG_SEQUENCE,
        _S.CORRUPT: _A.ERROR,
    },
    False: {  # sequence not known, or lost
        _S.FIRST: _A.WRONG_SEQUENCE,
        _S.SAME: _A.REPEATED,
        _S.NEXT: _A.OK,
        _S.SKIPPED_ONE: _A.WRONG_SEQUENCE,
        _S.JUMP: _A.WRONG_SEQUENCE,
        _S.CORRUPT: _A.ERROR,
    },
}

_STEP_OF_DISTANCE: Final = (_S.NEXT, _S.SKIPPED_ONE, *([_S.JUMP] * (COUNTER_MODULO - 3)), _S.SAME)
"""Step by how far a counter is beyond the one expected next."""

UNKNOWN: Final = -1


class AliveCheck:
    """Judges the frames of one identifier, one after the other.

    Attributes:
        state: The judgement of the last frame.
        expected: The counter that comes next if nothing is lost; UNKNOWN before the first frame.
        is_in_sequence: False until a frame has followed on another, and again after a jump.
    """

    __slots__ = ("expected", "is_in_sequence", "state")

    def __init__(self) -> None:
        self.state = AliveState.INITIAL
        self.expected = UNKNOWN
        self.is_in_sequence = False

    def judge(self, counter: int | None) -> AliveState:
        """The state after a frame with this counter; None for a frame whose CRC is wrong."""
        if counter is None:
            step = Step.CORRUPT
        elif self.expected == UNKNOWN:
            step = Step.FIRST
        else:
            step = _STEP_OF_DISTANCE[(counter - self.expected) % COUNTER_MODULO]
        self.state = STATE_AFTER[self.is_in_sequence][step]
        if counter is not None:
            self.expected = (counter + 1) % COUNTER_MODULO
        if self.state is AliveState.WRONG_SEQUENCE:
            self.is_in_sequence = False
        elif self.state is AliveState.OK:
            self.is_in_sequence = True
        return self.state
