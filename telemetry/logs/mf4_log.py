"""MF4 files with bus logging (ASAM MDF), by asammdf."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
from asammdf import MDF
from asammdf.blocks.mdf_v4 import MDF4

from canbus.candump import NS_PER_US, US_PER_S
from telemetry.logs.frames import FD_BYTES, NS_PER_S, ChannelNames, FrameColumns, FrameFlag, joined
from telemetry.logs.mf4_layout import DIRECTION_FLAGS, DLC_LENGTHS, GROUPS, Group
from telemetry.logs.problems import Problems

DATA_LENGTH_MAX: Final = FD_BYTES


def _remove(half_made: MDF4) -> None:
    with suppress(AttributeError):
        half_made.close()


# A broken file leaves asammdf with an object that is half made, whose removal fails on top of it.
setattr(MDF4, "__del__", _remove)  # noqa: B010


def read_mf4(path: Path, channels: ChannelNames, problems: Problems) -> Iterator[FrameColumns]:
    """All frames of a file, in order of time.

    Args:
        path: The file.
        channels: Names of channels, filled as they come.
        problems: Is told what could not be read.
    """
    found: list[FrameColumns] = []
    others = 0
    try:
        with MDF(path) as mdf:
            start = mdf.header.start_time
            start_ns = int(start.replace(microsecond=0).timestamp()) * NS_PER_S
            start_ns += start.microsecond * NS_PER_US
            groups: list[Any] = mdf.groups
            for place, block in enumerate(groups):
                names = {channel.name for channel in block.channels}
                group = next((group for group in GROUPS if group.name in names), None)
                if group is None:
                    others += 1
                    continue
                signal = mdf.get(group.name, group=place, raw=True)
                found.append(_columns(group, signal, start_ns, channels))
    except Exception as error:  # a reader that is fed anything raises anything
        problems.remark(f"reading ends here: {str(error) or type(error).__name__}")
    if others:
        problems.remark(f"{others} groups of signals that are no frames are not read")
    if found:
        frames = joined(found)
        frames = frames.take(np.argsort(frames.time_ns, kind="stable"))
        frames.place[:] = np.arange(1, len(frames) + 1)
        yield frames


def _columns(group: Group, signal: Any, start_ns: int, channels: ChannelNames) -> FrameColumns:
    samples = signal.samples
    name = group.name

    def field(kind: str) -> Any:
        key = f"{name}.{kind}"
        if key in samples.dtype.names:
            return samples[key].astype(np.int64)
        return np.zeros(len(samples), np.int64)

    flags = np.full(len(samples), int(group.flag), np.uint8)
    for kind, flag in DIRECTION_FLAGS:
        flags |= (field(kind) != 0) * np.uint8(flag)
    data = np.zeros((len(samples), FD_BYTES), np.uint8)
    if f"{name}.DataBytes" in samples.dtype.names:
        content = samples[f"{name}.DataBytes"]
        data[:, : content.shape[1]] = content
    lengths = field("DataLength")
    if group.flag is FrameFlag.REMOTE:
        lengths = np.array(DLC_LENGTHS)[field("DLC").clip(0, len(DLC_LENGTHS) - 1)]
    buses = field("BusChannel")
    places = {int(bus): channels.place(str(int(bus))) for bus in np.unique(buses)}
    times_us = np.rint(signal.timestamps * US_PER_S).astype(np.int64)
    return FrameColumns(
        time_ns=start_ns + times_us * NS_PER_US,
        channel=np.array([places[int(bus)] for bus in buses], np.uint8),
        can_id=field("ID").astype(np.uint32),
        flags=flags,
        length=lengths.clip(0, DATA_LENGTH_MAX).astype(np.uint8),
        data=data,
        place=np.arange(1, len(samples) + 1),
        channels=channels.names,
    )
