"""What is told of foreign frames: something of each identifier, and never a flood."""

from __future__ import annotations

from canbus.frame import Frame, FrameKind, ReceivedFrame
from dbc.strangers import INTERVAL_NS, StrangerLog

MS = 1_000_000


def received(*frames: Frame) -> list[ReceivedFrame]:
    return [ReceivedFrame(0, frame) for frame in frames]


def test_each_kind_and_identifier_is_told_of_at_once() -> None:
    frames = [
        Frame(0x400, b"\x01"), Frame(0x401), Frame(0x400, b"", FrameKind.REMOTE),
        Frame(0x400, b"", FrameKind.EXTENDED),
    ]
    assert StrangerLog().lines(5 * MS, received(*frames)) == [
        "400#01 (data)", "401# (data)", "400#R (remote)", "00000400# (extended)",
    ]


def test_a_flood_is_one_line_a_second_and_its_frames_are_counted() -> None:
    log = StrangerLog()
    lines = [
        log.lines(step * 10 * MS, received(*[Frame(0x455)] * 27))
        for step in range(3 * INTERVAL_NS // (10 * MS))
    ]
    told = [(step, line) for step, some in enumerate(lines) for line in some]
    assert told == [
        (0, "455# (data)"), (100, "455# (data), after 2699 more"),
        (200, "455# (data), after 2699 more"),
    ]


def test_a_rare_stranger_is_always_told_of() -> None:
    log = StrangerLog()
    for second in range(5):
        assert log.lines(second * INTERVAL_NS, received(Frame(0x455))) == ["455# (data)"]
        assert log.lines(second * INTERVAL_NS + 1, []) == []
