"""Axes to draw on, in the style of the project's other pictures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from telemetry.plots import BLUE, DPI, INK, MUTED, STYLE, VERMILLION

OURS, BASELINE, SETPOINT, PAPER = BLUE, VERMILLION, INK, MUTED
"""One colour for one meaning in every picture."""
WIDTH_IN = 12.0


@contextmanager
def picture(file: Path, height_in: float, rows: int = 1, columns: int = 1) -> Iterator[list[Any]]:
    """Axes row by row; the PNG is written when the block is left.

    Raises:
        OSError: It cannot be written.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        FigureCanvasAgg(figure)
        axes: list[Any] = list(figure.subplots(rows, columns, squeeze=False).flat)
        for axis in axes:
            axis.grid(color="#eeeeee")
            axis.set_axisbelow(True)
        yield axes
        figure.savefig(file, dpi=DPI, metadata={"Software": None})
