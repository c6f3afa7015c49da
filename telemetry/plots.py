"""The two pictures of a drive: the path with its error, and the signals. Agg, no window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from dbc.messages import Mode
from telemetry.signals import CODES, CodeSpan, ModeSpan, NamedSpan, Signals, Span, Staged, Trace

FloatArray = NDArray[np.float64]

DPI = 150
WIDTH_IN = 13.0
DETAIL_IN = 3.6
"""Height of the lower row of `path.png`."""
CLOSER_M = 14.0
"""Half the width of the closer look."""
INK = "#222222"
MUTED = "#6b6b6b"
ROAD = "#e4e4e4"
EDGE = "#8c8c8c"
# Okabe and Ito: told apart with every kind of colour vision.
BLUE, ORANGE, GREEN, VERMILLION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, YELLOW = "#56B4E9", "#F0E442"

MODE_COLOURS = {
    Mode.INIT: "#bbbbbb",
    Mode.MANUAL: SKY,
    Mode.READY: YELLOW,
    Mode.AUTOMATIC: GREEN,
    Mode.STOPPING: ORANGE,
    Mode.EMERGENCY: VERMILLION,
}
LABEL_SHARE_MIN = 0.08
"""A span narrower than this share of the axis gets no text of its own: the legend names it."""

FAULT_IN = 0.24
"""Height of a fault's row in `signals.png`."""
SHORTEST_SHARE = 0.003
"""A fault shorter than this share of the axis is drawn as long."""

STYLE: dict[Any, Any] = {
    "font.size": 11,
    "axes.titlesize": 13,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "text.color": INK,
    "legend.frameon": False,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathPicture:
    """What `path.png` shows. Positions of shape (N, 2), each its own N."""

    title: str
    left_edge_xy_m: FloatArray
    """Of the road, a closed loop without the first point repeated."""
    right_edge_xy_m: FloatArray
    planned_xy_m: FloatArray
    """As the edges."""
    driven_xy_m: FloatArray
    """True path, shape (M, 2); empty if the car never moved."""
    error_m: FloatArray
    """Distance of each driven point from the planned line, left positive, shape (M,)."""
    progress_m: FloatArray
    """Place of each driven point along the planned line, shape (M,)."""


def plot_path(file: FilePath, picture: PathPicture) -> None:
    """Draws the road and the path driven, coloured by its distance from the planned line.

    Below: a closer look at the place of the largest error, and the error along the way.
    """
    with rc_context(STYLE):
        edges = np.vstack([picture.left_edge_xy_m, picture.right_edge_xy_m])
        height_in = _map_height_in(edges)
        figure = Figure(figsize=(WIDTH_IN, height_in + DETAIL_IN), layout="constrained")
        grid = figure.add_gridspec(
            2, 2, height_ratios=[height_in, DETAIL_IN], width_ratios=[1.0, 1.6]
        )
        whole: Any = figure.add_subplot(grid[0, :])
        closer: Any = figure.add_subplot(grid[1, 0])
        along: Any = figure.add_subplot(grid[1, 1])
        for axes, plan_zorder in ((whole, 2), (closer, 4)):  # the path itself is at 3
            _draw_road(axes, picture, plan_zorder)
            axes.set_aspect("equal")
            axes.set_xlabel("x, m")
            axes.set_ylabel("y, m")
        whole.set_title(picture.title, loc="left")
        along.set_xlabel("way along the planned line, m")
        along.set_ylabel("error, cm (left +)")
        along.grid(color="#eeeeee")
        if len(picture.driven_xy_m) >= 2:
            line = _draw_driven(whole, picture, width=2.6)
            _draw_driven(closer, picture, width=3.6)
            _draw_landmarks(whole, picture)
            _look_closer(closer, picture)
            _draw_along(along, picture)
            bar = figure.colorbar(line, ax=whole, pad=0.01, aspect=12, shrink=0.9)
            bar.set_label("distance from\nplanned line, cm")
            bar.outline.set_visible(False)
        save(figure, file)


def _map_height_in(xy_m: FloatArray) -> float:
    """Inches that a map of equal axes needs at full width, title and labels included."""
    width_m, height_m = np.ptp(xy_m, axis=0)
    share = height_m / max(width_m, 1.0)
    return float(min(max((WIDTH_IN - 2.2) * 1.1 * share + 0.9, 2.4), 11.0))


def _draw_road(axes: Any, picture: PathPicture, plan_zorder: int) -> None:
    left, right, planned = (
        np.vstack([edge, edge[:1]])
        for edge in (picture.left_edge_xy_m, picture.right_edge_xy_m, picture.planned_xy_m)
    )
    quads: Any = np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)
    axes.add_collection(PolyCollection(quads, facecolors=ROAD, edgecolors=ROAD, linewidths=0.3))
    for edge in (left, right):
        axes.plot(edge[:, 0], edge[:, 1], color=EDGE, linewidth=0.7, solid_joinstyle="round")
    axes.plot(
        planned[:, 0], planned[:, 1], color=INK, linewidth=0.8, linestyle=(0, (5, 3)),
        zorder=plan_zorder, label="planned line",
    )  # fmt: skip


