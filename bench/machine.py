"""The machine a figure was measured on, and how fast it was at that moment."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

REFERENCE_COUNT = 3_000_000
REFERENCE_RUNS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """Printed beside every table."""

    cpu: str
    cores: int
    python: str

    def __str__(self) -> str:
        cores = f"{self.cores} core" + "s" * (self.cores != 1)
        return f"{self.cpu}, {cores}, Python {self.python}"


def this_machine() -> Machine:
    """The machine this runs on, and the cores this process may use."""
    return Machine(
        cpu=_cpu_name(), cores=len(os.sched_getaffinity(0)), python=platform.python_version()
    )


def _cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.processor() or platform.machine()


def cpu_s(action: Callable[[], object]) -> float:
    """CPU time of this process for one call, s."""
    start_ns = time.process_time_ns()
    action()
    return (time.process_time_ns() - start_ns) * 1e-9


def reference_loop_s() -> float:
    """CPU time of a fixed loop of the interpreter, s: the scale that CPU times hang on.

    The median of a few runs: what a neighbour on the machine costs belongs in it, a single hiccup
    does not.
    """
    times = sorted(cpu_s(lambda: sum(range(REFERENCE_COUNT))) for _ in range(REFERENCE_RUNS))
    return times[REFERENCE_RUNS // 2]
