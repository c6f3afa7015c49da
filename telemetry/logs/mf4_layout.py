"""How frames lie in an MF4 file (ASAM MDF bus logging): a group for each kind of frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from canbus.candump import FD_BYTES_MAX
from telemetry.logs.frames import FrameFlag

DLC_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""ISO 11898-1: bytes by data length code."""
DIRECTION_FLAGS: Final = (
    ("IDE", FrameFlag.EXTENDED), ("Dir", FrameFlag.SENT), ("EDL", FrameFlag.FD),
    ("BRS", FrameFlag.BITRATE_SWITCH), ("ESI", FrameFlag.ERROR_STATE),
)  # fmt: skip
"""Fields of one byte, and the flags that they stand for."""


@dataclass(frozen=True, slots=True)
class Group:
    """One kind of frame: the name of its group, the flag that makes it so."""

    name: str
    flag: FrameFlag


GROUPS: Final = (
    Group("CAN_DataFrame", FrameFlag(0)),
    Group("CAN_ErrorFrame", FrameFlag.ERROR),
    Group("CAN_RemoteFrame", FrameFlag.REMOTE),
)


def layout(name: str) -> np.dtype[np.void]:
    """The fields of a group's records."""
    return np.dtype([
        (f"{name}.BusChannel", "<u1"), (f"{name}.ID", "<u4"), (f"{name}.IDE", "<u1"),
        (f"{name}.DLC", "<u1"), (f"{name}.DataLength", "<u1"),
        (f"{name}.DataBytes", f"({FD_BYTES_MAX},)u1"), (f"{name}.Dir", "<u1"),
        (f"{name}.EDL", "<u1"), (f"{name}.BRS", "<u1"), (f"{name}.ESI", "<u1"),
    ])  # fmt: skip


def codes_of(length: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Data length codes."""
    return np.searchsorted(DLC_LENGTHS, length).astype(np.uint8)
