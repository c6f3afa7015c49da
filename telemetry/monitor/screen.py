"""The screen of `dbw monitor --live` as lines of styled text."""

from __future__ import annotations

from typing import Final

from canbus.candump import id_text
from canbus.heard import ERROR_FLAG, REMOTE_FLAG
from dbc.protection import USABLE
from telemetry.monitor.braille import curve
from telemetry.monitor.health import NONE, NodeHealth, car_health, node_health
from telemetry.monitor.known import SignalValue
from telemetry.monitor.model import NS_PER_MS, NS_PER_S, BusModel, Presence, Row
from telemetry.monitor.style import (
    BAD,
    BOLD,
    CHANGED,
    CHOSEN,
    DIM,
    GOOD,
    MESSAGE,
    PLAIN,
    TITLE,
    WARN,
    Span,
    Style,
    fitted,
    printable,
)
from telemetry.monitor.view import HELP, View, sender

Line = list[Span]

CHANGED_NS: Final = 400_000_000
"""How long a byte that changed is marked."""
PLOT_HEIGHT: Final = 6
PLOT_SPAN_NS: Final = 20 * NS_PER_S
PLOT_LABEL: Final = 12
ROWS_MIN: Final = 3
NAME_WIDTH_MAX: Final = 30
COUNTER_WIDTH: Final = len("14 out of sequence")
WIDE: Final = 120
"""Cells from which on all columns are shown."""
DATA_BYTES_SHOWN: Final = 8
DATA_WIDTH: Final = 3 * DATA_BYTES_SHOWN
_STYLE: Final = {
    Presence.ALIVE: GOOD,
    Presence.LATE: WARN,
    Presence.MISSING: BAD,
    Presence.EVENT: DIM,
}
KEYS: Final = "q end  / filter  s sort  space pause  arrows choose  g plot  r reset  h help"


