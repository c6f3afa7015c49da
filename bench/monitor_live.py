"""The screen of `bench.monitor`, in a process and a terminal of its own.

    python -m bench.monitor_live PORT SECONDS RESULT.json
"""

from __future__ import annotations

import gc
import json
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

from bench.monitor import WARM_UP_S
from canbus.listener import SocketcanListener
from dbw.monitor_screen import LiveMonitor
from dbw.terminal import Terminal
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns
from telemetry.monitor.filters import Source
from telemetry.monitor.known import Catalogue
from telemetry.monitor.meaning import Interpreter
from telemetry.monitor.selection import select
from telemetry.monitor.style import Span

SO_TIMESTAMPNS = 35
CHANNEL = "can0"
SETTLED_S = 60


class CountingTerminal(Terminal):
    """Counts what is drawn."""

    draws = 0

    def draw(self, lines: list[list[Span]]) -> None:
        """Draws and counts."""
        self.draws += 1
        super().draw(lines)


def resident_kib() -> int:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4


def udp_opener(port: int) -> Callable[[str, int], socket.socket]:
    """What opens a UDP socket where a listener would open a CAN one."""

    def open_socket(channel: str, error_classes: int) -> socket.socket:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sock.bind(("127.0.0.1", port))
        return sock

    return open_socket


def main() -> None:
    """Runs the screen for a while and writes what it cost."""
    port, seconds, result = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])

    catalogue = Catalogue()
    gc.freeze()
    with (
        SocketcanListener(
            [CHANNEL], realtime=realtime_ns, open_socket=udp_opener(port)
        ) as listener,
        CountingTerminal(sys.stdin.fileno(), sys.stdout.fileno(), with_colours=True) as terminal,
    ):
        live = LiveMonitor(
            listener=listener,
            terminal=terminal,
            interpreter=Interpreter(catalogue),
            selection=select(catalogue, [Source.parse(CHANNEL)]),
            channels=[CHANNEL],
            bitrate_bps=1_000_000,
            clock=monotonic_ns,
            realtime=realtime_ns,
        )
        _steps_until(live, monotonic_ns() + WARM_UP_S * NS_PER_S)
        start_ns, cpu_s = monotonic_ns(), time.process_time()
        frames, lost, draws = live.frames, listener.lost, terminal.draws
        _steps_until(live, start_ns + min(SETTLED_S, seconds // 2) * NS_PER_S)
        settled_kib = resident_kib()
        _steps_until(live, start_ns + seconds * NS_PER_S)
        cpu_s = time.process_time() - cpu_s
        wall_s = (monotonic_ns() - start_ns) / NS_PER_S
        answer = {
            "seconds": wall_s,
            "cpu": cpu_s / wall_s,
            "frames": live.frames - frames,
            "lost": listener.lost - lost,
            "draws": terminal.draws - draws,
            "grown_kib": resident_kib() - settled_kib,
        }
    result.write_text(json.dumps(answer), encoding="utf-8")


def _steps_until(live: LiveMonitor, end_ns: int) -> None:
    while monotonic_ns() < end_ns:
        live.step()


if __name__ == "__main__":
    main()
