"""candump's text: columns and log lines, as can-utils writes them."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canbus.candump import columns, log_line, parse_log_line
from canbus.frame import Frame, FrameKind
from canbus.heard import (
    CLASSICAL,
    ERROR_FLAG,
    EXTENDED_FLAG,
    FD_BIT_RATE_SWITCH,
    REMOTE_FLAG,
    Heard,
)

LINES = {
    "(1436509052.249713) vcan0 123#1122334455667788": "123   [8]  11 22 33 44 55 66 77 88",
    "(1436509052.249713) vcan0 1F334455#11": "1F334455   [1]  11",
    "(1436509052.249713) can10 123#R": "123   [0]  remote request",
    "(1436509052.249713) can10 123#R8": "123   [8]  remote request",
    "(1436509052.249713) vcan0 123##1112233445566778899AABBCC":
        "123  [12]  11 22 33 44 55 66 77 88 99 AA BB CC",
    "(1436509052.249713) vcan0 20000004#0001000000000000":
        "20000004   [8]  00 01 00 00 00 00 00 00",
    "(1436509052.249713) vcan0 123#": "123   [0]  ",
}  # fmt: skip
"""As log2long of can-utils 2020.11 writes them, its indentation apart."""


@pytest.mark.parametrize(("line", "shown"), LINES.items())
def test_a_log_line_is_read_shown_and_written_as_it_was(line: str, shown: str) -> None:
    heard = parse_log_line(line)
    assert heard is not None
    assert columns(heard) == shown
    assert log_line(heard) == line


@pytest.mark.skipif(shutil.which("log2long") is None, reason="can-utils is not installed")
@pytest.mark.parametrize("line", [line for line in LINES if "#R8" not in line])
def test_columns_are_those_of_can_utils(line: str) -> None:
    done = subprocess.run(["log2long"], input=line + "\n", text=True, capture_output=True)
    theirs = done.stdout.partition("'")[0].replace("ERRORFRAME", "").split()[2:]
    heard = parse_log_line(line)
    assert heard is not None and columns(heard).split() == theirs


@pytest.mark.parametrize(
    "line",
    [
        "", "nonsense", "(1.5) vcan0", "(1.5) vcan0 12#11", "(1.5) vcan0 123#1",
        "(1.5) vcan0 123#112233445566778899", "(1.5) vcan0 123##", "(1.5) vcan0 123##G11",
        "(x.5) vcan0 123#11", "(1.5) vca\x1bn0 123#11", "(1.5) vcan0 123##0" + "11" * 65,
    ],
)  # fmt: skip
def test_other_text_is_no_frame(line: str) -> None:
    assert parse_log_line(line) is None


@pytest.mark.parametrize(
    "line", ["(1.5) can0 123#11.22 ", "  (1.500000000) can0 123#1122 R", "(1.5) can0 123#1122\r"]
)
def test_variants_that_can_utils_reads_are_read(line: str) -> None:
    assert parse_log_line(line) == Heard(1_500_000_000, "can0", 0x123, b"\x11\x22", 2)


@st.composite
def heard_frames(draw: st.DrawFn) -> Heard:
    is_extended = draw(st.booleans())
    word = draw(st.integers(0, 0x1FFF_FFFF if is_extended else 0x7FF))
    word |= EXTENDED_FLAG * is_extended
    time_ns = draw(st.integers(0, 2**60)) // 1000 * 1000
    kind = draw(st.sampled_from(["data", "remote", "fd", "error"]))
    data = draw(st.binary(max_size=64 if kind == "fd" else 8))
    if kind == "remote":
        return Heard(time_ns, "can0", word | REMOTE_FLAG, b"", draw(st.integers(0, 8)))
    if kind == "error":
        word = word & 0x1FFF_FFFF | ERROR_FLAG
    flags = draw(st.integers(0, 3)) if kind == "fd" else CLASSICAL
    return Heard(time_ns, "can0", word, data, len(data), flags)


@given(heard_frames())
def test_every_frame_survives_the_log(heard: Heard) -> None:
    assert parse_log_line(log_line(heard)) == heard


@pytest.mark.parametrize(
    ("heard", "frame"),
    [
        (Heard(0, "c", 0x123, b"\x01", 1), Frame(0x123, b"\x01")),
        (Heard(0, "c", 1 | EXTENDED_FLAG, b"\x01", 1), Frame(1, b"\x01", FrameKind.EXTENDED)),
        (Heard(0, "c", 0x123 | REMOTE_FLAG, b"", 8), Frame(0x123, b"", FrameKind.REMOTE)),
        (Heard(0, "c", 0x40 | ERROR_FLAG, bytes(8), 8), Frame(0x40, bytes(8), FrameKind.ERROR)),
        (
            Heard(0, "c", 0x123, bytes(12), 12, FD_BIT_RATE_SWITCH),
            Frame(0x123, bytes(12), FrameKind.FD),
        ),
        (
            Heard(0, "c", 0x123 | EXTENDED_FLAG | REMOTE_FLAG, b"", 8),
            Frame(0x123, b"", FrameKind.EXTENDED),
        ),
    ],
)  # fmt: skip
def test_nodes_know_the_same_frame(heard: Heard, frame: Frame) -> None:
    assert heard.frame() == frame
