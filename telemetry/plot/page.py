"""A plot as one page: zoomed with the mouse, nothing loaded from elsewhere."""

from __future__ import annotations

import json
import math
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from telemetry.pages import page_template
from telemetry.plot.model import FloatArray, Line, Panel, Plot, thinned
from telemetry.plot.png import LINE_COLOURS
from telemetry.plots import MODE_COLOURS, VERMILLION
from telemetry.signals import Span

UPLOT: Final = files("telemetry.dashboard") / "page"
DIGITS: Final = 9


def write_page(file: Path, plot: Plot) -> None:
    """Writes it."""
    template = page_template("telemetry.plot", "plot.html.j2", {})
    text = template.render(
        title=plot.title,
        script=_text("uplot.min.js"),
        style=_text("uplot.min.css"),
        # Inside a script element only "</" could end it.
        content=json.dumps(_content(plot), separators=(",", ":")).replace("</", "<\\/"),
        left_out=plot.left_out,
    )
    file.write_text(text, encoding="utf-8")


def _text(name: str) -> str:
    return (UPLOT / name).read_text(encoding="utf-8")


def _content(plot: Plot) -> dict[str, Any]:
    """All that the page draws, as JSON has it: NaN is null."""
    return {
        "begin": plot.begin_s,
        "end": plot.end_s,
        "panels": [_panel(panel) for panel in plot.panels],
        "has_modes": plot.modes is not None,
        "modes": [_band(one, one.mode.name, MODE_COLOURS[one.mode]) for one in plot.modes or ()],
        "codes": [_band(one, one.code.name, VERMILLION) for one in plot.codes],
    }


def _band(span: Span, name: str, colour: str) -> dict[str, Any]:
    return {"start": span.start_s, "end": span.end_s, "name": name, "colour": colour}


def _panel(panel: Panel) -> dict[str, Any]:
    return {
        "unit": panel.unit,
        "names": panel.names,
        "lines": [
            {"label": line.label, "colour": LINE_COLOURS[n % len(LINE_COLOURS)], **_points(line)}
            for n, line in enumerate(panel.lines)
        ],
    }


def _points(line: Line) -> dict[str, Any]:
    time_s, value = thinned(line)
    return {"time": np.round(time_s, DIGITS).tolist(), "value": _numbers(value)}


def _numbers(values: FloatArray) -> list[float | None]:
    return [None if math.isnan(value) else value for value in np.round(values, DIGITS).tolist()]
