"""What is known of a message: name, sender, times, protection, and how its content is read.

The project's own bus is read with the codec of the nodes, without cantools, whose import alone
takes as long as a monitor may take to start. Any other DBC is read with cantools, when it is given.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from canbus.frame import CAN_ID_MAX
from canbus.heard import EXTENDED_FLAG, EXTENDED_ID_MAX
from dbc.codec import Decoded, FrameFault, decode_data
from dbc.messages import SPECS
from dbc.spec import MessageSpec
from telemetry.monitor.style import printable

if TYPE_CHECKING:
    from telemetry.databases import Databases, Message, Signal

NS_PER_MS: Final = 1_000_000
NOT_AVAILABLE: Final = "n/a"
Value = int | float | str
"""A signal's value; a value with a name of its own is that name."""


@dataclass(frozen=True, slots=True)
class SignalValue:
    """One signal of a frame. `value` is NaN where the sender says that it has none.

    `number` is the value for a plot: of a value with a name its number, else the value itself.
    """

    name: str
    value: Value
    unit: str
    number: float

    def text(self) -> str:
        """Value and unit, `12.35 ms`; at most ten digits, so that 12.35 stays 12.35."""
        value = self.value
        if isinstance(value, str):
            return value
        if isinstance(value, float):
            if not math.isfinite(value):
                return NOT_AVAILABLE
            shown = f"{value:.10g}"
        else:
            shown = str(int(value))
        return f"{shown} {self.unit}" if self.unit else shown


@dataclass(frozen=True, slots=True)
class Content:
    """What a frame says: its signals, or why it cannot be read."""

    values: tuple[SignalValue, ...] = ()
    fault: str = ""


NO_CONTENT: Final = Content()


@dataclass(frozen=True, slots=True, kw_only=True)
class Known(ABC):
    """One message of a database; times in ns, 0 = none; `signals` without counter and CRC."""

    name: str
    sender: str | None
    signals: tuple[str, ...]
    cycle_ns: int
    timeout_ns: int = 0
    data_id: int | None = None
    is_own: bool = False

    @abstractmethod
    def read(self, data: bytes) -> Content:
        """The content of a data frame; never raises."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnMessage(Known):
    """A message of the project's vehicle bus."""

    spec: MessageSpec

    def read(self, data: bytes) -> Content:
        """As the nodes read it; a CRC that is wrong leaves no content to be told."""
        decoded = decode_data(self.spec.can_id, data)
        if not isinstance(decoded, Decoded):
            return Content(fault=self._fault_text(decoded, data))
        values = []
        for name, unit in self.spec.units.items():
            value = getattr(decoded.message, name)
            shown = value.name if isinstance(value, IntEnum) else value
            values.append(SignalValue(name, shown, "" if unit == "1" else unit, float(value)))
        return Content(tuple(values))

    def _fault_text(self, fault: FrameFault, data: bytes) -> str:
        if fault is FrameFault.LENGTH:
            return f"{len(data)} bytes instead of {self.spec.length}"
        return "CRC wrong" if fault is FrameFault.CRC else "a value out of its range"


