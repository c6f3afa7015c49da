"""The figures of `docs/reproduce.md`: `python -m experiments.docs` writes them."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from experiments.page import figure
from experiments.result import Experiment, Row
from experiments.table import experiments_of, run_one

PATH = Path(__file__).parents[1] / "docs" / "reproduce.md"
SEED = 0
MARK = "<!-- {} {} -->"
HEAD = (
    "| quantity | unit | paper | baseline | ours | goal | verdict |",
    "|---|---|--:|--:|--:|---|---|",
)


def table_of(rows: Sequence[Row]) -> str:
    """The rows of one experiment in Markdown."""
    lines = [
        f"| {row.quantity} | {row.unit} | {figure(row.paper_value)} | "
        f"{figure(row.baseline_value)} | {figure(row.ours_value)} | {row.tolerance} | "
        f"{'met' if row.passed else '**missed**'} |"
        for row in rows
    ]
    return "\n".join([*HEAD, *lines])


def written_table(experiment: Experiment) -> str:
    """What the document has now for an experiment; empty for nothing."""
    text = PATH.read_text(encoding="utf-8")
    begin, end = (MARK.format(word, experiment.id) for word in ("begin", "end"))
    return text.partition(begin)[2].partition(end)[0].strip()


def main(names: Sequence[str]) -> int:
    """Runs experiments and puts their tables between the marks of the document.

    Args:
        names: Ids of experiments; none for all.
    """
    for experiment in experiments_of(()):
        if names and experiment.id not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            rows = run_one(experiment, SEED, Path(folder)).outcome.rows
        begin, end = (MARK.format(word, experiment.id) for word in ("begin", "end"))
        head, _, rest = PATH.read_text(encoding="utf-8").partition(begin)
        assert rest, f"{PATH}: no {begin}"
        tail = rest.partition(end)[2]
        text = f"{head}{begin}\n{table_of(rows)}\n{end}{tail}"
        PATH.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
