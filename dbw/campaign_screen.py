"""What `dbw campaign` shows: a progress bar, and a short table at the end."""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn
from rich.table import Table

from campaign.failure import Tally
from campaign.result import SeedResult
from runtime.clock import monotonic_ns

S_PER_H = 3600.0
LINE_NS = 600_000_000_000
"""How often a log file gets a line."""


class CampaignScreen:
    """Progress of a campaign: a bar on terminals, a line every ten minutes in a log file.

    Args:
        console: Where to.
        goal_s: Virtual time of all seeds.
        tally: Of what is done already; counts on.
    """

    def __init__(self, console: Console, goal_s: float, tally: Tally) -> None:
        self._console = console
        self._goal_s = goal_s
        self._tally = tally
        self._done_s = tally.simulated_s
        self._start_ns = self._line_ns = 0
        self._task: TaskID | None = None
        self._progress = Progress(
            BarColumn(bar_width=14),
            TextColumn("{task.fields[line]}"),
            console=console,
            auto_refresh=False,
            transient=True,
            disable=not console.is_terminal,
        )

    def __enter__(self) -> Self:
        """Shows what is done already."""
        self._start_ns = self._line_ns = monotonic_ns()
        self._progress.start()
        self._task = self._progress.add_task("", total=self._goal_s, line="starting up")
        self._draw("starting up")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Takes the bar away."""
        self._progress.stop()

    def show(self, result: SeedResult) -> None:
        """Counts a seed and draws."""
        self._tally.add(result)
        now_ns = monotonic_ns()
        wall_s = max((now_ns - self._start_ns) * 1e-9, 1e-9)
        factor = (self._tally.simulated_s - self._done_s) / wall_s
        line = progress_line(self._tally, self._goal_s, factor)
        self._draw(line)
        if not self._console.is_terminal and now_ns - self._line_ns >= LINE_NS:
            self._line_ns = now_ns
            self._console.print(line, soft_wrap=True)

    def _draw(self, line: str) -> None:
        if self._task is not None:
            self._progress.update(self._task, completed=self._tally.simulated_s, line=line)
            self._progress.refresh()


def progress_line(tally: Tally, goal_s: float, real_time_factor: float) -> str:
    """One line for a person: hours done, time against the wall clock, time left, failures."""
    left_s = max(0.0, goal_s - tally.simulated_s)
    left = clock_text(left_s / real_time_factor) if real_time_factor > 0.0 else "?"
    return (
        f"{tally.simulated_s / S_PER_H:.2f}/{goal_s / S_PER_H:.2f} h  {real_time_factor:.0f} x  "
        f"{left} left  violations {tally.violations}  missed {tally.missed}"
    )


def clock_text(span_s: float) -> str:
    """As a clock shows it: 1:05:09."""
    minutes, seconds = divmod(round(span_s), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"


def print_summary(console: Console, tally: Tally, wall_s: float, trace_sha256: str) -> None:
    """The short table."""
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column()
    table.add_column(justify="right")
    for row in _rows(tally, wall_s):
        table.add_row(*row)
    console.print(table)
    console.print(f"trace {trace_sha256}", soft_wrap=True)


def _rows(tally: Tally, wall_s: float) -> Iterator[tuple[str, str]]:
    yield "simulated", f"{tally.simulated_s / S_PER_H:.2f} h"
    yield "of it the car drove itself", f"{tally.engaged_s / S_PER_H:.2f} h"
    yield "seeds", str(tally.seeds)
    if wall_s > 0.0:
        yield "time against the wall clock", f"{tally.simulated_s / wall_s:.1f} x"
    yield "faults", str(tally.injections)
    yield "faults missed", str(tally.missed)
    yield "false trips", str(tally.false_trips)
    yield "properties broken", str(tally.violations)
    yield "failing seeds", str(tally.failing_seeds)