def own_message(spec: MessageSpec) -> OwnMessage:
    """What a specification says."""
    return OwnMessage(
        spec=spec,
        name=spec.name,
        sender=spec.sender,
        signals=tuple(spec.units),
        cycle_ns=spec.cycle_ns,
        timeout_ns=spec.timeout_ns,
        data_id=spec.data_id,
        is_own=True,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ForeignMessage(Known):
    """A message of any DBC, read by cantools."""

    message: Message
    units: Mapping[str, str]

    def read(self, data: bytes) -> Content:
        """As the DBC says; data that is too long or too short is told."""
        if len(data) != self.message.length:
            return Content(fault=f"{len(data)} bytes instead of {self.message.length}")
        try:
            decoded = self.message.decode(data)
        except Exception:  # whatever a foreign DBC leads a decoder to
            return self._read_one_by_one(data)
        if not isinstance(decoded, Mapping):
            return Content(fault="cannot be read: a container message")
        return Content(tuple(self._value(str(name), value) for name, value in decoded.items()))

    def _read_one_by_one(self, data: bytes) -> Content:
        """Signals that overlap, or of which one cannot be read; multiplexed ones are left out."""
        values = []
        for signal in self.message.signals:
            if signal.multiplexer_ids is not None or signal.is_float:
                continue
            try:
                value = signal.raw_to_scaled(_raw(signal, data))
            except ValueError:
                continue
            values.append(self._value(signal.name, value))
        return Content(tuple(values), "" if values else "cannot be read")

    def _value(self, name: str, value: object) -> SignalValue:
        shown: Value
        if isinstance(value, int | float):
            shown, number = value, float(value)
        else:
            shown, number = printable(str(value)), float(getattr(value, "value", math.nan))
        return SignalValue(name, shown, self.units.get(name, ""), number)


def _raw(signal: Signal, data: bytes) -> int:
    """The number in a signal's bits, by the DBC's two ways to count them."""
    mask = (1 << signal.length) - 1
    if signal.byte_order == "little_endian":
        if signal.start + signal.length > 8 * len(data):
            raise ValueError("outside the frame")
        raw = int.from_bytes(data, "little") >> signal.start & mask
    else:
        first = signal.start // 8 * 8 + 7 - signal.start % 8
        raw = int.from_bytes(data, "big") >> 8 * len(data) - first - signal.length & mask
    is_negative = signal.is_signed and raw >> signal.length - 1
    return raw - mask - 1 if is_negative else raw


def foreign_message(message: Message) -> ForeignMessage:
    """What a DBC says of a message."""
    return ForeignMessage(
        message=message,
        name=message.name,
        sender=message.senders[0] if message.senders else None,
        signals=tuple(signal.name for signal in message.signals),
        cycle_ns=(message.cycle_time or 0) * NS_PER_MS,
        units={signal.name: printable(signal.unit or "") for signal in message.signals},
    )


class Catalogue:
    """Every message that is known, by channel and identifier.

    Args:
        databases: DBC files; None for the project's own vehicle bus, without cantools.
    """

    def __init__(self, databases: Databases | None = None) -> None:
        self._databases = databases
        self._found: dict[tuple[str, int], Known | None] = {}
        if databases is None:
            self.messages: dict[int, Known] = {i: own_message(s) for i, s in SPECS.items()}
        else:
            self.messages = {
                m.frame_id | EXTENDED_FLAG * m.is_extended_frame: self._known(m)
                for m in reversed(databases.messages)
            }
        self.has_own = any(known.is_own for known in self.messages.values())

    def find(self, channel: str, word: int) -> Known | None:
        """The message of an identifier with its flags; None for an unknown one."""
        if self._databases is None:
            return self.messages.get(word)
        key = channel, word
        if key not in self._found:
            is_extended = bool(word & EXTENDED_FLAG)
            if word & EXTENDED_ID_MAX > CAN_ID_MAX and not is_extended:
                return None
            message = self._databases.find(word & EXTENDED_ID_MAX, is_extended, channel)
            self._found[key] = None if message is None else self._known(message)
            if len(self._found) > FOUND_MAX:
                self._found.clear()
                return None if message is None else self._known(message)
        return self._found[key]

    def _known(self, message: Message) -> Known:
        assert self._databases is not None
        if self._databases.is_own(message):
            return own_message(SPECS[message.frame_id])
        return foreign_message(message)

    def names(self) -> Iterable[str]:
        """Names of all messages."""
        return sorted({known.name for known in self.messages.values()})

    def nodes(self) -> Iterable[str]:
        """Names of all nodes that send something."""
        return sorted({known.sender for known in self.messages.values() if known.sender})


FOUND_MAX: Final = 4096
"""Identifiers remembered, known or not: a bus may carry every one of 29 bits."""
