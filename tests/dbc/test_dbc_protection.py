"""AUTOSAR E2E Profile 1 on our frames, and the receiver's state machine."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.messages import SPECS
from dbc.protection import (
    STATE_AFTER,
    USABLE,
    AliveCheck,
    AliveState,
    Step,
    is_intact,
    protect,
)

DATA_IDS = [spec.data_id for spec in SPECS.values() if spec.data_id is not None]


# CRC and counter ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("counter", "expected"), [(0, "cc00"), (1, "9101"), (2, "7602")])
def test_the_check_vectors_of_profile_1_with_data_id_mode_both(
    counter: int, expected: str
) -> None:
    assert protect(bytearray(8), 0x123, counter).hex() == expected + "000000000000"


def crc_by_hand(data: bytes, data_id: int) -> int:
    """CRC-8 SAE J1850 bit by bit, start and final XOR as AUTOSAR's library has them."""
    register = 0x00  # start value 0xFF and the library's own XOR of 0xFF cancel
    for byte in (data_id & 0xFF, data_id >> 8, *data[1:]):
        register ^= byte
        for _ in range(8):
            register = (register << 1 ^ (0x1D if register & 0x80 else 0)) & 0xFF
    return register


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    payload=st.binary(min_size=4, max_size=4),
    data_id=st.integers(0, 0xFFFF),
    counter=st.integers(0, 14),
)
def test_the_crc_is_j1850_over_data_id_and_bytes_1_to_7(
    payload: bytes, data_id: int, counter: int
) -> None:
    frame = protect(bytearray(4) + payload, data_id, counter)
    assert frame[0] == crc_by_hand(frame, data_id)
    assert frame[1:] == bytes([counter, 0, 0]) + payload
    assert is_intact(frame, data_id)


