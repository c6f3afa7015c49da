"""The server of `bench.dashboard`, in a process of its own; prints the port of its page.

    python -m bench.dashboard_live PORT SECONDS RESULT.json
"""

from __future__ import annotations

import asyncio
import gc
import json
import sys
import time
from pathlib import Path
from typing import Final

from bench.monitor import WARM_UP_S
from bench.monitor_live import CHANNEL, SETTLED_S, resident_kib, udp_opener
from canbus.heard import Heard
from canbus.listener import SocketcanListener
from dbw.dashboard_controls import CarControls
from dbw.dashboard_server import human_clock
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns
from telemetry.dashboard.access import Access, new_token
from telemetry.dashboard.picture import Picture
from telemetry.dashboard.server import Server, listen
from vehicles import load_vehicle

BITRATE_BPS: Final = 500_000


class CountingEars:
    """Counts what is heard."""

    def __init__(self, listener: SocketcanListener) -> None:
        self._listener = listener
        self.frames = 0

    def hear(self, timeout_ns: int) -> list[Heard]:
        """What waits."""
        heard = self._listener.hear(timeout_ns)
        self.frames += len(heard)
        return heard

    def notes(self) -> list[str]:
        """What happened to the channel."""
        return self._listener.notes()


class Meter:
    """Looks at the process when it is warm, when it has settled, and at the end."""

    def __init__(self, seconds: int, ears: CountingEars, listener: SocketcanListener) -> None:
        self._ears = ears
        self._listener = listener
        self._begin_ns = monotonic_ns()
        self._warm_ns = self._begin_ns + WARM_UP_S * NS_PER_S
        self._settled_ns = self._warm_ns + min(SETTLED_S, seconds // 2) * NS_PER_S
        self._end_ns = self._warm_ns + seconds * NS_PER_S
        self._warm: tuple[float, int, int] | None = None
        self._settled_kib = 0
        self.answer: dict[str, float] = {}

    def is_over(self) -> bool:
        """Asked at every step."""
        now_ns = monotonic_ns()
        if now_ns < self._warm_ns:
            return False
        seen = time.process_time(), self._ears.frames, self._listener.lost
        if self._warm is None:
            self._warm_ns, self._warm = now_ns, seen
        if now_ns >= self._settled_ns and not self._settled_kib:
            self._settled_kib = resident_kib()
        if now_ns < self._end_ns:
            return False
        wall_s = (now_ns - self._warm_ns) / NS_PER_S
        self.answer = {
            "seconds": wall_s,
            "cpu": (seen[0] - self._warm[0]) / wall_s,
            "frames": seen[1] - self._warm[1],
            "lost": seen[2] - self._warm[2],
            "grown_kib": resident_kib() - self._settled_kib,
            "share": wall_s / ((now_ns - self._begin_ns) / NS_PER_S),
        }
        return True


def main() -> None:
    """Serves for a while and writes what it cost."""
    port, seconds, result = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    vehicle = load_vehicle("tabby_evo")
    with (
        SocketcanListener(
            [CHANNEL], realtime=realtime_ns, open_socket=udp_opener(port)
        ) as listener,
        listen("127.0.0.1", 0) as listening,
    ):
        ears = CountingEars(listener)
        server = Server(
            listener=ears,
            picture=Picture(vehicle, CHANNEL, BITRATE_BPS, human_clock()),
            controls=CarControls("virtual", CHANNEL, vehicle=vehicle),
            access=Access(new_token()),
            about={},
            clock=monotonic_ns,
            realtime=realtime_ns,
        )
        gc.freeze()
        print(listening.getsockname()[1], flush=True)
        meter = Meter(seconds, ears, listener)
        asyncio.run(server.serve(listening, meter.is_over))
    result.write_text(json.dumps(meter.answer), encoding="utf-8")


if __name__ == "__main__":
    main()
