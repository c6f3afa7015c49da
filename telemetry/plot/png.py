"""A plot as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib import rc_context
from matplotlib.figure import Figure

from dbc.messages import Mode
from telemetry.plot.model import Panel, Plot, thinned
from telemetry.plots import (
    BLUE,
    GREEN,
    INK,
    MODE_COLOURS,
    MUTED,
    ORANGE,
    SKY,
    STYLE,
    VERMILLION,
    WIDTH_IN,
    draw_codes,
    draw_modes,
    save,
)

LINE_COLOURS: Final = (BLUE, VERMILLION, GREEN, ORANGE, SKY, INK)
PANEL_IN: Final = 2.4
NAME_IN: Final = 0.28
"""Height of one name in a panel whose values have them."""
MODES_IN: Final = 0.6
CODES_IN: Final = 1.2
BAND_ALPHA: Final = 0.10
"""Of the modes behind the lines; their own row below has the full colour."""


def write_png(file: Path, plot: Plot) -> None:
    """Draws it."""
    rows_in = [
        max(3, len(panel.names) + 1) * NAME_IN if panel.names else PANEL_IN for panel in plot.panels
    ]
    count = len(rows_in)
    if plot.modes is not None:
        rows_in += [MODES_IN, CODES_IN]
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, sum(rows_in) + 0.6), layout="constrained")
        grid = figure.add_gridspec(len(rows_in), 1, height_ratios=rows_in)
        first: Any = figure.add_subplot(grid[0])
        axes: list[Any] = [
            first, *(figure.add_subplot(grid[n], sharex=first) for n in range(1, len(rows_in)))
        ]  # fmt: skip
        for axis, panel in zip(axes, plot.panels, strict=False):
            _draw_panel(axis, panel, plot)
        if plot.modes is not None:
            draw_modes(axes[count], plot.modes, plot.end_s - plot.begin_s)
            draw_codes(axes[count + 1], plot.codes)
        for axis in axes[:-1]:
            axis.tick_params(labelbottom=False)
        first.set_xlim(plot.begin_s, max(plot.end_s, plot.begin_s + 1e-3))
        first.set_title(plot.title, loc="left", pad=28)
        axes[-1].set_xlabel("time, s")
        figure.align_ylabels(axes)
        save(figure, file)


def _draw_panel(axes: Any, panel: Panel, plot: Plot) -> None:
    for span in plot.modes or ():
        if span.mode is not Mode.MANUAL:
            colour = MODE_COLOURS[span.mode]
            axes.axvspan(span.start_s, span.end_s, color=colour, alpha=BAND_ALPHA, linewidth=0.0)
    for number, line in enumerate(panel.lines):
        time_s, value = thinned(line)
        axes.plot(
            time_s, value, drawstyle="steps-post", linewidth=1.2,
            color=LINE_COLOURS[number % len(LINE_COLOURS)], label=line.label,
        )  # fmt: skip
    if panel.names:
        _draw_names(axes, panel.names)
    axes.set_ylabel(panel.unit)
    axes.grid(color="#eeeeee")
    axes.set_axisbelow(True)
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=9, borderpad=0.2,
        handlelength=1.4,
    )  # fmt: skip


def _draw_names(axes: Any, names: Sequence[str]) -> None:
    """Each name above its own line; beside the axis long ones would take the room of all panels."""
    for place, name in enumerate(names):
        axes.annotate(
            name, (0.0, place), xycoords=("axes fraction", "data"), xytext=(4, 2),
            textcoords="offset points", fontsize=8, color=MUTED,
        )  # fmt: skip
    axes.set_yticks(range(len(names)), [""] * len(names))
    axes.set_ylim(-0.4, len(names) - 0.1)
