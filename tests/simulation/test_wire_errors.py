"""Error frames, retransmission, error counters, bus-off and the way back (ISO 11898-1)."""

from __future__ import annotations

import pytest

from canbus.bitstream import DOMINANT, frame_stream
from canbus.frame import Frame, FrameKind
from simulation.controller import ControllerSettings, ErrorState, MailboxOrder
from simulation.disturbance import (
    Disturbance,
    collided,
    disturbed,
    foreign_format,
    found_by,
    not_acknowledged,
)
from simulation.wire import BUS_OFF_FRAME
from tests.simulation.wire_bench import BIT_NS, SPACE_NS, Bench, bits_ns, end_ns

FRAME = Frame(0x155, b"\x55\x55")
"""Alternating bits: no stuffing, so that positions can be counted by hand."""
NEVER = ControllerSettings(restart_ns=None)
AT_ONCE = ControllerSettings(restart_ns=0)


def until_bus_off(bench: Bench, name: str = "A", *frames: Frame) -> int:
    """Disturbs all that begins until a station has left; answers how many frames that took."""
    before = bench.wire.error_frames
    bench.disturb(*[Disturbance(bit=20)] * 100)
    bench.send(name, *(frames or (FRAME,)))
    deadline_ns = bench.kernel.now_ns + bits_ns(10_000)
    while bench.wire.controllers[name].is_on_bus:
        assert bench.kernel.now_ns < deadline_ns
        bench.run(BIT_NS)
    bench.noise.clear()
    return bench.wire.error_frames - before


# How long ----------------------------------------------------------------------------------------


def test_an_error_frame_is_flag_echo_and_delimiter() -> None:
    """Bit 14 is the first of the length code, dominant; seen recessive, no dominant bit stands
    before the flag: the others see a stuff error at its sixth bit, and send theirs: 12 and 8."""
    assert frame_stream(FRAME)[14] == DOMINANT
    assert disturbed(FRAME, 14).bits == 14 + 1 + 12 + 8


def test_dominant_bits_before_the_flag_shorten_it() -> None:
    """Bits 12 and 13, RTR and IDE, are dominant, bit 15 is sent dominant as well; bit 11 is the
    last of the identifier, recessive: seen dominant it is one dominant bit before the flag."""
    stream = frame_stream(FRAME)
    assert stream[10:12] == [0, 1]
    assert disturbed(FRAME, 11).bits == 11 + 1 + (6 - 2) + 6 + 8


def test_a_receivers_flag_is_answered_at_the_senders_next_recessive_bit() -> None:
    stream = frame_stream(FRAME)
    assert stream[20:22] == [1, 0] or stream[20:22] == [0, 1]
    answer = stream.index(1, 21)
    assert found_by("B", FRAME, 20).bits == answer + 1 + 6 + 8


def test_nobody_acknowledges_and_the_flag_stands_alone() -> None:
    length = len(frame_stream(FRAME))
    assert not_acknowledged(FRAME).bits == length - 9 + 1 + 6 + 8


def test_frames_collide_where_they_first_differ() -> None:
    a, b = Frame(0x155, b"\x55\x55"), Frame(0x155, b"\x55\x54")
    error = collided([a, b])
    last_data_bit = 19 + 16 - 1 + sum_of_stuff_before(a, 19 + 15)
    answer = frame_stream(b).index(1, last_data_bit + 1)
    assert error is not None and error.bits == answer + 1 + 6 + 8
    assert collided([a, a]) is None


def sum_of_stuff_before(frame: Frame, count: int) -> int:
    """Stuff bits that the first `count` bits of a frame cause, counted by walking."""
    stuff = run = 0
    last = -1
    seen = 0
    for bit in frame_stream(frame):
        if run == 5:
            stuff, run, last = stuff + 1, 1, bit
            continue
        if seen == count:
            break
        seen += 1
        run = run + 1 if bit == last else 1
        last = bit
    return stuff


# Retransmission and counters ---------------------------------------------------------------------