def _draw_driven(axes: Any, picture: PathPicture, width: float) -> LineCollection:
    points = picture.driven_xy_m
    error_cm = 100.0 * np.abs(picture.error_m)
    segments: Any = np.stack([points[:-1], points[1:]], axis=1)
    line = LineCollection(segments, cmap="plasma_r", linewidths=width, capstyle="round", zorder=3)
    line.set_array(np.maximum(error_cm[:-1], error_cm[1:]))
    line.set_clim(0.0, max(1.0, float(error_cm.max())))
    axes.add_collection(line)
    return line


def _draw_landmarks(axes: Any, picture: PathPicture) -> None:
    """Start with its direction, and the place of the largest error."""
    points = picture.driven_xy_m
    worst = int(np.abs(picture.error_m).argmax())
    axes.plot(
        *points[worst], "o", markersize=14, markerfacecolor="none", markeredgecolor=INK,
        markeredgewidth=1.3, zorder=6, linestyle="none", label="largest error",
    )  # fmt: skip
    ahead = picture.planned_xy_m[1] - picture.planned_xy_m[0]
    angle_deg = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
    axes.plot(
        *points[0], marker=(3, 0, angle_deg - 90.0), markersize=13, color=GREEN,
        markeredgecolor="white", zorder=5, linestyle="none", label="start",
    )  # fmt: skip
    axes.legend(loc="best", fontsize=10)


def _look_closer(axes: Any, picture: PathPicture) -> None:
    """The surroundings of the largest error."""
    worst = int(np.abs(picture.error_m).argmax())
    x_m, y_m = picture.driven_xy_m[worst]
    axes.set_xlim(x_m - CLOSER_M, x_m + CLOSER_M)
    axes.set_ylim(y_m - 0.62 * CLOSER_M, y_m + 0.62 * CLOSER_M)
    error_cm = 100.0 * abs(picture.error_m[worst])
    axes.set_title(f"closer: largest error, {error_cm:.1f} cm", loc="left", fontsize=11)


def _draw_along(axes: Any, picture: PathPicture) -> None:
    error_cm = 100.0 * picture.error_m
    worst = int(np.abs(error_cm).argmax())
    axes.fill_between(picture.progress_m, error_cm, color=SKY, alpha=0.5, linewidth=0.0)
    axes.plot(picture.progress_m, error_cm, color=BLUE, linewidth=1.2)
    axes.plot(picture.progress_m[worst], error_cm[worst], "o", markersize=10,
              markerfacecolor="none", markeredgecolor=INK)  # fmt: skip
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    axes.set_xlim(float(picture.progress_m.min()), float(picture.progress_m.max()))


def plot_signals(
    file: FilePath, *, title: str, signals: Signals, staged: Staged | None = None
) -> None:
    """Draws setpoint against measured for steering, speed and brake; modes and codes below.

    Args:
        file: The PNG to write.
        title: One line above it.
        signals: Decoded from the bus.
        staged: The true speed, and faults as bars in rows of their own, at the bottom.
    """
    rows_in = [2.7, 2.7, 1.8, 0.6, 1.2]
    if staged is not None:
        rows_in.append(FAULT_IN * max(2, len({span.name for span in staged.faults})))
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, sum(rows_in)), layout="constrained")
        grid = figure.add_gridspec(len(rows_in), 1, height_ratios=rows_in)
        first: Any = figure.add_subplot(grid[0])
        others = [figure.add_subplot(grid[n], sharex=first) for n in range(1, len(rows_in))]
        axes: list[Any] = [first, *others]
        _draw_trace(axes[0], signals.steering_rad, 180.0 / np.pi, "steering wheel,\ndeg (left +)")
        _draw_trace(axes[1], signals.speed_mps, 1.0, "speed, m/s")
        _draw_trace(axes[2], signals.brake_ratio, 100.0, "brake servo, %")
        axes[2].set_ylim(-5.0, 105.0)
        draw_modes(axes[3], signals.modes, signals.end_s)
        draw_codes(axes[4], signals.codes)
        for axis in axes[:-1]:
            axis.tick_params(labelbottom=False)
        axes[0].legend(loc="lower right", ncols=2, bbox_to_anchor=(1.0, 1.0))
        axes[0].set_xlim(0.0, max(1.0, signals.end_s))
        if staged is not None:
            _draw_true_speed(axes[1], staged)
            _draw_faults(axes[5], staged.faults)
        axes[-1].set_xlabel("time since power-on, s")
        axes[0].set_title(title, loc="left")
        figure.align_ylabels(axes[:5])  # the names of faults are long
        save(figure, file)


