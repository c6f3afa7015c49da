"""ASC, BLF and TRC, read by python-can. What its readers leave out is told.

They give times as floats, exact to a microsecond. A reader that fails has given what is readable.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from canbus.candump import NS_PER_US
from canbus.hidden import ASAMMDF, hidden
from telemetry.logs.frames import (
    ChannelNames,
    FrameColumns,
    FrameFlag,
    LogFrame,
    columns_of,
)
from telemetry.logs.problems import Problems

with hidden(ASAMMDF):
    from can import Message
    from can.io import ASCReader, BLFReader, TRCReader

CHUNK_FRAMES: Final = 10_000
REMARK_OF_FORMAT: Final = {
    "trc": "error frames and bus events of a TRC are not read",
    "asc": "events of an ASC that are no frames are not read",
}


def read_python_can(
    path: Path, kind: str, channels: ChannelNames, problems: Problems
) -> Iterator[FrameColumns]:
    """Frames of a log, a chunk at a time.

    Args:
        path: The file.
        kind: `asc`, `blf` or `trc`.
        channels: Names of channels, filled as they come.
        problems: Is told where reading ended early.
    """
    if kind in REMARK_OF_FORMAT:
        problems.remark(REMARK_OF_FORMAT[kind])
    frames: list[LogFrame] = []
    places: list[int] = []
    number = 0
    messages = _messages(path, kind)
    while True:
        try:
            message = next(messages, None)
        except Exception as error:  # a reader that is fed anything raises anything
            problems.add(number + 1, f"reading ends here: {str(error) or type(error).__name__}")
            message = None
        if message is not None:
            number += 1
            frames.append(frame_of(message))
            places.append(number)
        if frames and (message is None or len(frames) == CHUNK_FRAMES):
            yield columns_of(frames, places, channels)
            frames, places = [], []
        if message is None:
            return


def _messages(path: Path, kind: str) -> Iterator[Message]:
    reader: ASCReader | BLFReader | TRCReader
    if kind == "asc":
        reader = ASCReader(path, relative_timestamp=False)
    elif kind == "blf":
        reader = BLFReader(path)
    else:
        reader = TRCReader(path)
    with reader:
        yield from reader


def frame_of(message: Message) -> LogFrame:
    """python-can's message as a frame of a log."""
    is_remote = message.is_remote_frame and not message.is_fd  # ASC's reader: FD without data
    given: tuple[tuple[Any, FrameFlag], ...] = (
        (message.is_extended_id and not message.is_error_frame, FrameFlag.EXTENDED),
        (is_remote, FrameFlag.REMOTE),
        (message.is_error_frame, FrameFlag.ERROR),
        (message.is_fd, FrameFlag.FD),
        (message.bitrate_switch, FrameFlag.BITRATE_SWITCH),
        (message.error_state_indicator, FrameFlag.ERROR_STATE),
        (not message.is_rx, FrameFlag.SENT),
    )
    flags = FrameFlag(sum(flag for is_set, flag in given if is_set))
    data = b"" if is_remote else bytes(message.data)
    return LogFrame(
        round(message.timestamp * 1e6) * NS_PER_US,
        "" if message.channel is None else str(message.channel),
        message.arbitration_id,
        flags,
        message.dlc if is_remote else len(data),
        data,
    )
