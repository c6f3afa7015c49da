"""Frames of a log: one as an object, many as numpy columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canbus.frame import Frame, FrameKind
from canbus.heard import (
    CLASSICAL,
    ERROR_FLAG,
    EXTENDED_FLAG,
    EXTENDED_ID_MAX,
    FD_BIT_RATE_SWITCH,
    FD_ERROR_STATE,
    REMOTE_FLAG,
    Heard,
)

CLASSIC_BYTES: Final = 8
FD_BYTES: Final = 64
NS_PER_S: Final = 1_000_000_000
RELATIVE_NS_MAX: Final = 86_400 * NS_PER_S
"""Times of a log that begins later than this are the system's."""


def origin_ns(first_ns: int) -> int:
    """From where a person counts: the log's own zero, or its first frame in the system's time."""
    return first_ns if first_ns >= RELATIVE_NS_MAX else 0


class FrameFlag(IntFlag):
    """What a frame is beside its identifier and data; no bit set is a classical data frame."""

    EXTENDED = 1
    """29-bit identifier."""
    REMOTE = 2
    ERROR = 4
    """No frame at all: what a controller tells of an error, as SocketCAN puts it into one."""
    FD = 8
    BITRATE_SWITCH = 16
    ERROR_STATE = 32
    SENT = 64
    """By the computer that wrote the log (Tx); otherwise received."""


NO_DATA: Final = FrameFlag.REMOTE | FrameFlag.ERROR
"""Frames that carry no message's content."""


class LogFrame(NamedTuple):
    """One frame of a log.

    `time_ns` counts from 1970, or from the start of the log where it does not say when that was.
    `length` is that of the data, and what a remote frame asks for.
    """

    time_ns: int
    channel: str
    can_id: int
    flags: FrameFlag
    length: int
    data: bytes

    def heard(self) -> Heard:
        """The frame as a listener hears it, every flag kept."""
        word = self.can_id
        for flag, bit in _WORD_BITS:
            if flag in self.flags:
                word |= bit
        fd_flags = CLASSICAL
        if FrameFlag.FD in self.flags:
            fd_flags = FD_BIT_RATE_SWITCH * (FrameFlag.BITRATE_SWITCH in self.flags)
            fd_flags |= FD_ERROR_STATE * (FrameFlag.ERROR_STATE in self.flags)
        is_sent = FrameFlag.SENT in self.flags
        return Heard(self.time_ns, self.channel, word, self.data, self.length, fd_flags, is_sent)

    def frame(self) -> Frame:
        """The frame as the bus has it; of several flags the one that says most."""
        for flag, kind in _KINDS:
            if flag in self.flags:
                return Frame(self.can_id, self.data, kind)
        return Frame(self.can_id, self.data)


_WORD_BITS: Final = (
    (FrameFlag.EXTENDED, EXTENDED_FLAG),
    (FrameFlag.REMOTE, REMOTE_FLAG),
    (FrameFlag.ERROR, ERROR_FLAG),
)
_FD_BITS: Final = (
    (FrameFlag.BITRATE_SWITCH, FD_BIT_RATE_SWITCH),
    (FrameFlag.ERROR_STATE, FD_ERROR_STATE),
)
_KINDS: Final = (
    (FrameFlag.ERROR, FrameKind.ERROR),
    (FrameFlag.REMOTE, FrameKind.REMOTE),
    (FrameFlag.FD, FrameKind.FD),
    (FrameFlag.EXTENDED, FrameKind.EXTENDED),
)


def flags_of(item: Heard) -> FrameFlag:
    """What a frame that was heard is, beside its identifier and data."""
    flags = FrameFlag.SENT if item.is_sent else FrameFlag(0)
    for flag, bit in _WORD_BITS:
        if item.word & bit:
            flags |= flag
    if item.is_fd:
        flags |= FrameFlag.FD
        for flag, bit in _FD_BITS:
            if item.fd_flags & bit:
                flags |= flag
    return flags


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameColumns:
    """N frames as columns of shape (N,), in the order of the log.

    `data` has shape (N, 8), or (N, 64) with FD frames among them, and is zero beyond `length`.
    """

    time_ns: NDArray[np.int64]
    channel: NDArray[np.uint8]
    """Place in `channels`."""
    can_id: NDArray[np.uint32]
    flags: NDArray[np.uint8]
    """Bits of `FrameFlag`."""
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]
    place: NDArray[np.int64]
    """Number of the line, or of the frame in a binary log, counted from 1."""
    channels: Sequence[str]
    """Names of all channels seen so far; a name keeps its place as the log goes on."""

    def __len__(self) -> int:
        return len(self.time_ns)

    def frames(self) -> Iterator[LogFrame]:
        """The same as objects."""
        width = self.data.shape[1]
        content = self.data.tobytes()
        columns = (self.time_ns, self.channel, self.can_id, self.flags, self.length)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for n, (time_ns, channel, can_id, flags, length) in enumerate(rows):
            size = 0 if flags & FrameFlag.REMOTE else length
            yield LogFrame(
                time_ns, self.channels[channel], can_id, FrameFlag(flags), length,
                content[n * width : n * width + size],
            )  # fmt: skip

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp] | slice) -> FrameColumns:
        """Some of the frames, by mask, by place or by a slice."""
        return FrameColumns(
            time_ns=self.time_ns[which],
            channel=self.channel[which],
            can_id=self.can_id[which],
            flags=self.flags[which],
            length=self.length[which],
            data=self.data[which],
            place=self.place[which],
            channels=self.channels,
        )