def test_a_disturbed_frame_is_sent_again_after_the_error_frame() -> None:
    bench = Bench()
    bench.disturb(Disturbance(bit=14))
    bench.send("A", FRAME)
    bench.run()
    again_ns = bits_ns(disturbed(FRAME, 14).bits) + SPACE_NS
    assert bench.ears["B"].inbox == [(end_ns(again_ns, FRAME), FRAME)]
    assert (bench.wire.frames, bench.wire.error_frames) == (1, 1)


def test_a_more_urgent_frame_goes_before_the_retransmission() -> None:
    bench = Bench()
    bench.disturb(Disturbance(bit=14))
    bench.send("A", FRAME)
    bench.run(10_000)
    bench.send("B", Frame(0x001))
    bench.run()
    assert bench.order() == [("B", 0x001), ("A", 0x155)]


def test_an_error_costs_the_sender_eight_and_the_others_one_and_success_gives_one_back() -> None:
    bench = Bench()
    bench.disturb(Disturbance(bit=14))
    bench.send("A", FRAME)
    bench.run(bits_ns(40))
    assert [bench.counters(name) for name in "ABC"] == [(8, 0), (0, 1), (0, 1)]
    bench.run()
    assert [bench.counters(name) for name in "ABC"] == [(7, 0), (0, 0), (0, 0)]


def test_the_receiver_that_alone_saw_an_error_pays_nine() -> None:
    bench = Bench()
    bench.disturb(Disturbance(bit=14, receiver="B"))
    bench.send("A", FRAME)
    bench.run(bits_ns(40))
    assert [bench.counters(name) for name in "ABC"] == [(8, 0), (0, 9), (0, 1)]
    bench.run()
    assert bench.heard("B") == [FRAME]  # nobody has lost anything


def test_at_128_a_sender_is_error_passive_and_waits_eight_more_bits() -> None:
    bench = Bench()
    bench.disturb(*[Disturbance(bit=14)] * 16)
    bench.send("A", FRAME)
    bench.run(16 * (bits_ns(disturbed(FRAME, 14).bits) + SPACE_NS) - BIT_NS)
    assert bench.counters("A") == (128, 0)
    assert bench.state("A") is ErrorState.PASSIVE
    bench.send("B", Frame(0x7F0))  # the lowest priority of all
    bench.run()
    assert bench.order() == [("B", 0x7F0), ("A", 0x155)]
    assert bench.state("A") is ErrorState.ACTIVE  # 127 again


def test_frames_sent_while_a_passive_sender_waits_wait_with_it() -> None:
    bench = Bench()
    bench.disturb(*[Disturbance(bit=14)] * 16)
    bench.send("A", FRAME)
    bench.run(16 * (bits_ns(disturbed(FRAME, 14).bits) + SPACE_NS) - BIT_NS)
    bench.send("A", Frame(0x002))
    bench.send("B", Frame(0x7F0))
    bench.run()
    assert bench.order() == [("B", 0x7F0), ("A", 0x002), ("A", 0x155)]


def test_an_error_passive_receiver_loses_a_frame_alone() -> None:
    bench = Bench()
    bench.wire.controllers["B"].receive_errors = 130
    bench.wire.controllers["B"].state = ErrorState.PASSIVE
    bench.disturb(Disturbance(bit=14, receiver="B"), None)
    bench.send("A", FRAME, Frame(0x200))
    bench.run()
    assert bench.heard("C") == [FRAME, Frame(0x200)]
    assert bench.heard("B") == [Frame(0x200)]
    assert bench.wire.error_frames == 0
    assert bench.counters("B") == (0, 126)  # success leaves 127 of what was above, then 126


def test_noise_at_ones_own_or_an_absent_controller_changes_nothing() -> None:
    bench = Bench(C=NEVER)
    until_bus_off(bench, "C", Frame(0x300))
    errors = bench.wire.error_frames
    bench.disturb(Disturbance(bit=14, receiver="A"), Disturbance(bit=14, receiver="C"))
    bench.send("A", FRAME, FRAME)
    bench.run()
    assert bench.heard("B")[-2:] == [FRAME, FRAME]
    assert bench.wire.error_frames == errors


# Bus-off -----------------------------------------------------------------------------------------


