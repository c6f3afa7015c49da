"""`dbw decode` and `decode_log` beside what a user would take else, on the same log, in turns.

Lines: `cantools decode --single-line` as a process, reading candump's text from its standard input,
as ours does. Data frames: python-can's LogReader and cantools, a list of rows for each message, one
data frame of each list; and asammdf's `extract_bus_logging`, which needs the log as MF4 and stops
short of data frames.
"""

from __future__ import annotations

import resource
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from bench.machine import cpu_s
from bench.table import Table, command_line, met
from simulation.trace import candump_lines
from simulation.world import World
from telemetry.databases import load_databases
from telemetry.decode.export import decode_log
from telemetry.record.channels import ChannelNumbers
from telemetry.record.convert import convert_log
from telemetry.record.formats import Setting, format_of
from vehicles import load_vehicle

NAME = "decode"
LINES_GOAL, FRAMES_GOAL, MDF_GOAL = 5.0, 20.0, 1.0
WORLD_S, QUICK_WORLD_S = 20.0, 1.0
COPIES, QUICK_COPIES = 40, 1
RUNS, QUICK_RUNS = 3, 1
DBC = Path(__file__).parents[1] / "dbc" / "vehicle.dbc"


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Processor time of both for the same frames, median of the runs."""

    what: str
    peer: str
    frames: int
    ours_s: float
    theirs_s: float
    goal: float

    @property
    def ratio(self) -> float:
        """How many times as fast ours is."""
        return self.theirs_s / self.ours_s


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodeResult:
    """All pairs."""

    pairs: list[Pair]
    quick: bool

    def tables(self) -> list[Table]:
        """For printing."""
        rows = [
            (
                pair.what, pair.peer, f"{pair.frames:,}", f"{pair.frames / pair.ours_s:,.0f}",
                f"{pair.frames / pair.theirs_s:,.0f}", f"{pair.ratio:.1f}x", f"{pair.goal:g}x",
                met(pair.ratio >= pair.goal),
            )
            for pair in self.pairs
        ]
        headers = ("what", "peer", "frames", "ours, frames/s", "peer's", "ratio", "goal", "")
        return [
            Table(
                title="Decoding a log",
                command=command_line(NAME, quick=self.quick),
                headers=headers,
                rows=rows,
                notes=("Processor time, start of the interpreter and imports included for lines.",),
            )
        ]


def measure(*, quick: bool = False) -> DecodeResult:
    """Decodes a log of the simulated bus, ours and the peer in turns."""
    with TemporaryDirectory() as folder:
        log = Path(folder) / "drive.log"
        frames = _write_log(log, quick=quick)
        runs = QUICK_RUNS if quick else RUNS
        ours = [sys.executable, "-m", "dbw", "decode", "-"]
        theirs = [sys.executable, "-m", "cantools", "decode", "--single-line", str(DBC)]
        lines = _in_turns(lambda: _process_s(ours, log), lambda: _process_s(theirs, log), runs)
        decode_log(log)  # imports
        tables = _in_turns(
            lambda: cpu_s(lambda: decode_log(log)), lambda: cpu_s(lambda: _peer(log)), runs
        )
        mf4 = Path(folder) / "drive.mf4"
        convert_log(log, mf4, format_of(mf4), Setting(databases=None, numbers=ChannelNumbers()))
        assert _extract(mf4) == frames  # imports, and a fair race
        mdf = _in_turns(
            lambda: cpu_s(lambda: decode_log(log)), lambda: cpu_s(lambda: _extract(mf4)), runs
        )
    return DecodeResult(
        pairs=[
            Pair(what="log to lines", peer="cantools decode", frames=frames, ours_s=lines[0],
                 theirs_s=lines[1], goal=LINES_GOAL),
            Pair(what="log to data frames", peer="LogReader and cantools", frames=frames,
                 ours_s=tables[0], theirs_s=tables[1], goal=FRAMES_GOAL),
            Pair(what="log to data frames", peer="asammdf, from MF4", frames=frames,
                 ours_s=mdf[0], theirs_s=mdf[1], goal=MDF_GOAL),
        ],
        quick=quick,
    )  # fmt: skip


def _write_log(path: Path, *, quick: bool) -> int:
    """A log of the parked stack, one stretch behind the other; answers its frames."""
    world = World(load_vehicle("tabby_evo"), 1)
    world.run_for(QUICK_WORLD_S if quick else WORLD_S)
    rows = list(world.trace.rows)
    copies = QUICK_COPIES if quick else COPIES
    with path.open("w") as file:
        for copy in range(copies):
            lines = candump_lines(rows, "vcan0", start_s=100.0 * copy)
            file.writelines(f"{line}\n" for line in lines)
    return copies * len(rows)


def _in_turns(
    ours: Callable[[], float], theirs: Callable[[], float], runs: int
) -> tuple[float, float]:
    pairs = [(ours(), theirs()) for _ in range(runs)]
    return median(a for a, _ in pairs), median(b for _, b in pairs)


def _process_s(command: list[str], log: Path) -> float:
    """Processor time of a process that reads the log."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with log.open("rb") as source:
        subprocess.run(command, stdin=source, stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _peer(log: Path) -> dict[str, Any]:
    """What a notebook without our readers does."""
    import pandas
    from can import LogReader

    (database,) = load_databases().databases
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for message in LogReader(log):
        known = database.get_message_by_frame_id(message.arbitration_id)
        values: Any = known.decode(bytes(message.data))
        rows[known.name].append({"time_s": message.timestamp, **values})
    return {name: pandas.DataFrame(found) for name, found in rows.items()}


def _extract(mf4: Path) -> int:
    """What asammdf offers; answers how many frames it has decoded."""
    from asammdf import MDF

    with MDF(mf4) as mdf, mdf.extract_bus_logging({"CAN": [(str(DBC), 0)]}) as found:
        groups: Any = found.groups
        return sum(int(group.channel_group.cycles_nr) for group in groups)
