"""Experiments, each run once for all tests of a process."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from experiments.docs import SEED
from experiments.table import Finished, experiments_of, run_one

FAST = (
    "uah-vernier", "uah-accuracy", "uah-reliability", "uwa-throttle", "uwa-silence", "uwa-brake",
)
SLOW = tuple(one.id for one in experiments_of(()) if one.id not in FAST)

KNOWN_TO_MISS = {
    "uah.path.baseline_max_error_m",
    "uah.steps.speed_4_people.overshoot_percent",
    "unicamp.circles.2_m.inverted_s",
    "unicamp.stack.2_m.inverted_s",
}
"""Rows whose goal is missed, as the documents say; a row that begins to meet it leaves this set."""


@cache
def once(name: str) -> Finished:
    """An experiment with the seed of the documents; its picture is gone afterwards."""
    (experiment,) = [one for one in experiments_of(()) if one.id == name]
    with tempfile.TemporaryDirectory() as folder:
        return run_one(experiment, SEED, Path(folder))
