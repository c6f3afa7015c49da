"""Frames of a log as tables, one for each message: no interpolation, numbers and their names.

A row is a frame. Protected frames of the project's own bus also get their counter, and what a
receiver would say of it and the CRC: no DBC tells that.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dbc.messages import SPECS
from dbc.protection import COUNTER_INVALID, COUNTER_MODULO, AliveCheck, AliveState
from telemetry.databases import Databases, Message, Signal
from telemetry.decode.bits import counter_of, is_crc_right, raw_of
from telemetry.logs.frames import NO_DATA, FrameColumns, FrameFlag

NOT_AVAILABLE: Final = "not_available"
"""The name of a value that is none, in the project's DBCs."""
VERDICTS: Final = tuple(state.name.lower() for state in AliveState)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Names:
    """Texts of N rows, few of them different: places in a list of texts."""

    places: NDArray[np.uint16]
    texts: tuple[str, ...]

    @property
    def all(self) -> NDArray[np.object_]:
        """The text of each row."""
        return np.array(self.texts, dtype=object)[self.places]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Protection:
    """Of N frames: counter, CRC and the receiver's verdict (`dbc.protection.AliveState`)."""

    counter: NDArray[np.uint8]
    is_crc_right: NDArray[np.bool_]
    verdict: Names


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """All frames of one message, N rows in the order of the log.

    Attributes:
        message: As the DBC has it.
        frames: The frames themselves.
        rows: Their places among the frames that were given to the decoder.
        values: By signal, shape (N,): whole numbers where the DBC's scale allows, else float64;
            NaN where the sender had no value, or the multiplexer leaves the signal out.
        names: By signal whose values have names: the name, or an empty text.
        protection: Of a protected message of the project's own bus.
    """

    message: Message
    frames: FrameColumns
    rows: NDArray[np.intp]
    values: dict[str, NDArray[Any]]
    names: dict[str, Names]
    protection: Protection | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Decoded:
    """What some frames say.

    Attributes:
        frames: All of them.
        tables: By name of the message.
        others: Places of the frames that are in no table: unknown, of a wrong length, without data.
        wrong_lengths: By message, how many frames had another length than the DBC says.
        unknown: How many data frames have an identifier that is in no DBC.
    """

    frames: FrameColumns
    tables: dict[str, Table]
    others: NDArray[np.intp]
    wrong_lengths: dict[str, int]
    unknown: int


def intact(table: Table) -> Table:
    """Without the frames whose CRC is wrong: nobody believed them."""
    if table.protection is None or table.protection.is_crc_right.all():
        return table
    kept = table.protection.is_crc_right
    return Table(
        message=table.message,
        frames=table.frames.take(kept),
        rows=table.rows[kept],
        values={name: values[kept] for name, values in table.values.items()},
        names={
            name: Names(places=names.places[kept], texts=names.texts)
            for name, names in table.names.items()
        },
        protection=table.protection,
    )


class Decoder:
    """Reads chunks of one log, in order: counters go on from chunk to chunk.

    Args:
        databases: The DBCs.
        only: Messages to read, all if empty; the others' frames are left out as if unknown.
        signals: Names of the signals to read, all if empty.
    """

    def __init__(
        self,
        databases: Databases,
        only: Iterable[Message] = (),
        signals: Iterable[str] = (),
    ) -> None:
        self._databases = databases
        self._only = {id(message) for message in only}
        self._signals = frozenset(signals)
        self._checks: dict[tuple[str, int], AliveCheck] = defaultdict(AliveCheck)

    def decode(self, frames: FrameColumns) -> Decoded:
        """Reads a chunk."""
        is_data = (frames.flags & np.uint8(NO_DATA)) == 0
        places: dict[int, list[NDArray[np.intp]]] = {}
        messages: dict[int, Message] = {}
        wrong_lengths: dict[str, int] = {}
        unknown = 0
        used = np.zeros(len(frames), np.bool_)
        for (channel, can_id, is_extended), group in _groups(frames, is_data):
            message = self._databases.find(can_id, is_extended, frames.channels[channel])
            if message is None:
                unknown += len(group)
                continue
            if self._only and id(message) not in self._only:
                continue
            is_whole = frames.length[group] == message.length
            if not is_whole.all():
                count = int(len(group) - is_whole.sum())
                wrong_lengths[message.name] = wrong_lengths.get(message.name, 0) + count
                group = group[is_whole]
            used[group] = True
            messages[id(message)] = message
            places.setdefault(id(message), []).append(group)
        tables = {
            messages[key].name: self._table(messages[key], frames, np.sort(np.concatenate(groups)))
            for key, groups in places.items()
        }
        return Decoded(
            frames=frames, tables=tables, others=np.flatnonzero(~used),
            wrong_lengths=wrong_lengths, unknown=unknown,
        )  # fmt: skip

    def _table(self, message: Message, frames: FrameColumns, rows: NDArray[np.intp]) -> Table:
        own = frames.take(rows)
        raw: dict[str, NDArray[Any]] = {}
        values: dict[str, NDArray[Any]] = {}
        names: dict[str, Names] = {}
        wanted = [
            signal for signal in message.signals
            if not self._signals or signal.name in self._signals
        ]  # fmt: skip
        for signal in message.signals:
            if signal in wanted or signal.is_multiplexer:
                raw[signal.name] = raw_of(signal, own.data)
        for signal in wanted:
            is_there = _is_there(message, signal, raw)
            values[signal.name], name = _scaled(signal, raw[signal.name], is_there)
            if name is not None:
                names[signal.name] = name
        return Table(
            message=message, frames=own, rows=rows, values=values, names=names,
            protection=self._protection(message, own),
        )  # fmt: skip

    def _protection(self, message: Message, frames: FrameColumns) -> Protection | None:
        spec = SPECS.get(message.frame_id) if self._databases.is_own(message) else None
        if spec is None or spec.data_id is None:
            return None
        counter = counter_of(frames.data)
        is_right = is_crc_right(frames.data[:, :8], spec.data_id)
        is_intact = is_right & (counter != COUNTER_INVALID)
        verdicts = np.empty(len(frames), np.uint16)
        for channel in np.unique(frames.channel).tolist():
            rows = np.flatnonzero(frames.channel == channel)
            check = self._checks[frames.channels[channel], message.frame_id]
            verdicts[rows] = _judged(check, counter[rows], is_intact[rows])
        verdict = Names(places=verdicts, texts=VERDICTS)
        return Protection(counter=counter, is_crc_right=is_right, verdict=verdict)


