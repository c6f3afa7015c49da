"""Who may send, in which order, and when it is heard: worked by hand from ISO 11898-1."""

from __future__ import annotations

import pytest

from canbus.frame import Frame, FrameKind
from canbus.timing import frame_time_ns
from simulation.controller import ControllerSettings, MailboxOrder
from tests.simulation.wire_bench import BITRATE_BPS, SPACE_NS, Bench, end_ns

LONG = Frame(0x100, bytes(8))
FIFO = ControllerSettings(order=MailboxOrder.FIFO)


def test_a_frame_is_heard_by_all_others_at_its_end_of_frame() -> None:
    bench = Bench()
    bench.send("A", LONG)
    bench.run()
    # 19 + 64 + 15 bits and their 18 stuff bits, 10 bits of tail; the 3 bits of space come after
    at_ns = end_ns(0, LONG)
    assert bench.ears["B"].inbox == bench.ears["C"].inbox == [(at_ns, LONG)]
    assert bench.heard("A") == []


def test_the_length_is_exact() -> None:
    """All zeros: 34 bits of header and CRC, a stuff bit after every fifth, 10 bits of tail."""
    bench = Bench()
    bench.send("A", Frame(0x000))
    bench.run()
    assert bench.said[0][0] == (34 + 6 + 10) * 2_000


def test_the_next_frame_begins_after_three_bits_of_space() -> None:
    bench = Bench()
    bench.send("A", LONG, LONG)
    bench.run()
    assert bench.said[1][0] - bench.said[0][0] == frame_time_ns(LONG, BITRATE_BPS)


def test_a_frame_sent_during_the_space_takes_part_in_the_next_arbitration() -> None:
    bench = Bench()
    bench.send("A", LONG, Frame(0x200))
    bench.kernel.at(end_ns(0, LONG) + SPACE_NS - 1, 0, lambda ns: bench.send("B", Frame(0x150)))
    bench.run()
    assert bench.order() == [("A", 0x100), ("B", 0x150), ("A", 0x200)]


def test_lowest_identifier_wins_and_nobody_is_interrupted() -> None:
    bench = Bench()
    bench.send("A", Frame(0x300, bytes(8)))
    bench.run(10_000)  # under way
    bench.send("B", Frame(0x200))
    bench.send("C", Frame(0x001))
    bench.run()
    assert bench.order() == [("A", 0x300), ("C", 0x001), ("B", 0x200)]


def test_data_goes_before_remote_and_both_before_extended() -> None:
    bench = Bench("ABCD")
    bench.send("D", Frame(0x000))  # the others wait behind it
    bench.send("A", Frame(0x100 << 18, b"", FrameKind.EXTENDED))
    bench.send("B", Frame(0x100, b"", FrameKind.REMOTE))
    bench.send("C", Frame(0x100))
    bench.run()
    assert [sender for sender, _ in bench.order()] == ["D", "C", "B", "A"]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [(ControllerSettings(), [0x300, 0x100, 0x200]), (FIFO, [0x300, 0x200, 0x100])],
)
def test_order_of_the_mailboxes_is_the_controllers(
    settings: ControllerSettings, expected: list[int]
) -> None:
    bench = Bench(A=settings)
    bench.send("A", Frame(0x300))
    bench.send("A", Frame(0x200), Frame(0x100))
    bench.run()
    assert [can_id for _, can_id in bench.order()] == expected


def test_a_fifo_lets_an_urgent_frame_of_another_node_overtake() -> None:
    """Priority inversion: its own urgent frame waits behind the one that loses."""
    bench = Bench(A=FIFO)
    bench.send("C", Frame(0x400))
    bench.send("A", Frame(0x300), Frame(0x010))
    bench.send("B", Frame(0x200))
    bench.run()
    assert bench.order() == [("C", 0x400), ("B", 0x200), ("A", 0x300), ("A", 0x010)]


def test_a_full_queue_refuses_and_counts() -> None:
    bench = Bench(A=ControllerSettings(depth=2))
    bench.send("A", Frame(0x100), Frame(0x101), Frame(0x102))
    bench.run()
    assert bench.order() == [("A", 0x100), ("A", 0x101)]
    assert bench.wire.controllers["A"].refused == 1
    bench.send("A", Frame(0x103))
    bench.run()
    assert bench.order()[-1] == ("A", 0x103)


def test_acceptance_filters_are_the_receivers() -> None:
    bench = Bench()
    bench.ears["B"].wanted = frozenset({0x101})
    bench.send("A", Frame(0x100), Frame(0x101))
    bench.run()
    assert bench.heard("B") == [Frame(0x101)]
    assert bench.heard("C") == [Frame(0x100), Frame(0x101)]


def test_a_filter_loses_a_frame_for_one_receiver_alone() -> None:
    bench = Bench()
    bench.wire.filters.append(lambda ns, sender, frame, receiver: receiver != "B")
    bench.send("A", LONG)
    bench.run()
    assert bench.heard("B") == [] and bench.heard("C") == [LONG]


def test_load_is_the_share_of_time_with_frames_and_spaces() -> None:
    bench = Bench()
    for _ in range(100):
        bench.send("A", LONG)
        bench.run(2 * frame_time_ns(LONG, BITRATE_BPS))
    assert bench.wire.load_mean(bench.kernel.now_ns) == pytest.approx(0.5)
    bench.run(200_000_000)
    bench.send("A", LONG)
    assert bench.wire.load_max == pytest.approx(
        100 * frame_time_ns(LONG, BITRATE_BPS) / 100_000_000, abs=0.01
    )


def test_settings_that_no_controller_can_have_are_refused() -> None:
    with pytest.raises(ValueError, match="depth 0: at least 1"):
        ControllerSettings(depth=0)
    with pytest.raises(ValueError, match="restart_ns -1: at least 0"):
        ControllerSettings(restart_ns=-1)
