"""Opens a log of any known format, by what it begins with, and gives its frames."""

from __future__ import annotations

import gzip
import os
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, Final, cast

from telemetry.logs.candump import read_candump
from telemetry.logs.frames import (
    NS_PER_S,
    ChannelNames,
    FrameColumns,
    LogFrame,
    joined,
    origin_ns,
)
from telemetry.logs.problems import Problems

GZIP: Final = b"\x1f\x8b"
BEGINNINGS: Final = (
    (b"LOGG", "blf"), (b";$FILEVERSION", "trc"), (b"date ", "asc"), (b"base ", "asc"),
)  # fmt: skip
"""What a file of a format begins with; anything else is taken for candump's text."""
FOREIGN: Final = (
    (b"\x89MCAP", "an MCAP file"), (b"MDF ", "an MDF (MF4) file"), (b"SQLite format 3", "SQLite"),
    (b"PK\x03\x04", "a ZIP archive"), (b"\x7fELF", "a program"),
)  # fmt: skip
FORMATS: Final = "candump (also .gz), ASC, BLF and TRC"


class LogError(ValueError):
    """A log that cannot be read at all: the file and the reason in one line."""


class Log:
    """A log, open for reading once, from its beginning to its end.

    Attributes:
        problems: What could not be read so far.
        zero_ns: From where a person counts (`origin_ns`); 0 until frames have been read.
    """

    zero_ns: int = 0

    def __init__(self, path: str | Path) -> None:
        """Looks at the beginning of a file; nothing else is read yet.

        Raises:
            LogError: It cannot be opened, or is of a format that is not known here.
        """
        self.path = Path(path)
        try:
            with self.path.open("rb") as file:
                head = file.read(64)
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
        for beginning, what in FOREIGN:
            if head.startswith(beginning):
                raise LogError(f"{path}: {what} cannot be read here: {FORMATS} can")
        text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
        self.format = next((kind for mark, kind in BEGINNINGS if text.startswith(mark)), "candump")
        self.problems = Problems("line" if self.format == "candump" else "frame")
        self._is_gzip = head.startswith(GZIP)
        self._channels = ChannelNames()

    def chunks(self) -> Iterator[FrameColumns]:
        """Frames as columns, some ten thousand at a time."""
        if self.format != "candump":
            from telemetry.logs.python_can_logs import read_python_can

            yield from read_python_can(self.path, self.format, self._channels, self.problems)
            return
        with self.path.open("rb") as file:
            read = self._gzip_reader(file) if self._is_gzip else file.read
            yield from read_candump(read, self._channels, self.problems)

    def frames(self) -> Iterator[LogFrame]:
        """Frames one by one."""
        for chunk in self.chunks():
            yield from chunk.frames()

    def columns(self) -> FrameColumns:
        """All frames at once."""
        return joined(list(self.chunks()))

    def between(self, from_s: float, to_s: float) -> Iterator[FrameColumns]:
        """The chunks' frames of a span of time, in seconds as a person counts them.

        Raises:
            LogError: There is something in the log, and none of it a frame.
        """
        is_first = True
        for chunk in self.chunks():
            if not len(chunk):
                continue
            if is_first:
                self.zero_ns = origin_ns(int(chunk.time_ns[0]))
                is_first = False
            time_s = (chunk.time_ns - self.zero_ns) / NS_PER_S
            yield chunk.take((time_s >= from_s) & (time_s <= to_s))
        if is_first and self.problems.count:
            raise LogError(f"{self.path} is no log: {self.problems.lines()[0]}")

    def _gzip_reader(self, file: BinaryIO) -> Callable[[int], bytes]:
        unpacked = cast("BinaryIO", gzip.GzipFile(fileobj=file))

        def read(size: int) -> bytes:
            try:
                return unpacked.read(size)
            except (EOFError, OSError, zlib.error) as error:
                self.problems.remark(f"the compressed file ends early or is damaged: {error}")
                return b""

        return read


class LogStream(Log):
    """candump's text as it comes through a pipe: what is there is given at once."""

    def __init__(self, descriptor: int) -> None:
        """Takes an open file descriptor; nothing is read yet."""
        self.path = Path("-")
        self.format = "candump"
        self.problems = Problems("line")
        self._channels = ChannelNames()
        self._descriptor = descriptor

    def chunks(self) -> Iterator[FrameColumns]:
        """Frames as columns, as many as have come."""
        yield from read_candump(
            lambda size: os.read(self._descriptor, size), self._channels, self.problems
        )
