"""Logs of `candump -L` read with numpy: lines of one shape are taken apart together.

A line of an ordinary shape has its time, channel, identifier and data at the columns where the
first of its shape has them. Whatever differs goes through `candump_line`, one by one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from canbus.heard import ERROR_FLAG, EXTENDED_ID_MAX
from telemetry.logs.candump_line import (
    FD_LENGTHS,
    LineError,
    fd_flags,
    parse_line,
)
from telemetry.logs.frames import (
    CLASSIC_BYTES,
    FD_BYTES,
    ChannelNames,
    FrameColumns,
    FrameFlag,
)
from telemetry.logs.problems import Problems

CHUNK_BYTES: Final = 1 << 20
LINE_BYTES_MAX: Final = 1000
"""No line of candump is longer: a log without ends of lines is none."""

SHAPES_MAX: Final = 40
"""Shapes tried on lines of one length before the rest is read one by one."""

_SHAPE: Final = re.compile(
    rb"\((?P<s>\d{1,11})\.(?P<us>\d{6})\) (?P<channel>[^ #]+) "
    rb"(?P<id>[0-9A-F]{8}|[0-9A-F]{3})#(?P<fd>#[0-9A-F])?(?P<data>[0-9A-F]*)(?P<dir> [RT])?"
)
_HEX: Final = np.full(256, 255, np.uint8)
_HEX[np.frombuffer(b"0123456789ABCDEF", np.uint8)] = np.arange(16)
_HEX[np.frombuffer(b"abcdef", np.uint8)] = np.arange(10, 16)
_BAD_BYTE: Final = 0xFFFF


def _byte_of_pair() -> NDArray[np.uint16]:
    """The byte that two hexadecimal digits stand for, by both as a little-endian word."""
    low_half, high_half = np.meshgrid(_HEX, _HEX)  # the second digit lies in the high half
    table = low_half.astype(np.uint16) << 4 | high_half
    table[(low_half == 255) | (high_half == 255)] = _BAD_BYTE
    return table.reshape(-1).astype(np.uint16)


_BYTE: Final = _byte_of_pair()

Bytes = NDArray[np.uint8]


def read_candump(
    read: Callable[[int], bytes], channels: ChannelNames, problems: Problems
) -> Iterator[FrameColumns]:
    """Frames of a candump log, a chunk at a time.

    Args:
        read: Reads up to so many bytes, and none at the end.
        channels: Names of channels, filled as they come.
        problems: Takes lines that hold no frame.
    """
    rest = b""
    line = 1
    while block := read(CHUNK_BYTES):
        text = rest + block
        cut = text.rfind(b"\n") + 1
        rest = text[cut:]
        if len(rest) > LINE_BYTES_MAX:
            problems.add(line + text.count(b"\n", 0, cut), "the line is far too long for a frame")
            rest = rest[:1]  # it stays a bad line, however it goes on
        if cut:
            yield parse_block(text[:cut], line, channels, problems)
            line += text.count(b"\n", 0, cut)
    if rest.strip():
        problems.remark(f"line {line}, the last, has no end: was the log cut off?")
        yield parse_block(rest + b"\n", line, channels, problems)


def parse_block(
    text: bytes, first_line: int, channels: ChannelNames, problems: Problems
) -> FrameColumns:
    """Frames of whole lines, each with its end."""
    return _Block(text, first_line, channels, problems).columns()


class _Block:
    """Lines being taken apart; columns are filled as lines of one shape are done."""

    def __init__(
        self, text: bytes, first_line: int, channels: ChannelNames, problems: Problems
    ) -> None:
        self._text = text
        self._first_line = first_line
        self._channels = channels
        self._problems = problems
        letters = np.frombuffer(text, np.uint8)
        ends = np.flatnonzero(letters == 10)
        starts = np.empty_like(ends)
        starts[:1] = 0
        starts[1:] = ends[:-1] + 1
        ends = ends - (letters[np.maximum(ends - 1, 0)] == 13)  # lines may end as on Windows
        self._letters, self._starts, self._ends = letters, starts, ends
        count = len(starts)
        width = FD_BYTES if b"##" in text or b"[" in text else CLASSIC_BYTES
        self._time_ns = np.zeros(count, np.int64)
        self._channel = np.zeros(count, np.uint8)
        self._can_id = np.zeros(count, np.uint32)
        self._flags = np.zeros(count, np.uint8)
        self._length = np.zeros(count, np.uint8)
        self._data = np.zeros((count, width), np.uint8)
        self._is_read = np.zeros(count, np.bool_)

    def columns(self) -> FrameColumns:
        """All of them, in the order of the lines."""
        lengths = self._ends - self._starts
        for length in np.unique(lengths):
            which = np.flatnonzero(lengths == length)
            if 0 < length <= LINE_BYTES_MAX:
                which = self._read_shapes(which, int(length))
            self._read_one_by_one(which)
        done = self._is_read
        columns = FrameColumns(
            time_ns=self._time_ns,
            channel=self._channel,
            can_id=self._can_id,
            flags=self._flags,
            length=self._length,
            data=self._data,
            place=np.arange(self._first_line, self._first_line + len(done)),
            channels=self._channels.names,
        )
        return columns if done.all() else columns.take(done)

    def _read_shapes(self, which: NDArray[np.intp], length: int) -> NDArray[np.intp]:
        """Reads the lines of one length shape by shape; answers those that are left."""
        letters = self._letters
        rows_of_all = as_strided(letters, (len(letters) - length + 1, length), (1, 1))
        rows = rows_of_all[self._starts[which]]
        odd: list[NDArray[np.intp]] = []
        for _ in range(SHAPES_MAX):
            if not len(which):
                break
            shape = _SHAPE.fullmatch(rows[0].tobytes())
            if shape is None:
                odd.append(which[:1])
                which, rows = which[1:], rows[1:]
                continue
            fixed = _fixed_columns(shape)
            same = (rows[:, fixed] == rows[0, fixed]).all(axis=1)
            if same.all():
                odd.append(self._read_shape(which, rows, shape))
                return np.concatenate(odd)
            odd.append(self._read_shape(which[same], rows[same], shape))
            which, rows = which[~same], rows[~same]
        return np.concatenate([*odd, which])

    def _read_shape(
        self, which: NDArray[np.intp], rows: Bytes, shape: re.Match[bytes]
    ) -> NDArray[np.intp]:
        """Reads lines of one shape; answers those whose digits are none."""
        seconds, is_number = _decimal(rows, *shape.span("s"))
        micros, is_fraction = _decimal(rows, *shape.span("us"))
        can_id, is_id = _hexadecimal(rows, *shape.span("id"))
        start, end = shape.span("data")
        size = (end - start) // 2
        flags = FrameFlag.SENT if shape["dir"] == b" T" else FrameFlag(0)
        if shape["fd"]:
            flags |= fd_flags(int(shape["fd"][1:], 16))
        if len(shape["id"]) == 8:
            is_error = (can_id & ERROR_FLAG) != 0
            is_id &= is_error | (can_id <= EXTENDED_ID_MAX)
            kinds = np.where(is_error, FrameFlag.ERROR, FrameFlag.EXTENDED).astype(np.uint8)
            can_id &= EXTENDED_ID_MAX
        else:
            is_id &= can_id <= 0x7FF
            kinds = np.zeros(len(rows), np.uint8)
        is_good = is_number & is_fraction & is_id
        allowed = FD_LENGTHS if shape["fd"] else range(CLASSIC_BYTES + 1)
        if (end - start) % 2 or size not in allowed:
            return which
        if size:
            pairs = np.ascontiguousarray(rows[:, start:end]).view("<u2")
            content = _BYTE[pairs]
            is_good &= content.max(axis=1) != _BAD_BYTE
            self._data[which, :size] = content
        self._time_ns[which] = seconds * 1_000_000_000 + micros * 1000
        self._channel[which] = self._channels.place(shape["channel"].decode(errors="replace"))
        self._can_id[which] = can_id
        self._flags[which] = kinds | int(flags)
        self._length[which] = size
        self._is_read[which] = is_good
        bad = which[~is_good]
        self._data[bad] = 0
        return bad

    def _read_one_by_one(self, which: NDArray[np.intp]) -> None:
        for n in np.sort(which).tolist():
            text = self._text[self._starts[n] : self._ends[n]].decode("utf-8", errors="replace")
            if not text.strip():
                continue
            try:
                frame = parse_line(text)
            except LineError as error:
                self._problems.add(self._first_line + n, str(error), text)
                continue
            self._time_ns[n] = frame.time_ns
            self._channel[n] = self._channels.place(frame.channel)
            self._can_id[n] = frame.can_id
            self._flags[n] = frame.flags
            self._length[n] = frame.length
            self._data[n, : len(frame.data)] = np.frombuffer(frame.data, np.uint8)
            self._is_read[n] = True


def _fixed_columns(shape: re.Match[bytes]) -> NDArray[np.intp]:
    """The columns in which every line of a shape has the same letters."""
    free = np.zeros(len(shape[0]), np.bool_)
    for name in ("s", "us", "id", "data"):
        free[slice(*shape.span(name))] = True
    return np.flatnonzero(~free)


def _decimal(rows: Bytes, start: int, end: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Numbers in some columns, and where they are such."""
    total = np.zeros(len(rows), np.int64)
    is_good = np.ones(len(rows), np.bool_)
    for column in range(start, end):
        digit = rows[:, column] - np.uint8(48)  # what lies below '0' wraps around
        is_good &= digit < 10
        total *= 10
        total += digit
    return total, is_good


def _hexadecimal(rows: Bytes, start: int, end: int) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]:
    total = np.zeros(len(rows), np.uint32)
    is_good = np.ones(len(rows), np.bool_)
    for column in range(start, end):
        digit = _HEX[rows[:, column]]
        is_good &= digit < 16
        total <<= np.uint32(4)
        total |= digit
    return total, is_good
