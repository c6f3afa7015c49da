"""How long it took from a cause to the answer on the bus: checked, and kept for a table."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from tests.vcan import VARIABLE
from tests.vcan.bus_log import Line

FILE_NAME = "latency.jsonl"
WIRE_S = 0.001
SENSED_S = 0.020 + WIRE_S
SILENT_S = 0.075 + WIRE_S
PLANNER_SILENT_S = 0.085 + 0.015 + WIRE_S
"""The design's time budgets, plus the wire."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency:
    """One measurement."""

    cause: str
    answer: str
    measured_ms: float
    budget_ms: float


def within(cause: str, answer: str, since_s: float, line: Line, budget_s: float) -> None:
    """The answer came in time.

    Args:
        cause: as the table calls it.
        answer: what is on the bus.
        since_s: when the cause was there, by the log's clock.
        line: the answer.
        budget_s: longest time allowed.
    """
    measured_s = line.time_s - since_s
    row = Latency(
        cause=cause, answer=answer, measured_ms=measured_s * 1e3, budget_ms=budget_s * 1e3
    )
    with Path(os.environ[VARIABLE], FILE_NAME).open("a") as file:
        file.write(f"{json.dumps(asdict(row))}\n")
    assert measured_s < budget_s, f"{cause}: {answer} after {measured_s * 1e3:.1f} ms"


def read_rows(folders: Iterable[Path]) -> Iterator[Latency]:
    """What was measured in these folders."""
    for folder in folders:
        path = folder / FILE_NAME
        for line in path.read_text().splitlines() if path.exists() else ():
            yield Latency(**json.loads(line))


def table(rows: Sequence[Latency]) -> str:
    """As Markdown, one row for each cause and answer."""
    groups: dict[tuple[str, str, float], list[float]] = {}
    for row in rows:
        key = (row.cause, row.answer, row.budget_ms)
        groups.setdefault(key, []).append(row.measured_ms)
    lines = [
        "| cause | on the bus | times | median, ms | worst, ms | budget, ms |",
        "|---|---|---|---|---|---|",
    ]
    for (cause, answer, budget_ms), all_ms in sorted(groups.items()):
        lines.append(
            f"| {cause} | {answer} | {len(all_ms)} | {median(all_ms):.1f} | {max(all_ms):.1f} "
            f"| {budget_ms:.0f} |"
        )
    return "\n".join([*lines, ""])
