"""Other people's frames: `cangen` in the range that the vehicle file leaves to strangers."""

from __future__ import annotations

import subprocess
from pathlib import Path
from statistics import mean
from typing import Self

from canbus.frame import Frame
from canbus.timing import frame_bits

STRANGERS = (
    Frame(0x400, bytes.fromhex("0123456789ABCDEF")),
    Frame(0x455, bytes.fromhex("DEADBEEF0BADF00D")),
    Frame(0x4AA, bytes.fromhex("3141592653589793")),
    Frame(0x4FF, bytes.fromhex("2718281828459045")),
)
"""One `cangen` each, all equally often; the content is fixed, so that the length is known."""

STRANGER_BITS = mean(frame_bits(frame) for frame in STRANGERS)

PRIORITY = 20
"""Above the nodes': a wire does not wait until the receiver's processor is free."""


def gap_ms(load: float, own_bits_per_s: float, bitrate_bps: int) -> float:
    """How often each stranger must send so that the bus is filled up to `load`, beside our own."""
    return 1e3 * len(STRANGERS) * STRANGER_BITS / (load * bitrate_bps - own_bits_per_s)


def statistic(channel: str, name: str) -> int:
    """One of the kernel's counters of a network."""
    return int(Path("/sys/class/net", channel, "statistics", name).read_text())


class Strangers:
    """They send within `with`, each with this pause between two frames."""

    def __init__(self, channel: str, pause_ms: float) -> None:
        self._commands = [
            ["chrt", "-r", str(PRIORITY), "cangen", channel, "-g", f"{pause_ms:.6f}",
             "-I", f"{frame.can_id:X}", "-L", str(len(frame.data)), "-D", frame.data.hex()]
            for frame in STRANGERS
        ]
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Self:
        """Starts them."""
        self._processes = [subprocess.Popen(command) for command in self._commands]
        return self

    def __exit__(self, *exception: object) -> None:
        """Ends them."""
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.wait()
