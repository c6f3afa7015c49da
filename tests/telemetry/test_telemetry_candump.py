"""Logs of candump, line by line."""

from __future__ import annotations

from pathlib import Path

import pytest

from canbus.frame import Frame, FrameKind
from telemetry.candump import CandumpLog, LogError, parse_line


@pytest.mark.parametrize(
    ("text", "time_ns", "frame"),
    [
        ("(0000000001.000002) vcan0 184#0011", 1_000_002_000, Frame(0x184, b"\x00\x11")),
        ("(1.5) can0 001#", 1_500_000_000, Frame(1)),
        ("(1.0) can0 123#R", 1_000_000_000, Frame(0x123, b"", FrameKind.REMOTE)),
        ("(1.0) can0 123#R8 T", 1_000_000_000, Frame(0x123, b"", FrameKind.REMOTE)),
        ("(1.0) can0 00000123#AA R", 1_000_000_000, Frame(0x123, b"\xaa", FrameKind.EXTENDED)),
        ("(1.0) can0 123##1AABB", 1_000_000_000, Frame(0x123, b"\xaa\xbb", FrameKind.FD)),
        ("(1.0) can0 20000040#0000000000000000", 1_000_000_000,
         Frame(0x40, bytes(8), FrameKind.ERROR)),
    ],
)
def test_every_kind_of_frame_is_read(text: str, time_ns: int, frame: Frame) -> None:
    found = parse_line(text)
    assert found is not None
    assert (found[0], found[2]) == (time_ns, frame)


@pytest.mark.parametrize("text", ["", "vcan0 184#00", "(1.0) vcan0 184#001", "(x) vcan0 184#00"])
def test_what_is_no_frame_is_none(text: str) -> None:
    assert parse_line(text) is None


def test_lines_that_are_none_are_counted_and_the_first_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("# a comment\n(1.0) vcan0 184#00\n\n(2.0) vcan0 1\n(3.0) can1 185#00\n(4.")
    log = CandumpLog(path, "vcan0")
    assert [time_ns for time_ns, _ in log.read()] == [1_000_000_000]
    assert (log.lines, log.frames, log.unreadable) == (4, 1, 2)
    assert log.first_unreadable == (4, "(2.0) vcan0 1")


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"none\.log cannot be read: No such file"):
        list(CandumpLog(tmp_path / "none.log").read())
