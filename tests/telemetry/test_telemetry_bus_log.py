"""The compact log: what goes in comes out, and how busy the wire was."""

from __future__ import annotations

import pytest

from canbus.frame import Frame, FrameKind
from canbus.timing import frame_time_ns
from simulation.trace import candump_lines
from telemetry.bus_log import BusLog

MS = 1_000_000


def test_frames_come_out_as_they_went_in() -> None:
    log = BusLog()
    given = [
        (1, Frame(0x001)),
        (2, Frame(0x7FF, bytes(range(8)))),
        (3, Frame(0x123, b"\x01\x02\x03")),
        (3, Frame(0x1ABCDE01, b"\xff", FrameKind.EXTENDED)),
        (9, Frame(0x181, b"", FrameKind.REMOTE)),
    ]
    for time_ns, frame in given:
        log(time_ns, "anybody", frame)
    assert list(log.frames()) == given
    assert len(log) == 5 and log.end_s == pytest.approx(9e-9)


def test_fd_and_error_frames_are_counted_but_not_kept() -> None:
    log = BusLog()
    log.add(0, Frame(0x100, bytes(16), FrameKind.FD))
    log.add(0, Frame(0x100, bytes(8), FrameKind.ERROR))
    log.add(0, Frame(0x100, bytes(9)))
    assert len(log) == 0 and log.left_out == 3


def test_one_identifiers_frames_are_data_frames_alone() -> None:
    log = BusLog()
    log.add(1, Frame(0x182, b"\x01"))
    log.add(2, Frame(0x183, b"\x02"))
    log.add(3, Frame(0x182, b"", FrameKind.REMOTE))
    log.add(4, Frame(0x182, b"\x03"))
    assert [time_ns for time_ns, _ in log.frames_of(0x182)] == [1, 4]


def test_rows_name_the_sender_by_the_dbc() -> None:
    log = BusLog()
    log.add(1_500_000, Frame(0x182, bytes(8)))
    log.add(2_500_000, Frame(0x555, b"\xab"))
    assert [sender for _, sender, _ in log.rows()] == ["Steering", "stranger"]
    assert list(candump_lines(log.rows(), "vcan0")) == [
        "(0000000000.001500) vcan0 182#0000000000000000",
        "(0000000000.002500) vcan0 555#AB",
    ]


def test_load_is_the_frames_own_time_over_the_time_that_passed() -> None:
    log = BusLog()
    frame = Frame(0x182, bytes(8))
    for number in range(1001):  # every 1 ms for a second, twice as often in the second 100 ms
        log.add(number * MS, frame)
        if 100 <= number < 200:
            log.add(number * MS, frame)
    share = frame_time_ns(frame, 500_000) / MS
    load = log.load(500_000)
    assert load.max == pytest.approx(2 * share)
    assert load.mean == pytest.approx(1.1 * share, rel=2e-3)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_load_of_a_log_too_short_to_tell_is_zero(count: int) -> None:
    log = BusLog()
    for number in range(count):
        log.add(number * MS, Frame(0x182, bytes(8)))
    assert log.load(500_000).mean == log.load(500_000).max == 0.0


def test_end_of_an_empty_log_is_zero() -> None:
    assert BusLog().end_s == 0.0
