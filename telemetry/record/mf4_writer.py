"""MF4 (ASAM MDF, bus logging), by asammdf: all is written at the end, so it is no recording."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any, Final

import numpy as np
from asammdf import MDF, Signal
from asammdf.blocks.v4_blocks import SourceInformation
from asammdf.blocks.v4_constants import BUS_TYPE_CAN, FLAG_CG_BUS_EVENT, SOURCE_BUS

from canbus.candump import NS_PER_US, US_PER_S
from canbus.heard import Heard
from telemetry.logs.frames import (
    NS_PER_S,
    ChannelNames,
    FrameColumns,
    FrameFlag,
    columns_of_heard,
    joined,
)
from telemetry.logs.mf4_layout import DIRECTION_FLAGS, GROUPS, Group, codes_of, layout
from telemetry.record.channels import ChannelNumbers
from telemetry.record.log_file import LogFile

VERSION: Final = "4.11"


class Mf4Writer:
    """See `telemetry.record.formats.Writer`. Frames are kept in memory until `close`."""

    def __init__(self, file: LogFile, numbers: ChannelNumbers) -> None:
        self._file = file
        self._numbers = numbers
        self._channels = ChannelNames()
        self._chunks: list[FrameColumns] = []

    def write(self, frames: Sequence[Heard]) -> None:
        """Keeps them."""
        self._chunks.append(columns_of_heard(frames, self._channels))

    def close(self) -> int:
        """Writes and closes the file."""
        frames = joined(self._chunks)
        frames = frames.take(np.argsort(frames.time_ns // NS_PER_US, kind="stable"))
        start_ns = int(frames.time_ns[0]) // NS_PER_S * NS_PER_S if len(frames) else 0
        content = BytesIO()
        with MDF(version=VERSION) as mdf:
            header: Any = mdf.header
            header.abs_time, header.tz_offset, header.daylight_save_time = start_ns, 0, 0
            header.time_flags = 0  # UTC
            for group in GROUPS:
                kinds = np.uint8(FrameFlag.REMOTE | FrameFlag.ERROR)
                which = (frames.flags & kinds) == np.uint8(group.flag)
                if which.any():
                    mdf.append(self._signal(group, frames.take(which), start_ns))
                    block: Any = mdf.groups[-1].channel_group
                    block.flags |= FLAG_CG_BUS_EVENT
            mdf.save(content, overwrite=True)
        self._file.write(content.getbuffer())
        self._file.close()
        return 0

    def _signal(self, group: Group, frames: FrameColumns, start_ns: int) -> Any:
        name = group.name
        samples = np.zeros(len(frames), layout(name))
        numbers = np.array([self._numbers.number(one) for one in frames.channels], np.uint8)
        samples[f"{name}.BusChannel"] = numbers[frames.channel]
        samples[f"{name}.ID"] = frames.can_id
        samples[f"{name}.DLC"] = codes_of(frames.length)
        is_remote = group.flag is FrameFlag.REMOTE
        samples[f"{name}.DataLength"] = 0 if is_remote else frames.length
        samples[f"{name}.DataBytes"][:, : frames.data.shape[1]] = frames.data
        for field, flag in DIRECTION_FLAGS:
            samples[f"{name}.{field}"] = (frames.flags & np.uint8(flag)) != 0
        times_us = (frames.time_ns - start_ns) // NS_PER_US
        source = SourceInformation(source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN)
        return Signal(
            name=name, samples=samples, timestamps=times_us / US_PER_S, source=source
        )
