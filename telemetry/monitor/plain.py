"""`dbw monitor` without a screen: candump's columns, and what the frame means behind them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from canbus.candump import NS_PER_US, US_PER_S, columns, log_line
from canbus.heard import Heard
from dbc.protection import USABLE
from telemetry.monitor.known import Known
from telemetry.monitor.meaning import Interpreter, Meaning
from telemetry.monitor.protection import Protection
from telemetry.monitor.selection import Selection
from telemetry.monitor.style import BAD, DIM, GOOD, MESSAGE, PLAIN, Span, plain_text, printable

COLUMNS_WIDTH: Final = 36
"""Of identifier, length and eight bytes; what a longer frame means follows behind it."""
PROTECTIONS_MAX: Final = 4096
NS_PER_S: Final = 1_000_000_000


class Stamp(Enum):
    """Kinds of time, by candump's letters."""

    NONE = "n"
    ABSOLUTE = "a"
    DELTA = "d"
    ZERO = "z"
    DATE = "A"


@dataclass(slots=True)
class StampWriter:
    """Writes times as candump's `-t` does.

    Delta and relative times of frames that come out of order, or after the system's clock was set
    back, are negative.

    Attributes:
        kind: Which time.
        local_text: Date and time of day of whole seconds since 1970.
    """

    kind: Stamp
    local_text: Callable[[int], str] = str
    _first_ns: int | None = None
    _last_ns: int = 0

    def text(self, time_ns: int) -> str:
        """The stamp of the next frame shown, with candump's width and brackets."""
        if self.kind is Stamp.NONE:
            return ""
        if self._first_ns is None:
            self._first_ns = self._last_ns = time_ns
        if self.kind is Stamp.DATE:
            when = self.local_text(time_ns // NS_PER_S)
            return f"({when}.{time_ns % NS_PER_S // NS_PER_US:06d})"
        start_ns = {Stamp.DELTA: self._last_ns, Stamp.ZERO: self._first_ns}.get(self.kind, 0)
        self._last_ns = time_ns
        us = time_ns // NS_PER_US - start_ns // NS_PER_US
        sign, us = ("-", -us) if us < 0 else ("", us)
        width = 10 if self.kind is Stamp.ABSOLUTE else 3
        return f"({sign}{us // US_PER_S:0{width}d}.{us % US_PER_S:06d})"


@dataclass(slots=True)
class LineWriter:
    """Writes lines of frames.

    Attributes:
        interpreter: Finds their meaning.
        selection: Which of them to show.
        stamps: Their times.
        channel_width: Of the longest channel's name.
        with_meaning: False for candump's own line and no more.
        as_log: As `candump -L`, without meaning.
    """

    interpreter: Interpreter
    selection: Selection
    stamps: StampWriter
    channel_width: int = 0
    with_meaning: bool = True
    as_log: bool = False
    _protections: dict[tuple[str, int], Protection] = field(default_factory=dict)

    def line(self, heard: Heard) -> list[Span] | None:
        """The line of a frame as spans of styled text; None if it is not to be shown."""
        known = self.interpreter.known(heard)
        if not self.selection.passes(heard, known):
            return None
        if self.as_log:
            return [Span(log_line(heard), PLAIN)]
        protection = self._protection(heard, known)
        stamp = self.stamps.text(heard.time_ns)
        self.channel_width = max(self.channel_width, len(heard.channel))
        head = f" {stamp} " if stamp else " "
        spans = [
            Span(head, DIM),
            Span(f" {printable(heard.channel):>{self.channel_width}}  ", PLAIN),
        ]
        if not self.with_meaning:
            tail = self._candump_tail(heard)
            return [*spans, Span(columns(heard) + tail, BAD if heard.is_error else PLAIN)]
        meaning = self.interpreter.meaning(heard, known)
        shown = columns(heard)
        if meaning.title or meaning.words:
            shown = f"{shown:<{COLUMNS_WIDTH}}  "
        spans.append(Span(shown, BAD if heard.is_error else PLAIN))
        return spans + self._meaning_spans(meaning, protection)

    def text(self, heard: Heard) -> str | None:
        """The same without styles."""
        spans = self.line(heard)
        return None if spans is None else plain_text(spans).rstrip()

    @staticmethod
    def _candump_tail(heard: Heard) -> str:
        return " " * (3 * (8 - heard.length) + 3) + "ERRORFRAME" if heard.is_error else ""

    def _protection(self, heard: Heard, known: Known | None) -> Protection | None:
        if known is None or known.data_id is None or heard.is_remote:
            return None
        key = heard.channel, heard.word
        protection = self._protections.get(key)
        if protection is None:
            if len(self._protections) >= PROTECTIONS_MAX:
                self._protections.clear()
            protection = self._protections[key] = Protection(known.data_id)
        protection.take(heard.data)
        return protection

    def _meaning_spans(self, meaning: Meaning, protection: Protection | None) -> list[Span]:
        spans = [Span(meaning.title, BAD if meaning.is_bad else MESSAGE)] if meaning.title else []
        if protection is not None:
            is_good = protection.state in USABLE or protection.is_first
            spans.append(Span(f" ({protection.text()})", GOOD if is_good else BAD))
        gap = "  " if spans else ""
        if meaning.words:
            spans.append(Span(gap + meaning.words, BAD if meaning.is_bad else PLAIN))
        fault = meaning.content.fault
        if fault and (protection is None or protection.counter is not None):
            spans.append(Span(gap + fault, BAD))
        only = self.selection.signals
        values = [
            f"{value.name}={value.text()}"
            for value in meaning.content.values
            if not only or value.name in only
        ]
        if values:
            spans.append(Span(gap + ", ".join(values), PLAIN))
        return spans
