"""Logs of several formats, whole and broken, come out as the frames that they hold."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import numpy as np
import pytest
from can import Message
from can.io import ASCWriter, BLFWriter

from telemetry.logs.frames import FrameFlag, LogFrame
from telemetry.logs.reading import Log, LogError, LogStream

S, US = 1_000_000_000, 1000
NONE = FrameFlag(0)
LINES = {
    "(1700000000.000001) vcan0 181#0011223344556677":
        LogFrame(17 * 10**8 * S + US, "vcan0", 0x181, NONE, 8, bytes(range(0, 0x88, 0x11))),
    "(0000000001.500000) vcan0 001#": LogFrame(S + S // 2, "vcan0", 1, NONE, 0, b""),
    "(0000000001.500000) can1 1ABCDE01#FF":
        LogFrame(S + S // 2, "can1", 0x1ABCDE01, FrameFlag.EXTENDED, 1, b"\xff"),
    "(0000000002.000000) can1 181#R8": LogFrame(2 * S, "can1", 0x181, FrameFlag.REMOTE, 8, b""),
    "(0000000002.000000) can1 20000080#0000000000000000":
        LogFrame(2 * S, "can1", 0x80, FrameFlag.ERROR, 8, bytes(8)),
    "(0000000002.000000) can1 123##1" + "AB" * 12:
        LogFrame(2 * S, "can1", 0x123, FrameFlag.FD | FrameFlag.BITRATE_SWITCH, 12, b"\xab" * 12),
    "(0000000002.000000) can1 123#ab T":
        LogFrame(2 * S, "can1", 0x123, FrameFlag.SENT, 1, b"\xab"),
    " (1.000002)  vcan0  181   [3]  00 11 22":
        LogFrame(S + 2 * US, "vcan0", 0x181, NONE, 3, b"\x00\x11\x22"),
    "  vcan0  181   [0]  remote request":
        LogFrame(0, "vcan0", 0x181, FrameFlag.REMOTE, 0, b""),
}  # fmt: skip


def written(folder: Path, text: str | bytes, name: str = "drive.log") -> Log:
    file = folder / name
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return Log(file)


@pytest.mark.parametrize("line", list(LINES))
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_each_form_of_a_line_gives_its_frame(line: str, end: str, tmp_path: Path) -> None:
    log = written(tmp_path, line + end)
    assert list(log.frames()) == [LINES[line]]
    assert log.problems.lines() == []


def test_mixed_lines_keep_their_order_and_their_places(tmp_path: Path) -> None:
    lines = list(LINES) * 7
    log = written(tmp_path, "".join(f"{line}\n" for line in lines))
    columns = log.columns()
    assert list(columns.frames()) == [LINES[line] for line in lines]
    assert columns.place.tolist() == list(range(1, len(lines) + 1))
    assert list(columns.channels) == sorted(columns.channels, reverse=True) == ["vcan0", "can1"]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("hello world", "no frame of candump"),
        ("(1.000000) vcan0 181#001", "half a byte at the end: cut off?"),
        ("(1.000000) vcan0 181#00112233445566778899", "too many bytes for a frame"),
        ("(1.000000) vcan0 FFF#00", "the identifier is above 7FF"),
        ("(1.000000) vcan0 9FFFFFFF#00", "the identifier is above 1FFFFFFF"),
        ("(1.000000) vcan0 18#00", "an identifier of 3 or 8 digits"),
        ("(1.000000) vcan0 181##000112233445566778899", "no length of a CAN FD frame"),
        ("(1.x00000) vcan0 181#00", "no frame of candump"),
        ("(1.000000) vcan0 181#0G", "an identifier of 3 or 8 digits and hexadecimal data"),
        ("vcan0  181   [3]  00 11", "fewer bytes than the line says"),
        ("\0\1\2", "no text"),
    ],
)
def test_line_without_a_frame_is_told_and_the_rest_is_read(
    line: str, reason: str, tmp_path: Path
) -> None:
    good = "(0000000001.500000) vcan0 001#"
    log = written(tmp_path, f"{good}\n{line}\n{good}\n")
    assert [frame.can_id for frame in log.frames()] == [1, 1]
    (told,) = log.problems.lines()
    assert told.startswith("1 line not read: ") and reason in told and "line 2" in told


def test_shapes_do_not_let_a_bad_line_pass_as_its_neighbours(tmp_path: Path) -> None:
    good = "(0000000001.500000) vcan0 181#0011"
    bad = [good.replace("#0011", "#00x1"), good.replace("1.5", "1:5"), good.replace("181", "G81")]
    log = written(tmp_path, "\n".join([good, *bad, good]) + "\n")
    assert log.columns().place.tolist() == [1, 5]
    assert log.problems.count == 3


def test_many_bad_lines_are_counted_and_the_first_are_named(tmp_path: Path) -> None:
    log = written(tmp_path, "nonsense\n" * 1000)
    assert len(log.columns()) == 0
    assert log.problems.lines() == [
        "1000 lines not read: no frame of candump: line 1 'nonsense', line 2 'nonsense', "
        "line 3 'nonsense' and 997 more"
    ]


def test_last_line_without_an_end_is_read_and_told(tmp_path: Path) -> None:
    log = written(tmp_path, "(0000000001.500000) vcan0 181#00\n(0000000001.500000) vcan0 181#0")
    assert len(log.columns()) == 1
    assert any("line 2, the last, has no end" in text for text in log.problems.lines())


def test_log_longer_than_a_chunk_loses_no_line(tmp_path: Path) -> None:
    lines = [f"({n:010d}.000000) vcan0 {n % 0x800:03X}#{n:08X}" for n in range(60_000)]
    columns = written(tmp_path, "\n".join(lines) + "\n").columns()
    assert (columns.time_ns == np.arange(60_000) * S).all()
    assert (columns.data[:, :4].copy().view(">u4")[:, 0] == np.arange(60_000)).all()
    assert (columns.place == np.arange(1, 60_001)).all()


def test_log_without_ends_of_lines_does_not_fill_the_memory(tmp_path: Path) -> None:
    log = written(tmp_path, b"x" * 3_000_000)
    assert len(log.columns()) == 0
    assert "far too long" in log.problems.lines()[0]


def test_empty_log_has_no_frames_and_no_problems(tmp_path: Path) -> None:
    log = written(tmp_path, "")
    assert len(log.columns()) == 0 and log.problems.lines() == []


def test_compressed_log_is_read_and_a_cut_one_as_far_as_it_goes(tmp_path: Path) -> None:
    lines = [f"({n:010d}.{n:06d}) vcan0 181#{n * n % 2**32:08X}\n" for n in range(50_000)]
    packed = gzip.compress("".join(lines).encode())
    assert len(written(tmp_path, packed, "a.log.gz").columns()) == 50_000
    log = written(tmp_path, packed[: len(packed) // 2], "b.log.gz")
    assert len(log.columns()) < 50_000
    assert any("ends early or is damaged" in text for text in log.problems.lines())


MESSAGES = [
    Message(timestamp=1e9 + 0.25, arbitration_id=0x181, data=b"\1\2", is_extended_id=False,
            channel=0),
    Message(timestamp=1e9 + 0.5, arbitration_id=0x1ABCDE01, data=b"\3", channel=1, is_rx=False),
    Message(timestamp=1e9 + 0.75, arbitration_id=0x182, is_remote_frame=True, dlc=4,
            is_extended_id=False, channel=0),
]  # fmt: skip


@pytest.mark.parametrize(("writer", "name"), [(ASCWriter, "a.asc"), (BLFWriter, "a.blf")])
def test_asc_and_blf_give_the_frames_written(
    writer: type[ASCWriter] | type[BLFWriter], name: str, tmp_path: Path
) -> None:
    with writer(tmp_path / name) as out:
        for message in MESSAGES:
            out.on_message_received(message)
    frames = list(Log(tmp_path / name).frames())
    assert [(f.channel, f.can_id, f.flags, f.length, f.data) for f in frames] == [
        ("0", 0x181, NONE, 2, b"\1\2"),
        ("1", 0x1ABCDE01, FrameFlag.EXTENDED | FrameFlag.SENT, 1, b"\3"),
        ("0", 0x182, FrameFlag.REMOTE, 4, b""),
    ]
    assert frames[2].time_ns - frames[0].time_ns == S // 2


def test_broken_blf_ends_where_it_breaks_and_says_so(tmp_path: Path) -> None:
    with BLFWriter(tmp_path / "a.blf") as out:
        for message in MESSAGES:
            out.on_message_received(message)
    content = (tmp_path / "a.blf").read_bytes()
    log = written(tmp_path, content[: len(content) - 20] + b"?" * 30, "b.blf")
    list(log.frames())
    assert any("reading ends here" in text for text in log.problems.lines())


@pytest.mark.parametrize(
    ("start", "said"),
    [(b"SQLite format 3\0", "SQLite"), (b"PK\3\4", "a ZIP")],
)
def test_foreign_format_is_refused_by_its_name(start: bytes, said: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be read here: candump"):
        written(tmp_path, start)
    with pytest.raises(LogError) as error:
        written(tmp_path, start)
    assert said in str(error.value)


def test_missing_file_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be read: No such file or directory"):
        Log(tmp_path / "nothing.log")


def test_pipe_gives_what_has_come_before_it_ends() -> None:
    reading, writing = os.pipe()
    chunks = LogStream(reading).chunks()
    os.write(writing, b"(0000000001.500000) vcan0 001#\n(00000")
    assert len(next(chunks)) == 1
    os.close(writing)
    list(chunks)
    os.close(reading)