def test_after_32_errors_in_a_row_a_sender_is_off_the_bus_and_its_program_is_told() -> None:
    bench = Bench(A=NEVER)
    assert until_bus_off(bench) == 32
    assert bench.heard("A") == [BUS_OFF_FRAME]
    assert bench.order() == []
    bench.send("A", FRAME)
    bench.send("B", Frame(0x200))
    bench.run(1_000_000_000)
    assert bench.order() == [("B", 0x200)]  # not heard by A, nor anything sent by it
    assert bench.heard("A") == [BUS_OFF_FRAME] and bench.heard("C") == [Frame(0x200)]


def test_what_waited_is_flushed_at_bus_off_and_never_leaves_late() -> None:
    bench = Bench(A=ControllerSettings(order=MailboxOrder.FIFO, restart_ns=0))
    until_bus_off(bench, "A", FRAME, Frame(0x201), Frame(0x202))
    bench.run(1_000_000_000)
    assert bench.order() == []
    bench.send("A", Frame(0x203))
    bench.run()
    assert bench.order() == [("A", 0x203)]


def test_recovery_takes_128_times_11_recessive_bits_of_an_idle_bus() -> None:
    bench = Bench(A=AT_ONCE)
    until_bus_off(bench)
    off_ns = bench.ears["A"].inbox[0][0]
    idle_ns = off_ns + SPACE_NS
    bench.kernel.run_until(idle_ns + bits_ns(128 * 11) - 1)
    assert not bench.wire.controllers["A"].is_on_bus
    bench.kernel.run_until(idle_ns + bits_ns(128 * 11))
    assert bench.wire.controllers["A"].is_on_bus
    assert bench.counters("A") == (0, 0)


def test_traffic_delays_recovery_by_all_but_the_ends_of_its_frames() -> None:
    bench = Bench(A=AT_ONCE)
    until_bus_off(bench)
    idle_ns = bench.ears["A"].inbox[0][0] + SPACE_NS
    bench.kernel.run_until(idle_ns)
    bench.send("B", FRAME)
    bench.run(0)
    end = end_ns(idle_ns, FRAME) + SPACE_NS
    back_ns = end + bits_ns(127 * 11)  # the frame's end counted as one of them
    bench.kernel.run_until(back_ns - 1)
    assert not bench.wire.controllers["A"].is_on_bus
    bench.kernel.run_until(back_ns)
    assert bench.wire.controllers["A"].is_on_bus


def test_restart_after_bus_off_waits_as_long_as_the_settings_say() -> None:
    bench = Bench(A=ControllerSettings(restart_ns=50_000_000))
    until_bus_off(bench)
    off_ns = bench.ears["A"].inbox[0][0]
    bench.kernel.run_until(off_ns + 50_000_000 + bits_ns(128 * 11) - 1)
    assert not bench.wire.controllers["A"].is_on_bus
    bench.run(1)
    assert bench.wire.controllers["A"].is_on_bus


# Twins, silence and other formats ----------------------------------------------------------------


def test_the_same_frame_sent_by_two_at_once_is_one_frame() -> None:
    """Why FAILSAFE has no data: whoever sends it, it never collides."""
    bench = Bench()
    bench.send("C", Frame(0x7FF))
    bench.send("A", Frame(0x001))
    bench.send("B", Frame(0x001))
    bench.run()
    assert bench.order() == [("C", 0x7FF), ("A", 0x001)]
    assert bench.heard("C") == [Frame(0x001)]
    assert Frame(0x001) not in bench.heard("A") + bench.heard("B")


def test_two_senders_of_one_identifier_drive_each_other_off_the_bus() -> None:
    """Why every identifier has one sender (design, identifiers)."""
    bench = Bench(A=NEVER, B=NEVER)
    bench.send("C", Frame(0x7FF))
    bench.send("A", Frame(0x181, b"\x01"))
    bench.send("B", Frame(0x181, b"\x02"))
    bench.run(100_000_000)
    states = [bench.state(name) for name in "ABC"]
    assert states == [ErrorState.BUS_OFF, ErrorState.BUS_OFF, ErrorState.ACTIVE]
    assert bench.order() == [("C", 0x7FF)]


def test_ones_own_second_frame_is_no_twin() -> None:
    bench = Bench()
    bench.send("A", Frame(0x181, b"\x01"), Frame(0x181, b"\x02"))
    bench.run()
    assert bench.order() == [("A", 0x181), ("A", 0x181)]
    assert bench.wire.error_frames == 0


