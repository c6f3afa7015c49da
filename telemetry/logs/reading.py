"""Opens a log of any known format, by what it begins with, and gives its frames."""

from __future__ import annotations

import gzip
import os
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, cast

from telemetry.logs.candump import read_candump
from telemetry.logs.formats import CANDUMP, GZIP, LogError, format_of, head_of
from telemetry.logs.frames import (
    NS_PER_S,
    ChannelNames,
    FrameColumns,
    LogFrame,
    joined,
    origin_ns,
)
from telemetry.logs.problems import Problems

__all__ = ["Log", "LogError", "LogStream"]

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
        head = head_of(self.path)
        self.format = format_of(head)
        self.problems = Problems("line" if self.format == CANDUMP else "frame")
        self._is_gzip = head.startswith(GZIP)
        self._channels = ChannelNames()

    def chunks(self) -> Iterator[FrameColumns]:
        """Frames as columns, some ten thousand at a time."""
        if self.format != CANDUMP:
            yield from self._chunks_of_library()
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

    def _chunks_of_library(self) -> Iterator[FrameColumns]:
        try:
            if self.format == "mcap":
                from telemetry.logs.mcap_log import read_mcap

                return read_mcap(self.path, self._channels, self.problems)
            if self.format == "mf4":
                from telemetry.logs.mf4_log import read_mf4

                return read_mf4(self.path, self._channels, self.problems)
        except ModuleNotFoundError as error:
            raise LogError(
                f"{self.path}: {self.format.upper()} needs {error.name}: "
                "pip install can-by-wire[logs]"
            ) from error
        from telemetry.logs.python_can_logs import read_python_can

        return read_python_can(self.path, self.format, self._channels, self.problems)

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
        self.format = CANDUMP
        self.problems = Problems("line")
        self._channels = ChannelNames()
        self._descriptor = descriptor

    def chunks(self) -> Iterator[FrameColumns]:
        """Frames as columns, as many as have come."""
        yield from read_candump(
            lambda size: os.read(self._descriptor, size), self._channels, self.problems
        )
