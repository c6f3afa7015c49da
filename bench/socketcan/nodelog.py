"""What the nodes' own log, as `dbw up` writes it, tells of their timing and of lost frames."""

from __future__ import annotations

import re
from dataclasses import dataclass

from runtime.node_process import LOSSES

_OVERRUNS = re.compile(
    r"^(\w+): overrun: (\d+) overruns and (\d+) skipped cycles so far, latest by (\d+\.\d) ms",
    flags=re.MULTILINE,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Overruns:
    """Of one node, in a while.

    Attributes:
        count: cycles that were not over when the next one was due.
        skipped: cycles left out because of that.
        late_ms_max: the latest begin of a cycle that was told of.
    """

    count: int
    skipped: int
    late_ms_max: float


def read_overruns(before: str, during: str) -> dict[str, Overruns]:
    """By node, of those that have had any in a while.

    Args:
        before: the log until then; nodes count from their start.
        during: the log of that while.
    """
    start = {node: (int(count), int(skipped))
             for node, count, skipped, _ in _OVERRUNS.findall(before)}
    found: dict[str, Overruns] = {}
    for node, count, skipped, late_ms in _OVERRUNS.findall(during):
        count_before, skipped_before = start.get(node, (0, 0))
        late_ms_max = found[node].late_ms_max if node in found else 0.0
        found[node] = Overruns(
            count=int(count) - count_before,
            skipped=int(skipped) - skipped_before,
            late_ms_max=max(late_ms_max, float(late_ms)),
        )
    return found


def read_losses(log: str) -> list[str]:
    """Lines in which a node tells of frames that it lost or could not send."""
    return [line for line in log.splitlines() if any(words in line for words in LOSSES.values())]
