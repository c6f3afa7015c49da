"""The report: `report.json`, and one HTML page with its pictures inside."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from pathlib import Path

from experiments.result import Row
from experiments.table import Finished
from telemetry.pages import page_template
from telemetry.report import without_nan


def json_of(finished: Sequence[Finished]) -> str:
    """`experiments[]`, a row each, with keys that stay; null for what there is no number for."""
    rows = [row.to_plain() for row in rows_of(finished)]
    return json.dumps(without_nan({"experiments": rows}), indent=2, allow_nan=False) + "\n"


def page_of(finished: Sequence[Finished], seed: int) -> str:
    """The page as text."""
    template = page_template("experiments", "report.html.j2", {"figure": figure, "uri": data_uri})
    rows = rows_of(finished)
    return template.render(
        finished=finished, rows=rows, missed=[row for row in rows if not row.passed], seed=seed
    )


def rows_of(finished: Sequence[Finished]) -> list[Row]:
    """Every row of every experiment."""
    return [row for one in finished for row in one.outcome.rows]


def figure(value: float) -> str:
    """Four significant digits; a dash for none."""
    if math.isnan(value):
        return "-"
    text = f"{value:.4g}"
    return f"{value:,.0f}" if "e+" in text else text


def data_uri(picture: Path) -> str:
    """A PNG as part of the page."""
    return f"data:image/png;base64,{base64.b64encode(picture.read_bytes()).decode('ascii')}"
