"""`dbw reproduce`: how long all experiments of the papers take."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from bench.demo import LAUNCHER
from bench.table import Table, command_line, met

NAME = "reproduce"
WALL_S_MAX = 180.0
QUICK = "uwa"
EXITS = frozenset({0, 1})
"""1: a figure misses its goal, which the report says."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReproduceResult:
    """What `measure` answers."""

    quick: bool
    papers: str
    wall_s: float
    cpu_s: float
    figures_count: int
    cores_count: int

    def tables(self) -> list[Table]:
        """One row."""
        row = (
            f"`dbw reproduce {self.papers}`", str(self.figures_count), f"{self.wall_s:.0f}",
            f"{self.cpu_s:.0f}", f"< {WALL_S_MAX:g}", met(self.wall_s < WALL_S_MAX),
        )  # fmt: skip
        return [Table(
            title="The papers reproduced",
            command=command_line(NAME, quick=self.quick),
            headers=("command", "figures", "wall time, s", "CPU time, s", "goal, s", ""),
            rows=[row],
            notes=(f"A process for each of {self.cores_count} cores.",),
        )]  # fmt: skip


def measure(*, quick: bool = False) -> ReproduceResult:
    """Runs the command as a process of its own.

    Raises:
        RuntimeError: It failed.
    """
    papers = QUICK if quick else "all"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "reproduce"
        command = [sys.executable, "-m", "dbw", "reproduce", papers, "--out", str(out)]
        launched = subprocess.run(
            [sys.executable, "-S", "-c", LAUNCHER, *command],
            check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        code, wall_s, _, cpu_s = json.loads(launched.stdout)
        if code not in EXITS:
            raise RuntimeError(f"{' '.join(command)} ended with exit code {code}")
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    return ReproduceResult(
        quick=quick, papers=papers, wall_s=wall_s, cpu_s=cpu_s,
        figures_count=len(report["experiments"]), cores_count=len(os.sched_getaffinity(0)),
    )  # fmt: skip
