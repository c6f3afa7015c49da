"""Processor time and memory of a process, as Linux counts them (proc(5))."""

from __future__ import annotations

import re
from pathlib import Path


def cpu_ns(pid: int) -> int:
    """Processor time of all threads of a process so far."""
    return sum(
        int(path.read_text().split()[0]) for path in Path(f"/proc/{pid}/task").glob("*/schedstat")
    )


def resident_mib(pid: int) -> float:
    """Memory that the process has in use, shared libraries included."""
    return kib(Path(f"/proc/{pid}/status").read_text(), "VmRSS") / 1024


def kib(text: str, name: str) -> int:
    """A line of `status` or `smaps_rollup`."""
    found = re.search(rf"^{name}:\s+(\d+) kB$", text, flags=re.MULTILINE)
    assert found is not None, f"no {name}"
    return int(found[1])