def _draw_trace(axes: Any, trace: Trace, scale: float, label: str) -> None:
    axes.plot(trace.time_s, scale * trace.measured, color=BLUE, linewidth=1.3, label="measured")
    axes.plot(
        trace.time_s, scale * trace.setpoint, color=VERMILLION, linewidth=1.0,
        linestyle=(0, (4, 2)), label="setpoint in force",
    )  # fmt: skip
    axes.set_ylabel(label)
    axes.grid(color="#eeeeee")
    axes.set_axisbelow(True)


def _draw_band(axes: Any, span: Span, low: float, height: float, colour: str) -> None:
    width_s = max(span.end_s - span.start_s, 0.05)  # or a moment would not be seen
    axes.broken_barh([(span.start_s, width_s)], (low, height), facecolors=colour)


def draw_modes(axes: Any, modes: Sequence[ModeSpan], width_s: float) -> None:
    """A row of modes; `width_s` is what the axis spans: short ones are named by a legend."""
    unnamed: dict[Mode, Patch] = {}
    for span in modes:
        colour = MODE_COLOURS[span.mode]
        _draw_band(axes, span, 0.0, 1.0, colour)
        if span.end_s - span.start_s >= LABEL_SHARE_MIN * width_s:
            middle_s = 0.5 * (span.start_s + span.end_s)
            axes.text(middle_s, 0.48, span.mode.name, ha="center", va="center", fontsize=10)
        else:
            unnamed[span.mode] = Patch(color=colour, label=span.mode.name)
    if unnamed:
        axes.legend(
            handles=list(unnamed.values()), loc="lower right", bbox_to_anchor=(1.0, 0.95),
            ncols=len(unnamed), fontsize=9, handlelength=1.0, borderpad=0.0,
        )  # fmt: skip
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.set_ylabel("mode", rotation=0, ha="right", va="center")


def draw_codes(axes: Any, codes: Sequence[CodeSpan]) -> None:
    """A row for each code."""
    for span in codes:
        _draw_band(axes, span, span.code.value - 0.4, 0.8, VERMILLION)
    if not codes:
        axes.text(
            0.5, 0.5, "no error code", transform=axes.transAxes, ha="center", va="center",
            color=MUTED, fontsize=10,
        )  # fmt: skip
    axes.set_ylim(len(CODES) - 0.5, -0.5)
    axes.set_yticks(range(len(CODES)), [code.name for code in CODES], fontsize=8)
    axes.grid(axis="y", color="#eeeeee")
    axes.set_axisbelow(True)
    axes.set_ylabel("codes", rotation=0, ha="right", va="center")


def _draw_true_speed(axes: Any, staged: Staged) -> None:
    (line,) = axes.plot(staged.time_s, staged.true_speed_mps, color=INK, linewidth=0.8)
    axes.legend([line], ["true"], loc="lower right", bbox_to_anchor=(1.0, 0.95), fontsize=9)


def _draw_faults(axes: Any, faults: tuple[NamedSpan, ...]) -> None:
    names = list(dict.fromkeys(span.name for span in faults))
    shortest_s = SHORTEST_SHARE * axes.get_xlim()[1]
    for span in faults:
        seen = replace(span, end_s=max(span.end_s, span.start_s + shortest_s))
        _draw_band(axes, seen, names.index(span.name) - 0.4, 0.8, ORANGE)
    axes.set_ylim(max(len(names), 1) - 0.5, -0.5)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.grid(axis="y", color="#eeeeee")
    axes.set_axisbelow(True)
    axes.set_title("faults", loc="left", fontsize=11)


def save(figure: Figure, file: FilePath) -> None:
    """Writes the PNG."""
    FigureCanvasAgg(figure)  # the figure's own reference keeps it
    figure.savefig(file, dpi=DPI, format="png", facecolor="white")
