"""`dbw record` on a full bus: what each format costs, and whether a frame is lost.

The recorder hears a full bus from a socket of the kernel with the kernel's stamps, a UDP socket in
place of a CAN one: the code that reads it is the one for SocketCAN. A process of its own feeds it
at a fixed rate. Beside the formats stands the same loop without a file: what listening alone costs.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.monitor import FRAMES_PER_S, feeder, free_port
from bench.table import Table, command_line, met
from telemetry.logs.reading import Log
from telemetry.record.formats import FORMATS

NAME = "record"
CPU_GOAL = 0.15
RECORD_S, QUICK_RECORD_S = 30, 2
LISTENING = "listening alone"


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """A recording, after warming up.

    Attributes:
        what: The format.
        seconds: How long.
        cpu: Share of one core.
        frames: Frames recorded.
        lost: Frames lost in the kernel's queue.
        is_whole: Whether the file, read again, has all that was recorded.
        size_bytes: Of the file.
    """

    what: str
    seconds: float
    cpu: float
    frames: int
    lost: int
    is_whole: bool
    size_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordResult:
    """What `measure` answers: listening alone first."""

    costs: Sequence[Cost]
    quick: bool

    def tables(self) -> list[Table]:
        """For printing."""
        bare = self.costs[0].cpu
        rows = [
            (
                cost.what, f"{cost.frames / cost.seconds:.0f}",
                f"{cost.lost}{'' if cost.is_whole else ', file incomplete'}", f"{cost.cpu:.1%}",
                f"{cost.cpu / bare:.1f}x",
                f"{cost.size_bytes / max(1, cost.frames):.0f}" if cost.size_bytes else "",
                met(cost.cpu <= CPU_GOAL and not cost.lost and cost.is_whole),
            )
            for cost in self.costs
        ]  # fmt: skip
        return [
            Table(
                title=f"`dbw record` on a full bus, {FRAMES_PER_S} frames/s",
                command=command_line(NAME, quick=self.quick),
                headers=(
                    "format", "frames/s", "lost", "share of a core", "of listening alone",
                    "bytes/frame", "goal 15 %, no loss",
                ),
                rows=rows,
                notes=("MCAP holds each frame twice: as it was, and decoded.",),
            )
        ]  # fmt: skip


def measure(*, quick: bool = False) -> RecordResult:
    """Records in each format, one after the other."""
    seconds = QUICK_RECORD_S if quick else RECORD_S
    endings = [ending for ending, kind in FORMATS.items() if kind.is_live]
    return RecordResult(costs=[_cost(ending, seconds) for ending in ("", *endings)], quick=quick)


def _cost(ending: str, seconds: int) -> Cost:
    with TemporaryDirectory() as folder:
        result, log = Path(folder) / "result.json", Path(folder) / f"a{ending}"
        port = free_port()
        command = [sys.executable, "-m", "bench.record_live", str(port), str(seconds), str(result)]
        process = feeder(str(port), FRAMES_PER_S)
        try:
            subprocess.run([*command, str(log)] if ending else command, check=True)
        finally:
            process.kill()
            process.wait()
        answer = json.loads(result.read_text(encoding="utf-8"))
        if not ending:
            return Cost(what=LISTENING, is_whole=True, size_bytes=0, **answer)
        found = sum(len(chunk) for chunk in Log(log).chunks())
        return Cost(
            what=FORMATS[ending].name, is_whole=found >= answer["frames"],
            size_bytes=log.stat().st_size * answer["frames"] // max(1, found), **answer,
        )  # fmt: skip
