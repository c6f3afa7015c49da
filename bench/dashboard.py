"""`dbw dashboard`: what its server costs while a page watches a busy bus.

The server hears a UDP socket in place of a CAN one, fed by a process of its own, as in
`bench.monitor`. This process is the browser: it takes every message, with eight signals plotted.
"""

from __future__ import annotations

import asyncio
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.monitor import feeder, free_port
from bench.table import Table, command_line, met
from telemetry.dashboard.hub import PLOTS_MAX
from telemetry.dashboard.picture import PLOTTABLE

NAME = "dashboard"
FRAMES_PER_S = 4_000
"""Of 8 bytes each: a full bus at 500 kbit/s."""
CPU_GOAL = 0.10
GROWN_KIB_GOAL = 1_024
"""No growth: less than what the allocator keeps back or gives."""
LIVE_S, QUICK_LIVE_S = 600, 3


@dataclass(frozen=True, slots=True, kw_only=True)
class DashboardResult:
    """The server on a full bus, after warming up.

    Attributes:
        seconds: How long.
        cpu: Share of one core.
        frames: Frames heard.
        lost: Frames lost in the kernel's queue.
        grown_kib: How much resident memory has grown between the first minute's end, or the first
            half of a shorter run, and the end.
        messages: Messages that the browser has taken.
        bytes: Of them, all together.
    """

    seconds: float
    cpu: float
    frames: int
    lost: int
    grown_kib: int
    messages: int
    bytes: int
    quick: bool = False

    def tables(self) -> list[Table]:
        """For printing."""
        return [
            Table(
                title="`dbw dashboard` on a full bus, one page watching",
                command=command_line(NAME, quick=self.quick),
                headers=(
                    "duration, s", "frames/s", "lost", "messages/s", "kB/s", "share of a core",
                    "goal 10 %", "memory grown, KiB", "goal none",
                ),
                rows=[
                    (
                        f"{self.seconds:.0f}",
                        f"{self.frames / self.seconds:.0f}",
                        str(self.lost),
                        f"{self.messages / self.seconds:.1f}",
                        f"{self.bytes / self.seconds / 1e3:.1f}",
                        f"{self.cpu:.1%}",
                        met(self.cpu <= CPU_GOAL),
                        str(self.grown_kib),
                        met(self.grown_kib <= GROWN_KIB_GOAL),
                    )
                ],
                notes=(f"Memory: no growth is less than {GROWN_KIB_GOAL} KiB.",),
            ),
        ]  # fmt: skip


def measure(*, quick: bool = False) -> DashboardResult:
    """A feeder, the server, and this process as the browser."""
    return asyncio.run(_measure(QUICK_LIVE_S if quick else LIVE_S, quick))


async def _measure(duration_s: int, quick: bool) -> DashboardResult:
    with TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        port = free_port()
        process = feeder(str(port), FRAMES_PER_S)
        try:
            server = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "bench.dashboard_live", str(port), str(duration_s),
                str(result), stdout=asyncio.subprocess.PIPE,
            )  # fmt: skip
            assert server.stdout is not None
            web_port = int(await server.stdout.readline())
            taken = await _browse(web_port)
            if await server.wait() != 0:
                raise RuntimeError("the server failed")
        finally:
            process.kill()
            process.wait()
        measured = json.loads(result.read_text(encoding="utf-8"))
    share = measured.pop("share")
    messages, size = (round(share * number) for number in taken)
    return DashboardResult(**measured, messages=messages, bytes=size, quick=quick)


async def _browse(port: int) -> tuple[int, int]:
    """Takes all that comes until the server ends: messages, and their bytes."""
    from tornado.httpclient import HTTPRequest
    from tornado.websocket import websocket_connect

    where = f"localhost:{port}"
    request = HTTPRequest(f"ws://{where}/bus", headers={"Origin": f"http://{where}"})
    connection = await websocket_connect(request)
    names = list(PLOTTABLE)[:PLOTS_MAX]
    await connection.write_message(json.dumps({"do": "plot", "signals": names}))
    messages = size = 0
    while (text := await connection.read_message()) is not None:
        messages += 1
        size += len(text)
    connection.close()
    return messages, size
