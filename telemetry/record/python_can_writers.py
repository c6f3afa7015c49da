"""ASC and BLF, written by python-can batch by batch.

Both have numbers for channels, and times that count from the first frame's.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import BinaryIO, Final, cast

from canbus.candump import NS_PER_US, US_PER_S
from canbus.heard import FD_BIT_RATE_SWITCH, FD_ERROR_STATE, Heard
from canbus.hidden import ASAMMDF, hidden
from telemetry.record.channels import ChannelNumbers
from telemetry.record.formats import start_of
from telemetry.record.log_file import LogFile

with hidden(ASAMMDF):
    from can import Message
    from can.io import ASCWriter, BLFWriter

NS_PER_S: Final = 1_000_000_000
ZLIB_FASTEST: Final = 1
STARTED: Final = "// recorded by dbw"


class AscWriter:
    """See `telemetry.record.formats.Writer`.

    The file counts frames from its start, which is not as fine as their times: it is given a round
    one, so that nothing is lost.

    Args:
        file: Empty, and open.
        numbers: Of the channels.
        start_ns: What the start is a multiple of.
    """

    def __init__(self, file: LogFile, numbers: ChannelNumbers, start_ns: int) -> None:
        self._file = file
        self._numbers = numbers
        self._text = io.TextIOWrapper(cast("BinaryIO", file), encoding="ascii", write_through=True)
        self._writer = ASCWriter(self._text)
        self._round_ns = start_ns
        self._start_ns: int | None = None

    def write(self, frames: Sequence[Heard]) -> None:
        """Writes lines."""
        for item in frames:
            if self._start_ns is None:
                self._start_ns = start_of(item.time_ns, self._round_ns)
                self._writer.log_event(STARTED, self._start_ns / NS_PER_S)
            self._writer.on_message_received(message_of(item, self._numbers, self._start_ns))
        self._file.commit()

    def close(self) -> int:
        """Writes the end and closes the file."""
        self._writer.stop()
        return 0


class _Blf(BLFWriter):
    """With a way to write what has gathered, as python-can itself does on closing alone."""

    def flush(self, file: LogFile) -> None:
        """A container of what is not in one yet, and the header that has the time of the start."""
        self._flush()
        end = file.tell()
        file.seek(0)
        self._write_header(end)
        file.seek(end)


class BlfWriter:
    """As `AscWriter`. A batch is in containers of its own."""

    def __init__(self, file: LogFile, numbers: ChannelNumbers, start_ns: int) -> None:
        self._file = file
        self._numbers = numbers
        self._writer = _Blf(cast("BinaryIO", file), compression_level=ZLIB_FASTEST)
        self._round_ns = start_ns
        self._start_ns: int | None = None

    def write(self, frames: Sequence[Heard]) -> None:
        """Writes objects, and the container that they are in."""
        for item in frames:
            if self._start_ns is None:
                self._start_ns = start_of(item.time_ns, self._round_ns)
                self._writer.start_timestamp = self._start_ns / NS_PER_S
            self._writer.on_message_received(message_of(item, self._numbers, self._start_ns))
        self._writer.flush(self._file)

    def close(self) -> int:
        """Completes the header and closes the file."""
        self._writer.stop()
        return 0


def message_of(item: Heard, numbers: ChannelNumbers, start_ns: int) -> Message:
    """A frame as python-can has it; one from before the start is put there."""
    is_fd = item.is_fd
    return Message(
        timestamp=max(item.time_ns, start_ns) // NS_PER_US / US_PER_S,
        arbitration_id=item.can_id,
        is_extended_id=item.is_extended,
        is_remote_frame=item.is_remote,
        is_error_frame=item.is_error,
        is_fd=is_fd,
        bitrate_switch=is_fd and bool(item.fd_flags & FD_BIT_RATE_SWITCH),
        error_state_indicator=is_fd and bool(item.fd_flags & FD_ERROR_STATE),
        is_rx=not item.is_sent,
        channel=numbers.number(item.channel),
        dlc=item.length,
        data=item.data,
    )