class Screen:
    """Draws a model as a view wants it.

    Args:
        model: What is going on.
        view: What to show of it.
        bitrate_bps: Of the bus, for its load.
    """

    def __init__(self, model: BusModel, view: View, bitrate_bps: int) -> None:
        self._model = model
        self._view = view
        self._bitrate_bps = bitrate_bps
        self._top = 0
        self._frozen: list[Line] | None = None

    def lines(
        self, width: int, height: int, now_ns: int, *, lost: int = 0, note: str = ""
    ) -> list[Line]:
        """As many lines as the terminal has; each at most as long as it is wide.

        Args:
            width: Of the terminal, in cells.
            height: Of the terminal, in lines.
            now_ns: Monotonic time.
            lost: Frames that the kernel has thrown away.
            note: What happened to a channel.
        """
        self._model.tick(now_ns)
        body = self._frozen
        if body is None or not self._view.is_paused:
            top = self._bus_lines(lost)
            top += [[Span(note, WARN)]] if note else []
            body = self._body(top, width, max(0, height - 1), now_ns)
        self._frozen = body if self._view.is_paused else None
        lines = [fitted(line, width) for line in body[: height - 1]]
        lines += [[] for _ in range(height - 1 - len(lines))]
        return [*lines, fitted(self._last_line(), width)]

    def _body(self, top: list[Line], width: int, height: int, now_ns: int) -> list[Line]:
        if self._view.with_help:
            return [[Span("Keys", BOLD)], *([Span(text, PLAIN)] for text in HELP)]
        head = [*top, *self._car_lines(now_ns, width)]
        plot = self._plot_lines(width, now_ns) if height >= len(head) + 2 * PLOT_HEIGHT else []
        detail = self._detail_lines(width)
        room = max(ROWS_MIN, height - len(head) - len(plot) - len(detail) - 1)
        table = self._table(room, width, now_ns)
        return [*head, *table[: room + 1], *detail, *plot]

    def _bus_lines(self, lost: int) -> list[Line]:
        lines = []
        for name, channel in sorted(self._model.channels.items()):
            load = channel.bits_per_s / self._bitrate_bps
            most = channel.bits_per_s_max / self._bitrate_bps
            line = [
                Span(f"{printable(name):<8} ", BOLD),
                Span(f"load {load:6.1%}", BAD if load > 0.9 else WARN if load > 0.6 else PLAIN),
                Span(f"  most {most:6.1%}  of {self._bitrate_bps // 1000} kbit/s  ", DIM),
                Span(f"{channel.frames_per_s:6.0f} frames/s", PLAIN),
                Span(f"  {channel.errors} error frames", BAD if channel.errors else DIM),
            ]
            if channel.fd_frames:
                line.append(Span(f"  {channel.fd_frames} FD frames, not in load", DIM))
            lines.append(line)
        if lost or self._model.unlisted:
            lines.append([
                Span(f"{lost} frames lost, not read in time", BAD if lost else DIM),
                Span(f"  {self._model.unlisted} frames without a row", DIM),
            ])  # fmt: skip
        return lines

    def _car_lines(self, now_ns: int, width: int) -> list[Line]:
        lines: list[Line] = []
        car = car_health(self._model, now_ns)
        if car is not None:
            good = car.mode == "AUTOMATIC"
            bad = car.mode in ("EMERGENCY", "?")
            lines.append([
                Span("mode ", DIM), Span(car.mode, BAD if bad else GOOD if good else BOLD),
                *_because(car.inhibit),
                Span("   verdict ", DIM),
                Span(car.verdict, GOOD if car.verdict == "PERMIT" else BAD),
                *_because(car.verdict_reason),
                Span("   codes ", DIM),
                Span(" ".join(car.codes) or "none", BAD if car.codes else PLAIN),
            ])  # fmt: skip
        return [*lines, *_wrapped([_node_line(n) for n in node_health(self._model, now_ns)], width)]

    def _detail_lines(self, width: int) -> list[Line]:
        """Of the chosen row all that its newest frame says, and all its bytes."""
        row = self._model.rows.get(self._view.chosen) if self._view.chosen else None
        if row is None or row.heard is None:
            return []
        meaning = self._model.interpreter.meaning(row.heard, row.known)
        by = sender(row.known)
        items = [[Span(row.name or id_text(row.word), BOLD), Span(f" of {by}" if by else "", DIM)]]
        items += [
            [Span(f"{value.name}=", DIM), Span(value.text(), PLAIN)]
            for value in meaning.content.values
        ]
        said = meaning.words or meaning.content.fault
        items += [[Span(said, BAD if meaning.is_bad else PLAIN)]] if said else []
        data = row.heard.data.hex(" ").upper()
        items += [[Span(data[at : at + 48], DIM)] for at in range(0, len(data), 48)]
        return _wrapped(items, width)

    def _table(self, room: int, width: int, now_ns: int) -> list[Line]:
        is_wide = width >= WIDE
        view = self._view
        rows = view.rows(self._model, now_ns)
        view.page = max(1, room - 1)
        keys = [(row.channel, row.word) for row in rows]
        place = keys.index(view.chosen) if view.chosen in keys else 0
        self._top = max(0, min(self._top, place, len(rows) - room))
        self._top = max(self._top, place - room + 1)
        shown = rows[self._top : self._top + room]
        names = [self._title(row) for row in shown]
        name_width = min(NAME_WIDTH_MAX, max([12, *map(len, names)]))
        channel_width = max([0, *(len(name) + 1 for name in self._model.channels)])
        if len(self._model.channels) < 2:
            channel_width = 0
        header = (
            f"{'':{channel_width}}{'ID':>8} {'MESSAGE':<{name_width}} {'STATE':<7} "
            f"{'AGE ms':>7} {'RATE':>6}{'/DBC':<5} "
        )
        more = f"{'GAP ms':>7} {'COUNTER':<{COUNTER_WIDTH}} {'BAD':>4} {'DATA':<{DATA_WIDTH}} "
        header += more if is_wide else f"{'COUNTER':<{COUNTER_WIDTH}} "
        lines = [[Span(f"{header + 'VALUES':<{width}}", TITLE)]]
        for row, name in zip(shown, names, strict=True):
            title = Span(f"{printable(row.channel):<{channel_width}}" if channel_width else "", DIM)
            lines.append([title, *self._row_spans(row, name, name_width, is_wide, now_ns)])
        return lines

    def _title(self, row: Row) -> str:
        if row.word & ERROR_FLAG:
            return "ERRORFRAME"
        return row.name + " (remote)" * bool(row.word & REMOTE_FLAG)

    def _row_spans(
        self, row: Row, name: str, name_width: int, is_wide: bool, now_ns: int
    ) -> Line:
        presence = row.presence(now_ns)
        is_chosen = (row.channel, row.word) == self._view.chosen
        is_gone = presence is Presence.MISSING
        quiet: Style = DIM if is_gone else PLAIN
        name_style = BAD if row.word & ERROR_FLAG else DIM if is_gone else MESSAGE
        age = f"{(now_ns - row.newest_ns) / NS_PER_MS:7.0f}" if row.count else f"{'-':>7}"
        cycle_ns = row.known.cycle_ns if row.known is not None and row.missing_after_ns else 0
        spans = [
            Span(f"{id_text(row.word):>8} ", CHOSEN if is_chosen else quiet),
            Span(f"{name[:name_width]:<{name_width}} ", name_style),
            Span(f"{presence.value:<7} ", _STYLE[presence]),
            Span(f"{age} {row.rate_hz:6.1f}", quiet),
            Span(f"/{NS_PER_S / cycle_ns:<4.0f} " if cycle_ns else f"{'':6}", DIM),
        ]
        if is_wide:
            gap = f"{row.gap_ns_max / NS_PER_MS:7.0f}" if row.count > 1 else f"{'-':>7}"
            spans.append(Span(f"{gap} ", BAD if row.timeouts else quiet))
        spans += _verdict(row, quiet, is_wide)
        if is_wide:
            spans += _data(row, now_ns, quiet)
        return spans + self._values(row, quiet)

    def _values(self, row: Row, quiet: Style) -> Line:
        """What the newest frame says; flags that are not set are left out."""
        if row.heard is None:
            return []
        meaning = self._model.interpreter.meaning(row.heard, row.known)
        if meaning.content.fault:
            return [Span(meaning.content.fault, BAD)]
        if meaning.words:
            return [Span(meaning.words, BAD if meaning.is_bad else quiet)]
        only = self._view.selection.signals
        texts = [
            _short(value) for value in meaning.content.values if not only or value.name in only
        ]
        return [Span("  ".join(text for text in texts if text), quiet)]

    def _plot_lines(self, width: int, now_ns: int) -> list[Line]:
        if self._model.plotted is None:
            return []
        row, signal = self._model.plotted
        start_ns = now_ns - PLOT_SPAN_NS
        points = [(t, y) for t, y in self._model.samples if t >= start_ns]
        finite = [y for _, y in points if y == y]
        low, high = (min(finite), max(finite)) if finite else (0.0, 0.0)
        title = f"{row.name}.{signal}  last {PLOT_SPAN_NS // NS_PER_S} s"
        if not finite:
            return [[Span(title + "  no value yet", BOLD)]]
        lines = curve(
            points, max(1, width - PLOT_LABEL), PLOT_HEIGHT - 1, (start_ns, now_ns), (low, high)
        )
        labels = [f"{high:.6g}", *[""] * (PLOT_HEIGHT - 3), f"{low:.6g}"]
        return [
            [Span(f"{title}  now {finite[-1]:.6g}", BOLD)],
            *(
                [Span(f"{label:>{PLOT_LABEL - 1}} ", DIM), Span(line, MESSAGE)]
                for label, line in zip(labels, lines, strict=True)
            ),
        ]

    def _last_line(self) -> Line:
        view = self._view
        if view.is_typing:
            return [Span(f"filter: {view.filter}_", BOLD)]
        line = [Span("PAUSED ", WARN)] if view.is_paused else []
        line.append(Span(f"sorted by {view.sort.value}", BOLD))
        if view.filter:
            line.append(Span(f"  filter {view.filter!r}", WARN))
        if not view.with_missing:
            line.append(Span("  missing ones hidden", WARN))
        return [*line, Span(f"  {KEYS}", DIM)]


