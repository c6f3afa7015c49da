"""The bits of a frame against the lengths in `timing.py`, and against frames worked by hand."""

from __future__ import annotations

from itertools import groupby

from hypothesis import given
from hypothesis import strategies as st

from canbus.bitstream import TAIL, arbitration_key, frame_stream, run_length
from canbus.frame import Frame, FrameKind
from canbus.timing import INTERFRAME_SPACE_BITS, frame_bits

RUNS = st.lists(st.sampled_from([0x00, 0xFF, 0x0F, 0xF8, 0x83]), max_size=8).map(bytes)
STANDARD = st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8) | RUNS)
REMOTE = st.builds(Frame, st.integers(0, 0x7FF), st.just(b""), st.just(FrameKind.REMOTE))
EXTENDED = st.builds(
    Frame, st.integers(0, 0x1FFFFFFF), st.binary(max_size=8) | RUNS, st.just(FrameKind.EXTENDED)
)
FRAMES = STANDARD | REMOTE | EXTENDED


@given(FRAMES)
def test_stream_is_as_long_as_the_tables_say(frame: Frame) -> None:
    assert len(frame_stream(frame)) + INTERFRAME_SPACE_BITS == frame_bits(frame)


@given(FRAMES)
def test_no_more_than_five_equal_bits_stand_before_the_tail(frame: Frame) -> None:
    body = frame_stream(frame)[: -len(TAIL)]
    assert max(len(list(run)) for _, run in groupby(body)) <= 5


def test_frame_of_nothing_but_zeros_is_worked_by_hand() -> None:
    # 19 zeros of header and a CRC of 15 zeros: after every five zeros a one goes in
    zeros = [0, 0, 0, 0, 0, 1] * 6 + [0, 0, 0, 0]
    assert frame_stream(Frame(0x000)) == [*zeros, *TAIL]


@given(FRAMES, FRAMES)
def test_the_lower_key_is_dominant_where_two_frames_first_differ(a: Frame, b: Frame) -> None:
    """Arbitration by the bits themselves: the one who sends recessive there has lost."""
    key_a, key_b = arbitration_key(a), arbitration_key(b)
    if key_a == key_b:
        return
    pairs = zip(frame_stream(a), frame_stream(b), strict=False)
    bit_a, bit_b = next(pair for pair in pairs if pair[0] != pair[1])
    assert (key_a < key_b) == (bit_a < bit_b)


def test_equal_bits_at_the_end_are_counted() -> None:
    assert run_length([0, 1, 1, 1], 4) == 3
    assert run_length([0, 1, 1, 1], 1) == 1
    assert run_length([1, 1], 2) == 2