def columns_of(
    frames: Sequence[LogFrame], places: Sequence[int], channels: ChannelNames
) -> FrameColumns:
    """Frames as columns."""
    width = FD_BYTES if any(len(frame.data) > CLASSIC_BYTES for frame in frames) else CLASSIC_BYTES
    content = b"".join(frame.data.ljust(width, b"\0") for frame in frames)
    return FrameColumns(
        time_ns=np.array([frame.time_ns for frame in frames], np.int64),
        channel=np.array([channels.place(frame.channel) for frame in frames], np.uint8),
        can_id=np.array([frame.can_id for frame in frames], np.uint32),
        flags=np.array([int(frame.flags) for frame in frames], np.uint8),
        length=np.array([frame.length for frame in frames], np.uint8),
        data=np.frombuffer(content, np.uint8).reshape(-1, width),
        place=np.array(places, np.int64),
        channels=channels.names,
    )


def columns_of_heard(frames: Sequence[Heard], channels: ChannelNames) -> FrameColumns:
    """Frames as they were heard, as columns; places count from 1."""
    words = np.array([item.word for item in frames], np.uint32)
    fd_flags = np.array([item.fd_flags for item in frames], np.int64)
    is_fd = fd_flags != CLASSICAL
    flags = np.array([item.is_sent for item in frames], np.uint8) * np.uint8(FrameFlag.SENT)
    for flag, bit in _WORD_BITS:
        flags |= ((words & np.uint32(bit)) != 0) * np.uint8(flag)
    for flag, bit in _FD_BITS:
        flags |= (is_fd & ((fd_flags & bit) != 0)) * np.uint8(flag)
    flags |= is_fd * np.uint8(FrameFlag.FD)
    width = FD_BYTES if is_fd.any() else CLASSIC_BYTES
    content = b"".join([item.data.ljust(width, b"\0") for item in frames])
    return FrameColumns(
        time_ns=np.array([item.time_ns for item in frames], np.int64),
        channel=np.array([channels.place(item.channel) for item in frames], np.uint8),
        can_id=words & np.uint32(EXTENDED_ID_MAX),
        flags=flags,
        length=np.array([item.length for item in frames], np.uint8),
        data=np.frombuffer(content, np.uint8).reshape(-1, width),
        place=np.arange(1, len(frames) + 1),
        channels=channels.names,
    )


def joined(chunks: Sequence[FrameColumns]) -> FrameColumns:
    """Chunks of one log, one behind the other."""
    if len(chunks) == 1:
        return chunks[0]
    width = max((chunk.data.shape[1] for chunk in chunks), default=CLASSIC_BYTES)
    wide = [np.pad(c.data, ((0, 0), (0, width - c.data.shape[1]))) if c.data.shape[1] < width
            else c.data for c in chunks]  # fmt: skip

    def column(name: str, kind: type[np.generic]) -> NDArray[Any]:
        parts = [getattr(chunk, name) for chunk in chunks]
        return np.concatenate(parts) if parts else np.empty(0, kind)

    return FrameColumns(
        time_ns=column("time_ns", np.int64),
        channel=column("channel", np.uint8),
        can_id=column("can_id", np.uint32),
        flags=column("flags", np.uint8),
        length=column("length", np.uint8),
        data=np.concatenate(wide) if wide else np.empty((0, width), np.uint8),
        place=column("place", np.int64),
        channels=chunks[-1].channels if chunks else (),
    )


class ChannelNames:
    """Gives each name of a channel a number, in the order of their appearance."""

    MAX: Final = 255

    def __init__(self) -> None:
        self.names: list[str] = []

    def place(self, name: str) -> int:
        """The number of a name; names beyond the 255th share the last number."""
        if name not in self.names:
            if len(self.names) >= self.MAX:
                return self.MAX - 1
            self.names.append(name)
        return self.names.index(name)
