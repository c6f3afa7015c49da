"""What `dbw campaign` shows: a progress bar, and a short table at the end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

from rich.console import Console
from rich.table import Table

from campaign.failure import Tally
from campaign.result import SeedResult
from dbw.progress import ProgressBar
from runtime.clock import monotonic_ns

S_PER_H = 3600.0
LINE_NS = 600_000_000_000
"""How often a log file gets a line."""


class CampaignScreen(ProgressBar):
    """Progress of a campaign: a bar on terminals, a line every ten minutes in a log file.

    Args:
        console: Where to.
        goal_s: Virtual time of all seeds.
        tally: Of what is done already; counts on.
    """

    def __init__(self, console: Console, goal_s: float, tally: Tally) -> None:
        super().__init__(console, goal_s)
        self._console = console
        self._goal_s = goal_s
        self._tally = tally
        self._done_s = tally.simulated_s
        self._start_ns = self._line_ns = 0

    def __enter__(self) -> Self:
        """Shows what is done already."""
        self._start_ns = self._line_ns = monotonic_ns()
        super().__enter__()
        self.draw(self._tally.simulated_s, "starting up")
        return self

    def show(self, result: SeedResult) -> None:
        """Counts a seed and draws."""
        self._tally.add(result)
        now_ns = monotonic_ns()
        wall_s = max((now_ns - self._start_ns) * 1e-9, 1e-9)
        factor = (self._tally.simulated_s - self._done_s) / wall_s
        line = progress_line(self._tally, self._goal_s, factor)
        self.draw(self._tally.simulated_s, line)
        if not self._console.is_terminal and now_ns - self._line_ns >= LINE_NS:
            self._line_ns = now_ns
            self._console.print(line, soft_wrap=True)


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
