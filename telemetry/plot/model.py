"""What a plot shows: a panel for each unit, the driving modes and the error codes below."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dbc.messages import Mode
from telemetry.decode.tables import Decoded, Table, intact
from telemetry.logs.frames import NS_PER_S
from telemetry.signals import CODE_SOURCES, CODES, CodeSpan, ModeSpan

FloatArray = NDArray[np.float64]

MODE_SOURCE: Final = "SUPERVISOR_STATE"
BAND_SOURCES: Final = (MODE_SOURCE, *(name for name in CODE_SOURCES if name != MODE_SOURCE))
BAND_SIGNALS: Final = ("mode", *(f"er{code.value}" for code in CODES))
GAP_CYCLES: Final = 10
"""A silence of so many of a message's usual distances breaks its line."""
POINTS_MAX: Final = 20_000
"""Of one line in a picture: more than a screen has columns, so that nothing is lost to the eye."""
NO_UNITS: Final = (None, "", "1")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """One signal; arrays of shape (N,). A value holds until the next; NaN is a gap.

    Attributes:
        label: MESSAGE.signal.
        time_s: From the log's origin on, in order.
        value: In the DBC's unit; of a signal whose values have names, the place among `names`.
        names: Those that came up, in the order of their numbers; empty for a quantity.
    """

    label: str
    time_s: FloatArray
    value: FloatArray
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Lines that share an axis.

    Attributes:
        unit: Theirs; empty where there is none.
        lines: One if its values have names.
    """

    unit: str
    lines: tuple[Line, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of a panel whose values have names."""
        return self.lines[0].names


@dataclass(frozen=True, slots=True, kw_only=True)
class Plot:
    """All of it.

    Attributes:
        title: One line.
        panels: In the order in which their signals were asked for.
        modes: Of the supervisor; None if the log has none of it, and so no codes either.
        codes: That a node reports, or the supervisor has latched.
        begin_s, end_s: Of the log, or of the part asked for.
        left_out: Frames whose CRC was wrong.
    """

    title: str
    panels: tuple[Panel, ...]
    modes: tuple[ModeSpan, ...] | None
    codes: tuple[CodeSpan, ...]
    begin_s: float
    end_s: float
    left_out: int


def plot_of(
    decoded: Decoded, signals: Sequence[tuple[str, str]], *, title: str, zero_ns: int
) -> Plot:
    """What was decoded, as panels.

    Args:
        decoded: All frames.
        signals: `(message, signal)`, in order.
        title: One line.
        zero_ns: The log's origin.
    """
    tables = {name: intact(table) for name, table in decoded.tables.items()}
    lines = [
        (_unit(tables[message], name), _line(tables[message], name, zero_ns))
        for message, name in signals
        if message in tables
    ]
    times_ns = decoded.frames.time_ns
    own = {name: tables[name] for name in BAND_SOURCES if name in tables and _is_own(tables[name])}
    state = own.get(MODE_SOURCE)
    return Plot(
        title=title,
        panels=tuple(_panels(lines)),
        modes=None if state is None else tuple(_modes(state, zero_ns)),
        codes=() if state is None else tuple(_codes(own.values(), zero_ns)),
        begin_s=(int(times_ns.min()) - zero_ns) / NS_PER_S if len(times_ns) else 0.0,
        end_s=(int(times_ns.max()) - zero_ns) / NS_PER_S if len(times_ns) else 0.0,
        left_out=sum(len(t.rows) - len(tables[n].rows) for n, t in decoded.tables.items()),
    )


def thinned(line: Line, points_max: int = POINTS_MAX) -> tuple[FloatArray, FloatArray]:
    """Times and values of at most so many points: of each stretch the least and the largest.

    Peaks of one frame stay, and so do gaps that are longer than a stretch.
    """
    count = len(line.value)
    if count <= points_max:
        return line.time_s, line.value
    stretches = points_max // 2
    starts = np.arange(stretches) * count // stretches
    filled = np.where(np.isnan(line.value), -np.inf, line.value)
    highest = np.maximum.reduceat(filled, starts)
    lowest = np.minimum.reduceat(np.where(np.isnan(line.value), np.inf, line.value), starts)
    times = np.repeat(line.time_s[starts], 2)
    values = np.stack([lowest, highest], axis=1).reshape(-1)
    return times, np.where(np.isfinite(values), values, np.nan)


def _is_own(table: Table) -> bool:
    return table.protection is not None


def _seconds(table: Table, zero_ns: int) -> FloatArray:
    return (table.frames.time_ns - zero_ns) / NS_PER_S


def _unit(table: Table, name: str) -> str:
    signal = next(signal for signal in table.message.signals if signal.name == name)
    return "" if signal.unit in NO_UNITS else str(signal.unit)


def _line(table: Table, name: str, zero_ns: int) -> Line:
    """A signal's line, broken where its message was silent."""
    time_s = _seconds(table, zero_ns)
    value = table.values[name].astype(np.float64)
    value, names = _named(table, name, value)
    if len(time_s) > 2:
        distance_s = np.diff(time_s)
        gaps = np.flatnonzero(distance_s > GAP_CYCLES * np.median(distance_s))
        usual_s = float(np.median(distance_s))
        time_s = np.insert(time_s, gaps + 1, time_s[gaps] + usual_s)
        value = np.insert(value, gaps + 1, np.nan)
    return Line(label=f"{table.message.name}.{name}", time_s=time_s, value=value, names=names)


def _named(table: Table, name: str, value: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """The places of names, if all values have them; a quantity has one for "no value" at most."""
    found = table.names.get(name)
    is_value = ~np.isnan(value)
    if found is None or not found.places[is_value].all():
        return value, ()
    _, first, place = np.unique(value[is_value], return_index=True, return_inverse=True)
    places = np.full(len(value), np.nan)
    places[is_value] = place
    rows = np.flatnonzero(is_value)[first].tolist()
    return places, tuple(found.texts[found.places[row]] for row in rows)


def _panels(lines: Iterable[tuple[str, Line]]) -> Iterator[Panel]:
    """A panel for each unit, and one for each signal whose values have names."""
    shared: dict[str, list[Line]] = {}
    for number, (unit, line) in enumerate(lines):
        shared.setdefault(f"#{number}" if line.names else unit, []).append(line)
    for unit, group in shared.items():
        yield Panel(unit="" if unit.startswith("#") else unit, lines=tuple(group))


def _runs(time_s: FloatArray, values: NDArray[Any]) -> Iterator[tuple[float, float, Any]]:
    """`(start_s, end_s, value)` of what stays the same; it lasts until the next value comes."""
    if not len(values):
        return
    starts = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    ends = np.concatenate([time_s[starts[1:]], time_s[-1:]])
    yield from zip(time_s[starts].tolist(), ends.tolist(), values[starts].tolist(), strict=True)


def _modes(state: Table, zero_ns: int) -> Iterator[ModeSpan]:
    known = {mode.value for mode in Mode}
    for start_s, end_s, value in _runs(_seconds(state, zero_ns), state.values["mode"]):
        if value in known:
            yield ModeSpan(start_s=start_s, end_s=end_s, mode=Mode(value))


def _codes(tables: Iterable[Table], zero_ns: int) -> Iterator[CodeSpan]:
    for table in tables:
        time_s = _seconds(table, zero_ns)
        for code in CODES:
            for start_s, end_s, is_set in _runs(time_s, table.values[f"er{code.value}"]):
                if is_set:
                    yield CodeSpan(start_s=start_s, end_s=end_s, code=code)
