"""`make demo` once it is installed: how long it takes and how much memory."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.machine import reference_loop_s
from bench.table import Table, command_line, met

NAME = "demo"
WALL_S_MAX = 60.0
MEMORY_MB_MAX = 500.0
QUICK_ARGUMENTS = ("--distance-m", "40")

LAUNCHER = """
import json, resource, subprocess, sys, time
start = time.monotonic()
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
wall_s = time.monotonic() - start
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([code, wall_s, usage.ru_maxrss, usage.ru_utime + usage.ru_stime]))
"""
"""A process's largest memory counts from that of whoever started it: so a small one does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoResult:
    """What `measure` answers."""

    quick: bool
    wall_s: float
    cpu_s: float
    memory_mb: float
    """Largest resident set of the process (10^6 bytes)."""
    drive_s: float
    """Virtual time driven."""
    files: tuple[str, ...]
    reference_s: float

    def tables(self) -> list[Table]:
        """Time and memory."""
        what = "`dbw demo " + " ".join(QUICK_ARGUMENTS) + "`" if self.quick else "`dbw demo`"
        rows = [
            ("wall time, s", f"{self.wall_s:.1f}", f"< {WALL_S_MAX:g}",
             met(self.wall_s < WALL_S_MAX)),
            ("CPU time, s", f"{self.cpu_s:.1f}", "", ""),
            ("largest memory, MB", f"{self.memory_mb:.0f}", f"< {MEMORY_MB_MAX:g}",
             met(self.memory_mb < MEMORY_MB_MAX)),
        ]
        return [
            Table(
                title="`make demo` after installation",
                command=command_line(NAME, quick=self.quick),
                headers=("", "measured", "goal", ""),
                rows=rows,
                notes=(
                    f"{what}, which drives {self.drive_s:.0f} s and writes "
                    f"{', '.join(self.files)}. Reference loop: {self.reference_s * 1e3:.0f} ms.",
                ),
            )
        ]


def measure(*, quick: bool = False) -> DemoResult:
    """Runs the demo as a process of its own.

    Raises:
        RuntimeError: The demo failed.
    """
    return measure_demo(QUICK_ARGUMENTS if quick else (), quick=quick)


def measure_demo(arguments: Sequence[str], *, quick: bool) -> DemoResult:
    """The same with these arguments of `dbw demo`."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "demo"
        demo = [sys.executable, "-m", "dbw", "demo", "--out", str(out), *arguments]
        launched = subprocess.run(
            [sys.executable, "-S", "-c", LAUNCHER, *demo],
            check=True, stdout=subprocess.PIPE, text=True,
        )
        code, wall_s, memory_kib, cpu_s = json.loads(launched.stdout)
        if code != 0:
            raise RuntimeError(f"{' '.join(demo)} ended with exit code {code}")
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
        files = tuple(sorted(path.name for path in out.iterdir()))
    return DemoResult(
        quick=quick,
        wall_s=wall_s,
        cpu_s=cpu_s,
        memory_mb=memory_kib * 1024 / 1e6,
        drive_s=report["duration_s"],
        files=files,
        reference_s=reference_loop_s(),
    )
