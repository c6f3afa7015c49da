"""What a person has chosen to see on the screen, and the keys that choose it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

from canbus.heard import EXTENDED_ID_MAX
from telemetry.monitor.known import Known
from telemetry.monitor.model import BusModel, Presence, Row
from telemetry.monitor.selection import Selection


class Sort(Enum):
    """Orders of the rows."""

    IDENTIFIER = "id"
    NAME = "name"
    SENDER = "node"
    RATE = "rate"
    TROUBLE = "trouble"


_SORTS: Final = tuple(Sort)
_TROUBLE: Final = (Presence.MISSING, Presence.LATE, Presence.ALIVE, Presence.EVENT)

HELP: Final = (
    "q       end",
    "/       filter: part of an identifier, message, node or signal; Enter keeps, Esc clears it",
    "s       sort by id, name, node, rate, trouble first",
    "space   pause the picture; what comes is still counted",
    "up/down choose a row (also j, k, PgUp, PgDn, Home, End)",
    "g       plot the chosen row's next signal; Esc ends it",
    "r       forget faults, gaps, and the largest load",
    "m       hide or show messages that are missing",
    "h       this help",
)


@dataclass(slots=True)
class View:
    """Chosen by keys; knows nothing of a terminal.

    Attributes:
        selection: What the command line chose.
        sort: Order of the rows.
        filter: Text that a row must contain.
        is_typing: Whether keys go into the filter.
        is_paused: Whether the picture stands still.
        with_help: Whether the keys are explained.
        with_missing: Whether messages that never came, or no more, are shown.
        chosen: Channel and identifier of the chosen row.
        is_ended: Whether the screen is to end.
    """

    selection: Selection
    sort: Sort = Sort.IDENTIFIER
    filter: str = ""
    is_typing: bool = False
    is_paused: bool = False
    with_help: bool = False
    with_missing: bool = True
    chosen: tuple[str, int] | None = None
    is_ended: bool = False
    page: int = 10

    def rows(self, model: BusModel, now_ns: int) -> list[Row]:
        """The rows to be shown, in order."""
        rows = [
            row for row in model.rows.values()
            if self._passes(row)
            and (self.with_missing or row.presence(now_ns) is not Presence.MISSING)
        ]  # fmt: skip
        rows.sort(key=lambda row: (row.word & EXTENDED_ID_MAX, row.word, row.channel))
        if self.sort is Sort.NAME:
            rows.sort(key=lambda row: (not row.name, row.name))
        elif self.sort is Sort.SENDER:
            rows.sort(key=lambda row: (sender(row.known) == "", sender(row.known)))
        elif self.sort is Sort.RATE:
            rows.sort(key=lambda row: -round(row.rate_hz))
        elif self.sort is Sort.TROUBLE:
            rows.sort(key=lambda row: _TROUBLE.index(row.presence(now_ns)))
            rows.sort(key=lambda row: -row.protection.faults if row.protection else 0)
        return rows

    def _passes(self, row: Row) -> bool:
        known = row.known
        if not self.selection.wants(row.channel, row.word, known):
            return False
        wanted = self.filter.lower()
        if not wanted:
            return True
        signals = known.signals if known is not None else ()
        texts = (f"{row.word & EXTENDED_ID_MAX:03x}", row.name, sender(known), row.channel)
        return any(wanted in text.lower() for text in (*texts, *signals))

    def press(self, key: str, model: BusModel, now_ns: int) -> None:
        """Obeys a key: a character, or the name of a special one. Unknown keys do nothing."""
        if self.is_typing:
            self._type(key)
        elif key in ("up", "down", "pgup", "pgdn", "home", "end", "j", "k"):
            self._move(key, model, now_ns)
        elif key == "q":
            self.is_ended = True
        elif key == "/":
            self.is_typing = True
        elif key == " ":
            self.is_paused = not self.is_paused
        elif key == "s":
            self.sort = _SORTS[(_SORTS.index(self.sort) + 1) % len(_SORTS)]
        elif key == "m":
            self.with_missing = not self.with_missing
        elif key == "r":
            model.reset()
        elif key == "g":
            self._plot_next(model, now_ns)
        elif key in ("h", "?"):
            self.with_help = not self.with_help
        elif key == "esc":
            self._leave(model)

    def _type(self, key: str) -> None:
        if key == "esc":
            self.filter, self.is_typing = "", False
        elif key == "enter":
            self.is_typing = False
        elif key == "backspace":
            self.filter = self.filter[:-1]
        elif len(key) == 1 and key.isprintable():
            self.filter += key

    def _leave(self, model: BusModel) -> None:
        """Esc: help first, then the plot, then the filter."""
        if self.with_help:
            self.with_help = False
        elif model.plotted is not None:
            model.plot(None)
        else:
            self.filter = ""

    def _move(self, key: str, model: BusModel, now_ns: int) -> None:
        keys = [(row.channel, row.word) for row in self.rows(model, now_ns)]
        if not keys:
            return
        steps = {"up": -1, "k": -1, "down": 1, "j": 1, "pgup": -self.page, "pgdn": self.page,
                 "home": -len(keys), "end": len(keys)}  # fmt: skip
        place = keys.index(self.chosen) + steps[key] if self.chosen in keys else 0
        self.chosen = keys[max(0, min(place, len(keys) - 1))]

    def _plot_next(self, model: BusModel, now_ns: int) -> None:
        """The chosen row's next signal; after the last one, none."""
        rows = self.rows(model, now_ns)
        row = next((row for row in rows if (row.channel, row.word) == self.chosen), None)
        if row is None or row.known is None or not row.known.signals:
            model.plot(None)
            return
        signals = row.known.signals
        place = 0
        if model.plotted is not None and model.plotted[0] is row:
            place = signals.index(model.plotted[1]) + 1
        if place < len(signals):
            model.plot(row, signals[place])
        else:
            model.plot(None)


def sender(known: Known | None) -> str:
    """Who sends a message; empty if nobody knows."""
    return "" if known is None else known.sender or ""
