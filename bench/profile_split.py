"""A profile put down to the project's parts."""

from __future__ import annotations

import pstats
from collections import defaultdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent

PARTS = (
    ("simulation/plant/", "plant"),
    ("simulation/wire.py", "wire"),
    ("canbus/timing.py", "wire"),
    ("simulation/trace.py", "trace hash"),
    ("oracle/", "oracle"),
    ("simulation/observer.py", "oracle"),
    ("simulation/", "kernel and world"),
    ("dbc/", "codec and protection"),
    ("canbus/canopen", "CANopen of the nodes"),
    ("canbus/", "nodes: shared"),
    ("ecus/common/", "nodes: ECUs, common"),
    ("ecus/supervisor/", "nodes: supervisor"),
    ("ecus/", "nodes: actuators"),
    ("safety_monitor/", "nodes: safety monitor"),
    ("gateway/", "nodes: gateway"),
    ("planner/", "planner"),
    ("telemetry/", "recording"),
    ("dbw/", "drive loop"),
    ("bench/", "drive loop"),
)
"""Beginning of a file's path in the project, and its part; the first that fits."""

LIBRARIES = (("/canopen/", "CANopen of the nodes"), ("/e2e/", "codec and protection"))
"""Libraries that belong to one part, whoever calls them."""

OTHER = "other"

Function = tuple[str, int, str]


def part_of(path: str) -> str | None:
    """The part a source file belongs to; None for libraries at large and built-in functions."""
    for piece, part in LIBRARIES:
        if piece in path:
            return part
    try:
        inside = Path(path).resolve().relative_to(ROOT).as_posix()
    except ValueError:
        return None
    return next((part for start, part in PARTS if inside.startswith(start)), None)


def split_by_part(stats: pstats.Stats) -> tuple[tuple[str, float], ...]:
    """Share of the time by part, largest first."""
    table: dict[Function, Any] = stats.stats  # type: ignore[attr-defined]
    owners = _Owners(table)
    seconds: defaultdict[str, float] = defaultdict(float)
    for function, (_, _, own_s, _, _) in table.items():
        for part, share in owners.of(function).items():
            seconds[part] += own_s * share
    total_s = sum(seconds.values())
    shares = ((part, spent_s / total_s) for part, spent_s in seconds.items())
    return tuple(sorted(shares, key=lambda item: -item[1]))


class _Owners:
    """Who pays for a function: its own part, or its callers' by the time spent for each."""

    def __init__(self, table: dict[Function, Any]) -> None:
        self._table = table
        self._known: dict[Function, dict[str, float]] = {}

    def of(self, function: Function) -> dict[str, float]:
        """Shares by part; sums to 1."""
        if function in self._known:
            return self._known[function]
        part = None if function[0].startswith(("~", "<")) else part_of(function[0])
        if part is not None:
            self._known[function] = {part: 1.0}
            return self._known[function]
        self._known[function] = {OTHER: 1.0}  # for callers in a circle
        callers = self._table[function][4] if function in self._table else {}
        weights = {caller: row[2] for caller, row in callers.items()}
        if not any(weights.values()):
            weights = dict.fromkeys(callers, 1.0)
        total = sum(weights.values())
        shares: defaultdict[str, float] = defaultdict(float)
        for caller, weight in weights.items():
            for owner, share in self.of(caller).items():
                shares[owner] += share * weight / total
        self._known[function] = dict(shares) or {OTHER: 1.0}
        return self._known[function]