@pytest.mark.parametrize("data_id", DATA_IDS)
def test_every_flip_of_one_bit_is_caught(data_id: int) -> None:
    for payload in (bytes(4), b"\xff" * 4, b"\x12\x34\x56\x78"):
        for counter in (0, 7, 14):
            frame = protect(bytearray(4) + payload, data_id, counter)
            for bit in range(64):
                flipped = bytearray(frame)
                flipped[bit // 8] ^= 1 << bit % 8
                assert not is_intact(bytes(flipped), data_id)


def test_every_burst_of_eight_bits_in_the_payload_is_caught() -> None:
    frame = protect(bytearray(4) + b"\x12\x34\x56\x78", 0x181, 5)
    number = int.from_bytes(frame, "big")
    for shift in range(49):  # within bytes 1-7; the CRC itself stands in front of them
        for pattern in range(1, 256, 2):
            flipped = (number ^ pattern << shift).to_bytes(8, "big")
            assert not is_intact(flipped, 0x181)


def test_counter_15_is_never_intact() -> None:
    for crc in range(256):
        assert not is_intact(bytes([crc, 0x0F, 0, 0, 0, 0, 0, 0]), 0x181)


def test_a_counter_or_a_length_that_is_none_is_the_programmers_error() -> None:
    for payload, counter in ((bytearray(8), 15), (bytearray(8), -1), (bytearray(7), 0)):
        with pytest.raises(AssertionError):
            protect(payload, 0x181, counter)


# The receiver's table ----------------------------------------------------------------------------

A, S = AliveState, Step
TABLE = {
    (True, S.FIRST): A.WRONG_SEQUENCE,
    (True, S.SAME): A.REPEATED,
    (True, S.NEXT): A.OK,
    (True, S.SKIPPED_ONE): A.LOST_ONE,
    (True, S.JUMP): A.WRONG_SEQUENCE,
    (True, S.CORRUPT): A.ERROR,
    (False, S.FIRST): A.WRONG_SEQUENCE,
    (False, S.SAME): A.REPEATED,
    (False, S.NEXT): A.OK,
    (False, S.SKIPPED_ONE): A.WRONG_SEQUENCE,
    (False, S.JUMP): A.WRONG_SEQUENCE,
    (False, S.CORRUPT): A.ERROR,
}


def test_the_table_is_what_was_written_by_hand() -> None:
    assert {(seq, step): s for seq, row in STATE_AFTER.items() for step, s in row.items()} == TABLE
    assert {A.OK, A.LOST_ONE} == USABLE


def after(*counters: int | None) -> AliveCheck:
    check = AliveCheck()
    for counter in counters:
        check.judge(counter)
    return check


@pytest.mark.parametrize(
    ("heard", "counter", "state"),
    [
        ((), 9, A.WRONG_SEQUENCE),  # a first frame only tells where the counter stands
        ((9,), 10, A.OK),
        ((9,), 9, A.REPEATED),
        ((9,), 11, A.WRONG_SEQUENCE),
        ((9, 9), 10, A.OK),
        ((9, 9), 11, A.WRONG_SEQUENCE),  # a repetition proves no sequence
        ((9, None), 11, A.WRONG_SEQUENCE),  # nor does a corrupt frame
        ((9, 10, 13, 13), 0, A.WRONG_SEQUENCE),
        ((9, 10), 11, A.OK),
        ((9, 10), 10, A.REPEATED),
        ((9, 10), 12, A.LOST_ONE),
        ((9, 10, 12), 13, A.OK),
        ((9, 10, 12), 14, A.LOST_ONE),
        ((9, 10), 13, A.WRONG_SEQUENCE),
        ((9, 10, 13), 14, A.OK),  # two lost: one frame in sequence, and content counts again
        ((9, 10, 13), 0, A.WRONG_SEQUENCE),
        ((9, 10), 9, A.WRONG_SEQUENCE),
        ((13, 14), 0, A.OK),  # 15 is never sent
        ((13, 14), 1, A.LOST_ONE),
        ((9, 10), None, A.ERROR),
        ((9, 10, None), 12, A.LOST_ONE),  # the corrupt one was the one lost
        ((9, 10, None), 11, A.OK),  # the corrupt one was a stranger's
        ((9, 10, None, None), 13, A.WRONG_SEQUENCE),
        ((None,), 3, A.WRONG_SEQUENCE),
        ((None, 3), 4, A.OK),
    ],
)
def test_the_judgement_of_a_frame(
    heard: tuple[int | None, ...], counter: int | None, state: AliveState
) -> None:
    check = after(*heard)
    assert check.judge(counter) is state and check.state is state


@pytest.mark.parametrize("last", range(15))
@pytest.mark.parametrize("distance", range(15))
def test_every_distance_from_the_last_counter(last: int, distance: int) -> None:
    by_hand = {0: A.REPEATED, 1: A.OK, 2: A.LOST_ONE}
    check = after((last - 1) % 15, last)
    assert check.judge((last + distance) % 15) is by_hand.get(distance, A.WRONG_SEQUENCE)


# Replays -----------------------------------------------------------------------------------------

WINDOW = 13
"""Frames back whose counter can be told from that of the next one or the one after it."""


@settings(max_examples=150, deadline=None, derandomize=True)
@given(script=st.lists(st.one_of(st.none(), st.integers(0, WINDOW - 1)), max_size=60))
def test_a_recorded_frame_between_genuine_ones_never_passes_as_new(
    script: list[int | None]
) -> None:
    """None: a genuine frame; k: the frame sent k before the last is recorded and sent again.

    A stranger may repeat any one frame as often as he likes between two genuine ones.
    """
    sent = 0
    check = after(13, 14)
    for entry in [*[None] * WINDOW, *script]:
        if entry is None:
            check.judge(sent % 15)
            sent += 1
        else:
            for _ in range(3):
                assert check.judge((sent - 1 - entry) % 15) not in USABLE
            check.judge(sent % 15)
            sent += 1


@settings(max_examples=150, deadline=None, derandomize=True)
@given(ages=st.lists(st.integers(0, WINDOW - 1), min_size=1, max_size=60))
def test_recorded_frames_pass_only_when_two_of_them_follow_on_each_other(ages: list[int]) -> None:
    check = after(0, 1)  # the last genuine counter is 1
    heard = 1
    for age in ages:
        counter = (1 - age) % 15
        state = check.judge(counter)
        follows = counter == (heard + 1) % 15
        assert (state in USABLE) <= follows or state is A.LOST_ONE
        if state is A.LOST_ONE:  # only after two that followed on each other
            assert counter == (heard + 2) % 15
        heard = counter


def test_the_limit_of_the_claim_two_recorded_frames_in_their_order_pass() -> None:
    """Indistinguishable from two genuine frames after a loss: only authentication excludes it."""
    check = after(9, 10)
    assert check.judge(5) is A.WRONG_SEQUENCE
    assert check.judge(6) is A.OK


@settings(max_examples=200, deadline=None, derandomize=True)
@given(losses=st.lists(st.booleans(), max_size=100))
def test_frames_with_single_losses_are_all_used(losses: list[bool]) -> None:
    check = after(0, 1)
    was_lost = False
    for counter, is_lost in enumerate(losses, start=2):
        was_lost = is_lost and not was_lost
        if not was_lost:
            assert check.judge(counter % 15) in USABLE


@pytest.mark.parametrize("lost", range(2, 14))
def test_after_more_losses_one_frame_in_sequence_is_wanted(lost: int) -> None:
    check = after(0, 1)
    first = 1 + lost + 1
    state = check.judge(first % 15)
    assert state is (A.REPEATED if lost == 14 else A.WRONG_SEQUENCE)
    assert check.judge((first + 1) % 15) is A.OK
