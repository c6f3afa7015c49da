"""The page itself: one HTML file, nothing loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from telemetry.bus_docs.model import BusDoc
from telemetry.bus_docs.own import ParameterRow
from telemetry.pages import page_template

COLOURS = ("#cfe3f3", "#f7d9c4", "#cdebdc", "#f3e3b3", "#e6d6ee", "#d9e2a8", "#f5ccd4", "#cfdadf")
"""Of signals in a layout picture, in turn; light enough for black text."""


def page_of(
    bus: BusDoc,
    words: Mapping[str, Mapping[int, str]] | None = None,
    parameters: Mapping[str, Sequence[ParameterRow]] | None = None,
) -> str:
    """The page as text.

    Args:
        bus: What it is about.
        words: By value table and number, what a code means; None: nothing is known.
        parameters: By node, what can be read and written by SDO.
    """
    filters = {"ms": milliseconds, "percent": percent}
    return page_template("telemetry.bus_docs", "bus.html.j2", filters).render(
        bus=bus, colours=COLOURS, words=words or {}, parameters=parameters or {}
    )


def milliseconds(value: float | None) -> str:
    """A time in ms; a dash for none."""
    return "-" if value is None else f"{value:.2f}".rstrip("0").rstrip(".")


def percent(share: float) -> str:
    """A share with one digit behind the point."""
    return f"{100.0 * share:.1f} %"
