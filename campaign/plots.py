"""The pictures of a report: one drawn by matplotlib, the small ones as paths in the page."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from telemetry.plots import BLUE, MUTED, STYLE, VERMILLION

BAR_GAP = 0.15
"""Between bars, in widths of one."""
HEIGHT_SHARE_MIN = 0.12
SHARE_MAX = 1.04
"""Right end of the curve: what is left there came too late, or never."""
CURVE_IN = (9.6, 2.7)


def bars_path(counts: Sequence[int], height: float, *, highest: int) -> str:
    """Bars side by side as an SVG path, each one wide, zero at the bottom.

    Heights are logarithmic, so that a single late answer among a million shows; a count of
    `highest` has the full height.
    """
    parts = []
    for place, count in enumerate(counts):
        if count:
            tall = max(math.log1p(count) / math.log1p(highest), HEIGHT_SHARE_MIN) * height
            left = place + BAR_GAP / 2.0
            parts.append(f"M{left:g},{height:g}v{-tall:.3g}h{1.0 - BAR_GAP:g}v{tall:.3g}z")
    return "".join(parts)


def lateness_picture(within: Sequence[int], late: int, never: int) -> str:
    """How many answers took longer than each share of their interval, as a data URI.

    Args:
        within: Answers in equal steps of their interval.
        late: Answers after its end.
        never: Answers that were due and never came.
    """
    total = sum(within) + late + never
    assert total, "nothing to draw"
    edges = [*np.linspace(0.0, 1.0, len(within) + 1), SHARE_MAX]
    later = (total - np.array([0, *np.cumsum(within), sum(within)])) / total
    with rc_context({**STYLE, "svg.hashsalt": "campaign", "font.size": 10}):
        figure = Figure(figsize=CURVE_IN, layout="constrained")
        axes: Any = figure.add_subplot()
        axes.step(edges, later, where="post", color=BLUE, linewidth=2.0)
        axes.axvline(1.0, color=VERMILLION, linewidth=1.5)
        axes.set_yscale("log")
        axes.set_ylim(0.5 / total, 1.3)
        axes.set_xlim(0.0, SHARE_MAX)
        axes.yaxis.set_major_formatter(lambda share, _: f"{100.0 * share:g} %")
        axes.xaxis.set_major_formatter(lambda share, _: f"{100.0 * share:g} %")
        axes.set_xlabel("share of the fault's own interval")
        axes.set_ylabel("share of answers\nstill to come")
        axes.grid(color="#eeeeee")
        axes.annotate(
            "interval over", (1.0, 1.0), xytext=(-6, -4), textcoords="offset points",
            color=VERMILLION, ha="right", va="top",
        )  # fmt: skip
        axes.annotate(
            f"{total:,} answers due", (0.0, 0.5 / total), xytext=(8, 8),
            textcoords="offset points", color=MUTED,
        )  # fmt: skip
        file = io.BytesIO()
        canvas: Any = FigureCanvasSVG(figure)
        canvas.print_svg(file, metadata={"Date": None, "Creator": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(file.getvalue()).decode()}"