def _judged(
    check: AliveCheck, counter: NDArray[np.uint8], is_intact: NDArray[np.bool_]
) -> NDArray[np.uint16]:
    """The check's verdicts on frames that follow each other.

    A frame that follows on an intact one with the next counter is OK, whatever was before; only
    the others are judged one by one.
    """
    follows = np.zeros(len(counter), np.bool_)
    expected = (counter.astype(np.uint16) + 1) % COUNTER_MODULO
    follows[1:] = is_intact[1:] & is_intact[:-1] & (counter[1:] == expected[:-1])
    verdicts = np.full(len(counter), AliveState.OK, np.uint16)
    for place in [*np.flatnonzero(~follows).tolist(), len(counter)]:
        if place and follows[place - 1]:
            check.expected, check.is_in_sequence = int(expected[place - 1]), True
            check.state = AliveState.OK
        if place < len(counter):
            verdicts[place] = check.judge(int(counter[place]) if is_intact[place] else None)
    return verdicts


def _groups(
    frames: FrameColumns, wanted: NDArray[np.bool_]
) -> Iterable[tuple[tuple[int, int, bool], NDArray[np.intp]]]:
    """Places of the wanted frames by channel, identifier and its kind, each in order."""
    places = np.flatnonzero(wanted)
    is_extended = (frames.flags[places] & np.uint8(FrameFlag.EXTENDED)).astype(np.uint64)
    keys = (
        frames.can_id[places].astype(np.uint64)
        | is_extended << np.uint64(32)
        | frames.channel[places].astype(np.uint64) << np.uint64(40)
    )
    order = np.argsort(keys, kind="stable")
    sorted_keys = keys[order]
    ends = np.flatnonzero(np.diff(sorted_keys)) + 1
    for group in np.split(order, ends) if len(order) else ():
        key = int(keys[group[0]])
        yield (key >> 40, key & 0xFFFF_FFFF, bool(key >> 32 & 1)), places[group]


def _is_there(
    message: Message, signal: Signal, raw: dict[str, NDArray[Any]]
) -> NDArray[np.bool_] | None:
    """In which rows the multiplexer puts a signal; None for all."""
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return None
    found = np.isin(raw[signal.multiplexer_signal], list(signal.multiplexer_ids))
    selector = next(s for s in message.signals if s.name == signal.multiplexer_signal)
    before = _is_there(message, selector, raw)
    return found if before is None else found & before


def _scaled(
    signal: Signal, raw: NDArray[Any], is_there: NDArray[np.bool_] | None
) -> tuple[NDArray[Any], Names | None]:
    """Values and, if some have names, the names."""
    scale, offset = signal.scale, signal.offset
    missing = np.zeros(len(raw), np.bool_) if is_there is None else ~is_there
    names = None
    if signal.choices:
        places = np.zeros(len(raw), np.uint16)
        for place, (number, text) in enumerate(signal.choices.items(), start=1):
            is_it = (raw == number) & ~missing
            places[is_it] = place
            if _is_none(signal, number, str(text)):
                missing |= is_it
        names = Names(places=places, texts=("", *map(str, signal.choices.values())))
    is_whole = not signal.is_float and float(scale).is_integer() and float(offset).is_integer()
    if is_whole and not missing.any():
        if (scale, offset) == (1, 0):
            return raw, names
        return raw.astype(np.int64) * int(scale) + int(offset), names
    values = raw.astype(np.float64) * float(scale) + float(offset)
    values[missing] = math.nan
    return values, names


def _is_none(signal: Signal, number: int, text: str) -> bool:
    """Whether a named value says that there is no value: by its name, or beyond the range."""
    value = number * signal.scale + signal.offset
    low, high = signal.minimum, signal.maximum
    is_outside = low is not None and high is not None and low < high and not low <= value <= high
    return text.lower() == NOT_AVAILABLE or is_outside