def _because(reason: str) -> Line:
    return [] if reason in (NONE, "?") else [Span(f" ({reason})", WARN)]


def _node_line(node: NodeHealth) -> Line:
    """A node: what it says of itself, and which of its messages are not there."""
    presence = node.presence
    line = [Span(node.name, _STYLE[presence])]
    if presence is Presence.MISSING:
        return [*line, Span(" missing", BAD)]
    for text in (node.nmt, node.state):
        if text:
            line.append(Span(f" {text}", BAD if text in ("EMERGENCY", "SAFE_ALONE") else PLAIN))
    if node.codes:
        line.append(Span(f" {' '.join(node.codes)}", BAD))
    if node.missing:
        line.append(Span(f" without {', '.join(node.missing)}", BAD))
    elif node.late:
        line.append(Span(f" late {', '.join(node.late)}", WARN))
    return line


def _wrapped(items: list[Line], width: int) -> list[Line]:
    """Items side by side, as many as fit on a line."""
    lines: list[Line] = []
    left = 0
    for item in items:
        length = sum(len(span.text) for span in item) + 3
        if not lines or length > left:
            lines.append([])
            left = width
        lines[-1] += [*item, Span("   ", PLAIN)]
        left -= length
    return lines


def _verdict(row: Row, quiet: Style, is_wide: bool) -> Line:
    """Counter and CRC of the newest frame, and how many frames were not as they should be."""
    protection = row.protection
    if protection is None or not row.count:
        return [Span(" " * (COUNTER_WIDTH + (6 if is_wide else 1)), PLAIN)]
    is_good = protection.state in USABLE or protection.is_first
    style = (GOOD if is_good else BAD) if quiet is PLAIN else quiet
    spans = [Span(f"{protection.text():<{COUNTER_WIDTH}} ", style)]
    if is_wide:
        spans.append(Span(f"{protection.faults:>4} ", BAD if protection.faults else quiet))
    return spans


def _data(row: Row, now_ns: int, quiet: Style) -> Line:
    """The bytes, those that changed of late marked; of a long frame only the first ones."""
    if row.heard is None:
        return [Span(f"{'':{DATA_WIDTH + 1}}", PLAIN)]
    data = row.heard.data
    spans = []
    for value, changed_ns in zip(data[:DATA_BYTES_SHOWN], row.changed_ns, strict=False):
        is_marked = changed_ns and now_ns - changed_ns < CHANGED_NS
        spans.append(Span(f"{value:02X} ", CHANGED if is_marked else quiet))
    rest = "+" if len(data) > DATA_BYTES_SHOWN else ""
    return [*spans, Span(f"{rest:{DATA_WIDTH - 3 * len(spans)}} ", quiet)]


def _short(value: SignalValue) -> str:
    """A value on little room: of a flag its name if it is set."""
    if isinstance(value.value, bool):
        return value.name if value.value else ""
    return f"{value.name}={value.text()}"
