"""Decoded frames as lines of text, in the order of the log; formatted column by column."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from canbus.candump import NS_PER_US, US_PER_S, log_line
from telemetry.decode.tables import Decoded, Names, Table
from telemetry.logs.frames import FrameColumns, FrameFlag

NONE_TEXT: Final = "n/a"
NO_UNITS: Final = (None, "", "1")
PROTECTION_SIGNALS: Final = ("crc", "alive_counter")
"""What the verdict says already; the bytes are there too."""
ODD_FLAGS: Final = 0xFF & ~int(FrameFlag.SENT)
"""Flags of any frame but a classical one with data and an identifier of 11 bits."""


def lines_of(decoded: Decoded, *, with_others: bool = True) -> list[str]:
    """A line for each frame: as `candump -L` writes it, then message, verdict and signals.

    Args:
        decoded: Some frames.
        with_others: Frames that are in no table as well, with nothing behind their bytes.
    """
    out = np.full(len(decoded.frames), None, dtype=object)
    for table in decoded.tables.values():
        out[table.rows] = _table_lines(table)
    if with_others and len(decoded.others):
        out[decoded.others] = _heads(decoded.frames.take(decoded.others))
    return [line for line in out.tolist() if line is not None]


def _table_lines(table: Table) -> list[str]:
    columns: list[list[str]] = [_heads(table.frames)]
    title = f"  {table.message.name}"
    if table.protection is None:
        columns.append([title] * len(table.rows))
    else:
        verdict = table.protection.verdict
        known = np.array(
            [[f"{title} ({number} {text})" for text in verdict.texts] for number in range(16)],
            dtype=object,
        )
        columns.append(known[table.protection.counter, verdict.places].tolist())
    units = {signal.name: signal.unit for signal in table.message.signals}
    hidden = PROTECTION_SIGNALS if table.protection is not None else ()
    shown = [(name, values) for name, values in table.values.items() if name not in hidden]
    for place, (name, values) in enumerate(shown):
        start = f"{',' if place else ' '} {name}="
        unit = f" {units[name]}" if units[name] not in NO_UNITS else ""
        columns.append(_texts(values, table.names.get(name), start, unit))
    return list(map("".join, zip(*columns, strict=True)))


def _texts(
    values: NDArray[Any], names: Names | None, start: str, unit: str
) -> list[str]:
    """One signal's part of each line. Values repeat: each one is formatted once."""
    known, inverse = np.unique(values, return_inverse=True)
    name_of = {}
    if names is not None:
        first = np.full(len(known), -1)
        first[inverse] = np.arange(len(values))
        name_of = dict(enumerate(names.texts[place] for place in names.places[first].tolist()))
    is_float = values.dtype.kind == "f"
    texts = [
        start + (name_of.get(place) or _text(value, is_float) + unit)
        for place, value in enumerate(known.tolist())
    ]
    return np.array(texts, dtype=object)[inverse].tolist()  # type: ignore[no-any-return]


def _text(value: float, is_float: bool) -> str:
    if not is_float:
        return str(value)
    return f"{value:.10g}" if math.isfinite(value) else NONE_TEXT


def _heads(frames: FrameColumns) -> list[str]:
    """Frames as `candump -L` writes them; classical ones with data at once."""
    channels = [f" {name} " for name in frames.channels]
    content, width = frames.data.tobytes().hex().upper(), 2 * frames.data.shape[1]
    seconds, us = np.divmod(frames.time_ns // NS_PER_US, US_PER_S)
    starts = np.arange(len(frames)) * width
    ends = starts + 2 * frames.length.astype(np.int64)
    columns = (seconds, us, frames.channel, frames.can_id, starts, ends)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    lines = [
        f"({s:010d}.{us:06d}){channels[channel]}{can_id:03X}#{content[start:end]}"
        for s, us, channel, can_id, start, end in rows
    ]
    odd = np.flatnonzero(frames.flags & np.uint8(ODD_FLAGS))
    for place, frame in zip(odd.tolist(), frames.take(odd).frames(), strict=True):
        lines[place] = log_line(frame.heard())
    return lines
