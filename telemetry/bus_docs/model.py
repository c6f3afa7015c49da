"""What a page says of one DBC: read from cantools' database, ours or a foreign one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from canbus.timing import DATA_BYTES_MAX, MessageTiming, bus_load, response_times_ns
from telemetry.bus_docs.layout import Cell, rows_of
from telemetry.databases import Database, Message, Signal

NS_PER_MS = 1_000_000
BITRATE_BPS = 500_000
"""Where the file does not say."""
BITRATES_BPS = (125_000, 250_000, 500_000, 1_000_000)
NOBODY = "Vector__XXX"
"""The DBC's word for no node."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalRow:
    """One signal, as its row tells it."""

    name: str
    bits: str
    kind: str
    scale: str
    span: str
    unit: str
    values: list[tuple[int, str]]
    receivers: list[str]
    condition: str
    """For which multiplexer values it is there; empty: always."""
    comment: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """One layout: a message has several if a signal chooses among them."""

    title: str
    rows: list[list[Cell]]


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageDoc:
    """One message.

    Attributes:
        cycle_ms: Period, or None if it has none.
        gap_ms: Of a message without a period, the least time between two; None if not told.
        response_ms: Longest time from its queuing to its end on the wire, None if not known.
    """

    name: str
    id_text: str
    anchor: str
    length: int
    senders: list[str]
    receivers: list[str]
    cycle_ms: float | None
    gap_ms: float | None
    timeout_ms: float | None
    protection: str
    response_ms: float | None
    comment: str
    pictures: list[Picture]
    signals: list[SignalRow]


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeDoc:
    """One node, and what it sends and receives."""

    name: str
    comment: str
    sends: list[MessageDoc]
    receives: list[MessageDoc]


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """Share of the bus at one bit rate, 0 to 1: periodic messages, and all at their fastest."""

    bitrate_bps: int
    periodic: float
    fastest: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BusDoc:
    """Everything that is told of one DBC."""

    title: str
    comment: str
    bitrate_bps: int
    messages: list[MessageDoc]
    nodes: list[NodeDoc]
    loads: list[Load]
    tables: list[tuple[str, list[tuple[int, str]]]]
    timing_note: str
    notes: list[str]


def document(
    database: Database, title: str, *, bitrate_bps: int | None = None, notes: Sequence[str] = ()
) -> BusDoc:
    """Reads one database.

    Args:
        database: As cantools has parsed it.
        title: Name of the file.
        bitrate_bps: Of the bus; None: as the file says, else 500 kbit/s.
        notes: What relaxed loading tolerated.
    """
    rate = bitrate_bps or int(_attribute(database.dbc, "Baudrate", "BaudRate") or BITRATE_BPS)
    timings = {id(message): timing for message in database.messages
               if (timing := _timing(message)) is not None}  # fmt: skip
    times_ms, timing_note = _responses(list(timings.values()), rate)
    ordered = sorted(database.messages, key=lambda m: (m.is_extended_frame, m.frame_id))
    messages = [_message(message, times_ms) for message in ordered]
    periodic = [timings[id(m)] for m in database.messages if id(m) in timings and _cycle_ms(m)]
    return BusDoc(
        title=title,
        comment=_bus_comment(database),
        bitrate_bps=rate,
        messages=messages,
        nodes=list(_nodes(database, messages)),
        loads=[
            Load(
                bitrate_bps=bitrate,
                periodic=bus_load(periodic, bitrate),
                fastest=bus_load(list(timings.values()), bitrate),
            )
            for bitrate in sorted({*BITRATES_BPS, rate})
        ],
        tables=list(_tables(database)),
        timing_note=timing_note,
        notes=list(notes),
    )


def _bus_comment(database: Database) -> str:
    comments = [bus.comment for bus in database.buses if bus.comment]
    return comments[0] if comments else ""


def _attribute(owner: Any, *names: str) -> Any:
    """The first attribute that is set, of a DBC, a message or a signal."""
    attributes = getattr(owner, "attributes", None) or {}
    found = (attributes[name].value for name in names if name in attributes)
    return next(found, None)


def _cycle_ms(message: Message) -> float | None:
    return float(message.cycle_time) if message.cycle_time else None


def _gap_ms(message: Message) -> float | None:
    gap = _attribute(message.dbc, "GenMsgDelayTime")
    return float(gap) if gap else None


def _timing(message: Message) -> MessageTiming | None:
    """For the analysis: what has a period, or a least time between two, and is classical."""
    period_ms = _cycle_ms(message) or _gap_ms(message)
    if period_ms is None or message.length > DATA_BYTES_MAX or message.is_fd:
        return None
    return MessageTiming(
        can_id=message.frame_id, length=message.length,
        period_ns=round(period_ms * NS_PER_MS), extended=message.is_extended_frame,
    )  # fmt: skip


