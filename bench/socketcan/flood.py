"""How many frames a second of processor time reads: candump, the smallest python-can loop, ours.

All three receive the same flood at the same time, with room for all of it in their queues, and read
it to the last frame. So nothing is lost, and what counts is the time each spends on it.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from can.interfaces.socketcan import SocketcanBus

from bench.socketcan.proc import cpu_ns
from canbus.python_can_bus import PythonCanBus
from canbus.socketcan import FRAME_BYTES, make_room
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns

CHANNEL = "vcan0"
FRAMES, QUICK_FRAMES = 20_000, 200
ANSWER_S_MAX = 120.0
LISTENERS = Path("/proc/net/can/rcvlist_all")

Read = Callable[[int, Callable[[], None]], None]
"""Reads so many frames, having told that it listens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FloodResult:
    """One reader.

    Attributes:
        name: of the reader.
        frames: read, all that were sent.
        cpu_s: the processor time it took.
    """

    name: str
    frames: int
    cpu_s: float

    @property
    def frames_per_s(self) -> float:
        """What one processor could take."""
        return self.frames / self.cpu_s


def measure_flood(*, quick: bool = False) -> tuple[FloodResult, ...]:
    """Needs vcan0."""
    frames = QUICK_FRAMES if quick else FRAMES
    context = multiprocessing.get_context("fork")
    readers = []
    for name, read in (("python-can: recv", _python_can), ("our bus: receive", _our_bus)):
        ours, theirs = context.Pipe()
        process = context.Process(target=_reader, args=(read, frames, theirs), daemon=True)
        process.start()
        _answer(ours)
        readers.append((name, ours))
    with tempfile.TemporaryFile() as sink:
        candump = _start_candump(frames, sink)
        idle_ns = cpu_ns(candump.pid)
        subprocess.run(
            ["cangen", CHANNEL, "-g", "0", "-I", "400", "-L", "8", "-D", "0123456789ABCDEF",
             "-n", str(frames)],
            check=True,
        )
        spent_s = [_answer(control) for _, control in readers]
        _, _, usage = os.wait4(candump.pid, 0)
        candump.returncode = 0
        sink.seek(0)
        assert sum(1 for _ in sink) == frames, "candump has lost frames"
    candump_s = usage.ru_utime + usage.ru_stime - idle_ns / NS_PER_S
    return (
        FloodResult(name="candump -L, in C", frames=frames, cpu_s=candump_s),
        *(
            FloodResult(name=name, frames=frames, cpu_s=cpu_s)
            for (name, _), cpu_s in zip(readers, spent_s, strict=True)
        ),
    )


def _start_candump(frames: int, sink: Any) -> subprocess.Popen[bytes]:
    """candump, when it listens: the kernel's list of receivers tells."""
    before = LISTENERS.read_text().count(CHANNEL)
    size = str(frames * FRAME_BYTES)
    candump = subprocess.Popen(
        ["candump", "-L", "-r", size, "-n", str(frames), "-T", "10000", CHANNEL], stdout=sink
    )
    while LISTENERS.read_text().count(CHANNEL) == before:
        threading.Event().wait(0.01)
    return candump


def _answer(control: Connection) -> Any:
    assert control.poll(ANSWER_S_MAX), "a reader does not get all frames"
    return control.recv()


def _reader(read: Read, frames: int, control: Connection) -> None:
    """In a child."""
    begin_ns = 0

    def tell() -> None:
        nonlocal begin_ns
        begin_ns = cpu_ns(os.getpid())
        control.send("listens")

    read(frames, tell)
    control.send((cpu_ns(os.getpid()) - begin_ns) / NS_PER_S)


def _python_can(frames: int, tell: Callable[[], None]) -> None:
    with SocketcanBus(CHANNEL) as bus:
        make_room(bus.socket, frames)
        tell()
        for _ in range(frames):
            bus.recv()


def _our_bus(frames: int, tell: Callable[[], None]) -> None:
    bus = PythonCanBus(
        "socketcan", CHANNEL, clock=monotonic_ns, realtime=realtime_ns, backlog_frames=frames
    )
    with bus:
        tell()
        read = 0
        while read < frames:
            read += len(bus.receive(NS_PER_S))
        assert bus.statistics.rx_lost == 0
