"""Frame lengths against a bit-by-bit reference, response times against published values."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canbus.frame import Frame, FrameKind
from canbus.timing import (
    MessageTiming,
    bits_time_ns,
    bus_load,
    frame_bits,
    frame_bits_max,
    frame_time_ns,
    response_times_ns,
)

DETERMINISTIC = settings(derandomize=True, deadline=None)
STANDARD_IDS = st.integers(0, 0x7FF)
EXTENDED_IDS = st.integers(0, 0x1FFFFFFF)
DATA = st.binary(max_size=8)
# Long runs of equal bits are where stuffing goes wrong, and are rare in random bytes.
RUNS = st.lists(st.sampled_from([0x00, 0xFF, 0x0F, 0xF8, 0x07, 0x83]), max_size=8).map(bytes)


def reference_bits(frame: Frame) -> int:
    """ISO 11898-1 written out bit by bit, as text: slow, and shares nothing with the tables."""
    dlc = f"{len(frame.data):04b}"
    if frame.kind is FrameKind.EXTENDED:
        identifier = f"{frame.can_id:029b}"
        header = "0" + identifier[:11] + "1" + "1" + identifier[11:] + "0" + "00" + dlc
    else:
        remote = "1" if frame.kind is FrameKind.REMOTE else "0"
        header = "0" + f"{frame.can_id:011b}" + remote + "0" + "0" + dlc
    bits = header + "".join(f"{byte:08b}" for byte in frame.data)

    register = [0] * 15
    for bit in bits:
        invert = int(bit) ^ register[0]
        register = [*register[1:], 0]
        if invert:
            # x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1
            for power in (14, 10, 8, 7, 4, 3, 0):
                register[14 - power] ^= 1
    bits += "".join(map(str, register))

    wire = ""
    for bit in bits:
        wire += bit
        if len(wire) >= 5 and wire[-5:] in ("00000", "11111"):
            wire += "1" if bit == "0" else "0"
    return len(wire) + 1 + 2 + 7 + 3


def test_frame_of_nothing_but_zeros_has_its_hand_worked_length() -> None:
    # 19 zeros of header have a CRC of 15 zeros; every 5 of the 34 are followed by a stuff bit.
    assert frame_bits(Frame(0x000, b"")) == 34 + 6 + 10 + 3


@pytest.mark.parametrize("data", [bytes(8), b"\xff" * 8, b"\x0f\x83" * 4, bytes(range(8))])
def test_extreme_payloads_are_as_long_as_the_reference_says(data: bytes) -> None:
    for can_id in (0x000, 0x078, 0x7FF):
        frame = Frame(can_id, data)
        assert frame_bits(frame) == reference_bits(frame)


@DETERMINISTIC
@given(can_id=STANDARD_IDS, data=DATA | RUNS)
def test_standard_frames_are_as_long_as_the_reference_says(can_id: int, data: bytes) -> None:
    frame = Frame(can_id, data)
    assert frame_bits(frame) == reference_bits(frame)


@DETERMINISTIC
@given(can_id=EXTENDED_IDS, data=DATA | RUNS)
def test_extended_frames_are_as_long_as_the_reference_says(can_id: int, data: bytes) -> None:
    frame = Frame(can_id, data, FrameKind.EXTENDED)
    assert frame_bits(frame) == reference_bits(frame)


@DETERMINISTIC
@given(can_id=STANDARD_IDS)
def test_remote_frames_are_as_long_as_the_reference_says(can_id: int) -> None:
    frame = Frame(can_id, b"", FrameKind.REMOTE)
    assert frame_bits(frame) == reference_bits(frame)


@DETERMINISTIC
@given(can_id=STANDARD_IDS, data=DATA | RUNS)
def test_no_frame_is_longer_than_the_worst_case(can_id: int, data: bytes) -> None:
    unstuffed = 47 + 8 * len(data)
    assert unstuffed <= frame_bits(Frame(can_id, data)) <= frame_bits_max(len(data))


@pytest.mark.parametrize(
    ("length", "standard", "extended"),
    # Davis et al. 2007, equations 2 and 3: (55 + 10 s) and (80 + 10 s) bits.
    [(length, 55 + 10 * length, 80 + 10 * length) for length in range(9)],
)
def test_worst_case_lengths_are_the_published_ones(
    length: int, standard: int, extended: int
) -> None:
    assert frame_bits_max(length) == standard
    assert frame_bits_max(length, extended=True) == extended


def test_longest_eight_byte_frame_has_135_bits() -> None:
    assert frame_bits_max(8) == 135


def test_frame_time_follows_the_bitrate() -> None:
    frame = Frame(0x123, b"\x55")
    assert frame_time_ns(frame, 500_000) == frame_bits(frame) * 2_000
    assert frame_time_ns(frame, 250_000) == frame_bits(frame) * 4_000


def test_a_time_that_is_no_whole_ns_is_rounded_up() -> None:
    assert bits_time_ns(1, 3_000_000) == 334


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x123, b"", FrameKind.ERROR),
        Frame(0x123, bytes(12), FrameKind.FD),
        Frame(0x123, bytes(9)),
        Frame(0x800, b""),
        Frame(0x20000000, b"", FrameKind.EXTENDED),
    ],
)
def test_what_is_no_classical_frame_is_refused(frame: Frame) -> None:
    with pytest.raises(ValueError, match=r"0x|bytes"):
        frame_bits(frame)


@pytest.mark.parametrize("length", [-1, 9])
def test_worst_case_of_an_impossible_length_is_refused(length: int) -> None:
    with pytest.raises(ValueError, match="0 to 8"):
        frame_bits_max(length)


def message(can_id: int, period_ms: float, length: int = 7, jitter_ms: float = 0) -> MessageTiming:
    return MessageTiming(
        can_id=can_id,
        length=length,
        period_ns=round(period_ms * 1e6),
        jitter_ns=round(jitter_ms * 1e6),
    )


def test_example_that_refuted_the_old_analysis_gives_its_published_response_times() -> None:
    # Davis et al. 2007, tables 2 and 3: 125 bits at 125 kbit/s are 1 ms. The old analysis looks at
    # the first instance of C alone and gives 3.0 ms; its second instance takes 3.5 ms.
    messages = [message(1, 2.5), message(2, 3.5), message(3, 3.5)]
    assert response_times_ns(messages, 125_000) == {1: 2_000_000, 2: 3_000_000, 3: 3_500_000}


def test_response_of_a_lone_message_is_its_own_length_and_jitter() -> None:
    times = response_times_ns([message(1, 10, length=8, jitter_ms=0.25)], 500_000)
    assert times == {1: 135 * 2_000 + 250_000}


def test_highest_priority_waits_for_the_longest_frame_below_it() -> None:
    times = response_times_ns([message(9, 10, 8), message(8, 10, 2), message(1, 10, 0)], 500_000)
    assert times[1] == (135 + 55) * 2_000


def test_lowest_priority_waits_for_one_of_each_above_it() -> None:
    messages = [message(can_id, 10, 8) for can_id in (1, 2, 3)]
    assert response_times_ns(messages, 500_000)[3] == 3 * 135 * 2_000


def test_jitter_above_delays_those_below() -> None:
    calm = response_times_ns([message(1, 1, 8), message(2, 10, 8), message(3, 9, 8)], 500_000)
    jittery = [message(1, 1, 8, jitter_ms=0.9), message(2, 10, 8), message(3, 9, 8)]
    # Jitter lets two instances of message 1 come one right after the other.
    assert response_times_ns(jittery, 500_000)[2] == calm[2] + 270_000


def test_extended_identifier_loses_to_the_standard_one_with_the_same_base() -> None:
    low = MessageTiming(can_id=0x100 << 18, length=0, period_ns=10**7, extended=True)
    times = response_times_ns([low, message(0x100, 10, 0)], 500_000)
    assert times[0x100] == (80 + 55) * 2_000
    assert times[0x100 << 18] == (55 + 80) * 2_000
    alone_above = response_times_ns([low, message(0x0FF, 10, 0), message(0x101, 10, 0)], 500_000)
    assert alone_above[0x101] == (55 + 80 + 55) * 2_000


def simulated_response_ns(messages: list[MessageTiming], target: MessageTiming) -> int:
    """Worst response of `target` on a simulated bus at 125 kbit/s, from the critical instant on.

    All of its priority and above are queued together as late as their jitter allows, then as early
    as they may, just after the longest frame below has started.
    """
    duration = {each.can_id: frame_bits_max(each.length) * 8_000 for each in messages}
    below = [duration[each.can_id] for each in messages if each.can_id > target.can_id]
    above = [each for each in messages if each.can_id <= target.can_id]
    sent = dict.fromkeys((each.can_id for each in above), 0)
    now_ns, worst_ns = max(below, default=1) - 1, 0
    while True:
        nominal = {
            each.can_id: sent[each.can_id] * each.period_ns - each.jitter_ns for each in above
        }
        waiting = [can_id for can_id, nominal_ns in nominal.items() if max(0, nominal_ns) <= now_ns]
        if not waiting:
            return worst_ns
        winner = min(waiting)
        now_ns += duration[winner]
        sent[winner] += 1
        if winner == target.can_id:
            worst_ns = max(worst_ns, now_ns - nominal[winner])


@DETERMINISTIC
@given(
    shapes=st.lists(
        st.tuples(st.integers(0, 8), st.integers(20, 120), st.integers(0, 150)),
        min_size=1,
        max_size=5,
    )
)
def test_no_simulated_response_exceeds_the_bound(
    shapes: list[tuple[int, int, int]],
) -> None:
    messages = [
        message(can_id, tenths / 10, length, jitter_ms=jitter / 10)
        for can_id, (length, tenths, jitter) in enumerate(shapes)
    ]
    if bus_load(messages, 125_000) >= 0.98:
        return
    bounds = response_times_ns(messages, 125_000)
    for each in messages:
        assert simulated_response_ns(messages, each) <= bounds[each.can_id]


def test_bus_load_adds_up_worst_case_lengths() -> None:
    assert bus_load([message(1, 10, 8), message(2, 20, 8)], 500_000) == pytest.approx(
        135 * 2e-6 * (100 + 50)
    )


def test_overloaded_bus_has_no_bound() -> None:
    with pytest.raises(ValueError, match="0x2"):
        response_times_ns([message(1, 2), message(2, 2)], 125_000)


def test_identifier_with_two_senders_is_refused() -> None:
    with pytest.raises(ValueError, match="0x7 appears twice"):
        response_times_ns([message(7, 10), message(7, 20)], 500_000)


@pytest.mark.parametrize(("period_ms", "jitter_ms"), [(0, 0), (-1, 0), (10, -1)])
def test_impossible_periods_and_jitters_are_refused(period_ms: float, jitter_ms: float) -> None:
    with pytest.raises(ValueError, match="period"):
        message(1, period_ms, jitter_ms=jitter_ms)