def _responses(timings: list[MessageTiming], bitrate_bps: int) -> tuple[dict[int, float], str]:
    """Response times by identifier in ms, or why there are none."""
    if not timings:
        return {}, "No message tells its period, so there is nothing to work out."
    try:
        times_ns = response_times_ns(timings, bitrate_bps)
    except ValueError as error:
        return {}, f"No bound on the response times: {error}."
    return {can_id: ns / NS_PER_MS for can_id, ns in times_ns.items()}, ""


def _message(message: Message, times_ms: dict[int, float]) -> MessageDoc:
    digits = 8 if message.is_extended_frame else 3
    data_id = _attribute(message.dbc, "E2EDataId")
    profile = _attribute(message.dbc, "E2EProfile")
    timeout = _attribute(message.dbc, "TimeoutTime", "GenMsgTimeoutTime")
    receivers = {name for signal in message.signals for name in signal.receivers}
    return MessageDoc(
        name=message.name,
        id_text=f"0x{message.frame_id:0{digits}X}",
        anchor=f"m-{message.name}",
        length=message.length,
        senders=[name for name in message.senders if name != NOBODY],
        receivers=sorted(receivers - {NOBODY}),
        cycle_ms=_cycle_ms(message),
        gap_ms=None if _cycle_ms(message) else _gap_ms(message),
        timeout_ms=float(timeout) if timeout else None,
        protection=f"{profile or 'E2E'}, id 0x{data_id:X}" if data_id else "",
        response_ms=times_ms.get(message.frame_id) if _timing(message) else None,
        comment=message.comment or "",
        pictures=list(_pictures(message)),
        signals=[_signal(signal) for signal in message.signals],
    )


def _pictures(message: Message) -> Iterator[Picture]:
    always = [s for s in message.signals if not s.multiplexer_ids]
    chosen = [s for s in message.signals if s.multiplexer_ids]
    choices = sorted({
        (signal.multiplexer_signal or "", number)
        for signal in chosen for number in signal.multiplexer_ids or ()
    })  # fmt: skip
    for selector, number in choices:
        there = [
            signal for signal in message.signals
            if signal in always
            or (signal.multiplexer_signal == selector and number in (signal.multiplexer_ids or ()))
        ]  # fmt: skip
        yield Picture(
            title=f"{selector} = {number}", rows=_rows(message, there)
        )
    if not choices:
        yield Picture(title="", rows=_rows(message, always))


def _rows(message: Message, signals: list[Signal]) -> list[list[Cell]]:
    """Cells that name their signal by its place among all of the message's."""
    places = [message.signals.index(signal) for signal in signals]
    return [
        [
            cell if cell.signal is None
            else Cell(signal=places[cell.signal], width=cell.width, text=cell.text)
            for cell in row
        ]
        for row in rows_of(signals, message.length)
    ]  # fmt: skip


def _signal(signal: Signal) -> SignalRow:
    kind = "float" if signal.is_float else "signed" if signal.is_signed else "unsigned"
    order = "" if signal.byte_order == "little_endian" else ", Motorola"
    scale = "" if (signal.scale, signal.offset) == (1, 0) else f"{signal.scale:g} x"
    if signal.offset:
        scale = f"{scale or 'raw'} {'+' if signal.offset > 0 else '-'} {abs(signal.offset):g}"
    is_limited = signal.minimum is not None and signal.maximum is not None
    choices: dict[int, Any] = dict(signal.choices or {})
    condition = ""
    if signal.multiplexer_ids:
        numbers = ", ".join(map(str, sorted(signal.multiplexer_ids)))
        condition = f"{signal.multiplexer_signal} = {numbers}"
    elif signal.is_multiplexer:
        condition = "chooses the layout"
    return SignalRow(
        name=signal.name,
        bits=f"{signal.start}|{signal.length}",
        kind=f"{kind}{order}",
        scale=scale,
        span=f"{signal.minimum:g} to {signal.maximum:g}" if is_limited else "",
        unit=signal.unit or "",
        values=sorted((int(number), str(text)) for number, text in choices.items()),
        receivers=[name for name in signal.receivers if name != NOBODY],
        condition=condition,
        comment=signal.comment or "",
    )


def _nodes(database: Database, messages: list[MessageDoc]) -> Iterator[NodeDoc]:
    comments = {node.name: node.comment or "" for node in database.nodes}
    named = {name for message in messages for name in (*message.senders, *message.receivers)}
    for name in [*comments, *sorted(named - comments.keys())]:
        if name != NOBODY:
            yield NodeDoc(
                name=name,
                comment=comments.get(name, ""),
                sends=[message for message in messages if name in message.senders],
                receives=[message for message in messages if name in message.receivers],
            )


def _tables(database: Database) -> Iterator[tuple[str, list[tuple[int, str]]]]:
    """Value tables with a name, in the order of the file."""
    tables = getattr(database.dbc, "value_tables", None) or {}
    for name, choices in tables.items():
        yield name, sorted((int(number), str(text)) for number, text in choices.items())