def test_alone_on_the_bus_a_sender_repeats_but_never_counts_itself_off() -> None:
    bench = Bench("A")
    bench.send("A", FRAME)
    bench.run(100_000_000)
    assert bench.counters("A") == (128, 0)
    assert bench.state("A") is ErrorState.PASSIVE
    assert bench.order() == []
    bench.wire.send(bench.kernel.now_ns, "stranger", [Frame(0x7FF)])  # somebody comes
    bench.run()
    assert ("A", 0x155) in bench.order()


def test_an_fd_frame_is_refused_by_classical_controllers_until_its_sender_is_off() -> None:
    bench = Bench()
    bench.wire.send(0, "stranger", [Frame(0x123, bytes(12), FrameKind.FD)])
    bench.run(bits_ns(foreign_format().bits))
    assert bench.counters("stranger") == (8, 0)
    bench.run(1_000_000_000)
    assert bench.order() == []
    assert bench.wire.error_frames == 32


@pytest.mark.parametrize("bit", [0, 1, 19, 33, 44, 50, 1_000])
def test_wherever_noise_strikes_the_frame_goes_through_in_the_end(bit: int) -> None:
    bench = Bench()
    for receiver in (None, "B"):
        bench.disturb(Disturbance(bit=bit, receiver=receiver))
        bench.send("A", FRAME)
        bench.run()
    assert bench.heard("B") == bench.heard("C") == [FRAME, FRAME]
    assert bench.wire.error_frames == 2


# Power and other violence ------------------------------------------------------------------------


def test_a_controller_that_is_switched_off_sends_hears_and_acknowledges_nothing() -> None:
    bench = Bench("AB")
    bench.wire.switch_off("B")
    bench.send("A", FRAME)
    bench.send("B", Frame(0x200))
    bench.run(100_000_000)
    assert bench.order() == [] and bench.heard("B") == []
    assert bench.state("A") is ErrorState.PASSIVE  # nobody acknowledges
    bench.wire.switch_on("B")
    bench.run()
    assert bench.order() == [("A", 0x155)]  # what B wanted to send before is gone
    assert bench.heard("B") == [FRAME]


def test_a_frame_whose_sender_loses_its_power_on_the_way_is_an_error_for_the_others() -> None:
    bench = Bench()
    bench.send("A", FRAME, FRAME)
    bench.run(10_000)
    bench.wire.switch_off("A")
    bench.run()
    assert bench.order() == [] and bench.heard("B") == []
    assert bench.counters("B") == (0, 1)
    bench.send("B", Frame(0x200))
    bench.run()
    assert bench.heard("C") == [Frame(0x200)]


def test_what_waited_in_the_space_between_frames_goes_with_its_senders_power() -> None:
    bench = Bench()
    bench.send("B", FRAME)
    bench.send("A", Frame(0x200))
    bench.kernel.run_until(end_ns(0, FRAME) + 1)
    bench.wire.switch_off("A")
    bench.run()
    assert bench.order() == [("B", 0x155)]
    bench.send("B", FRAME)
    bench.run()
    assert bench.order() == [("B", 0x155), ("B", 0x155)]


def test_driving_a_controller_off_is_like_many_errors_and_happens_once() -> None:
    bench = Bench(A=AT_ONCE)
    bench.send("A", FRAME, FRAME)
    bench.wire.drive_off(0, "A")
    bench.wire.drive_off(0, "A")
    assert bench.heard("A") == [BUS_OFF_FRAME]
    bench.run(100_000_000)
    assert bench.state("A") is ErrorState.ACTIVE
    assert bench.order() == []


def test_power_during_the_way_back_from_bus_off_makes_it_short_and_single() -> None:
    bench = Bench(A=ControllerSettings(restart_ns=1_000_000))
    bench.wire.drive_off(0, "A")
    bench.wire.switch_on("A")
    assert bench.state("A") is ErrorState.ACTIVE
    bench.wire.drive_off(bench.kernel.now_ns, "A")
    bench.run(900_000)
    bench.wire.switch_off("A")
    bench.run(1_000_000_000)
    assert bench.state("A") is ErrorState.BUS_OFF  # without power nothing comes back
