"""Frames to values, by the DBC's own words: bits, scales, protection. Nothing of the nodes' codec.

AUTOSAR E2E Profile 1: CRC-8 in byte 0, counter 0-14 in the low nibble of byte 1, CRC over data id
and data. The counter rule is written a second time: a frame may be used if it is one or two ahead
of the one before it; after any other step, only if it is exactly one ahead.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from math import nan
from typing import Any, Final

from e2e.p01 import e2e_p01_check

from canbus.frame import Frame, FrameKind
from dbc.database import VEHICLE_DBC, load
from oracle.words import GAP_NS, NEVER_NS, NS_PER_MS

COUNTER_MODULO: Final = 15
COUNTER_BYTE: Final = 1
PROTECTION: Final = ("crc", "alive_counter")
PAYLOAD_BEGIN: Final = 4
CACHE_SIZE: Final = 256
UNKNOWN: Final = -1
USABLE: Final = ""
NO_VALUES: Final[Mapping[str, float]] = {}

Values = Mapping[str, float]


@dataclass(slots=True, init=False)
class Message:
    """A frame with one of our identifiers.

    Attributes:
        name: In the DBC.
        sender: The true station.
        is_genuine: Whether that is whom the DBC names.
        fault: Why its content must not be used: kind, length, crc, counter; empty if it may.
        values: Its signals in SI, NaN for "not available"; `codes` has bit n set for ERn.
            Empty for a frame that is not intact.
    """

    name: Final[str]
    sender: Final[str]
    is_genuine: Final[bool]
    fault: Final[str]
    values: Final[Values]

    def __init__(
        self, name: str, sender: str, is_genuine: bool, fault: str, values: Values
    ) -> None:
        self.name = name
        self.sender = sender
        self.is_genuine = is_genuine
        self.fault = fault
        self.values = values

    @property
    def is_usable(self) -> bool:
        """Kind, length, CRC and counter are right."""
        return self.fault == USABLE


@dataclass(frozen=True, slots=True)
class Field:
    """One signal: where its bits are, and what they mean."""

    name: str
    start: int
    length: int
    is_signed: bool
    scale: float
    offset: float
    missing: int | None

    def read(self, bits: int) -> float:
        """Its value in the frame's bits, byte 0 lowest."""
        raw = bits >> self.start & (1 << self.length) - 1
        if self.is_signed and raw >> (self.length - 1):
            raw -= 1 << self.length
        if raw == self.missing:
            return nan
        if self.scale == 1 and self.offset == 0:
            return float(raw)
        return raw * self.scale + self.offset


class CounterRule:
    """Which counters may follow on each other."""

    __slots__ = ("_is_in_sequence", "_newest")

    def __init__(self) -> None:
        self._newest = UNKNOWN
        self._is_in_sequence = False

    def accepts(self, counter: int) -> bool:
        """Whether an intact frame with this counter may be used."""
        ahead = (counter - self._newest) % COUNTER_MODULO
        if self._newest != UNKNOWN and ahead == 0:
            return False  # a repetition; it breaks no sequence
        is_first = self._newest == UNKNOWN
        self._newest = counter
        self._is_in_sequence = not is_first and (
            ahead == 1 or (ahead == 2 and self._is_in_sequence)
        )
        return self._is_in_sequence


class Channel:
    """One message of the DBC, and what was heard of it.

    Once a stranger was heard the counter is followed twice, over all frames and over the true
    sender's alone: a receiver that lost the stranger's frame goes on with the latter.

    Attributes:
        name, can_id, length, sender, data_id, timeout_ns: By the DBC.
        heard_ns: When an intact frame of the true sender was last heard.
        newest, newest_ns: The last message that may be used, whoever sent it, and when it came.
        is_news: The last frame tells something else than the one before it, or is odd.
        before_ns: When an intact frame of the true sender was heard before the last one.
        lost_ns, resumed_ns: The last gap that may hide others (`GAP_NS`), from frame to frame.
    """

    def __init__(self, message: Any) -> None:
        attributes = message.dbc.attributes
        self.name: str = message.name
        self.can_id: int = message.frame_id
        self.length: int = message.length
        self.sender: str | None = message.senders[0] if message.senders else None
        self.data_id: int | None = None
        if "E2EDataId" in attributes:
            self.data_id = int(attributes["E2EDataId"].value)
        timeout = attributes.get("TimeoutTime")
        self.timeout_ns = 0 if timeout is None else int(timeout.value) * NS_PER_MS
        self.heard_ns = NEVER_NS
        self.newest: Message | None = None
        self.newest_ns = NEVER_NS
        self.is_news = True
        self.before_ns = NEVER_NS
        self.lost_ns = self.resumed_ns = NEVER_NS
        self._last: Values | None = None
        self._fields = tuple(_field(s) for s in message.signals if s.name not in PROTECTION)
        self._of_all: CounterRule | None = None
        self._of_sender = CounterRule()
        self._values: dict[bytes, Values] = {}
        self._known: dict[bytes, tuple[int, Message]] = {}

    def hear(self, now_ns: int, sender: str, frame: Frame) -> Message:
        """Judges and decodes the next frame with this identifier."""
        if sender != self.sender or frame.kind is not FrameKind.DATA:
            return self._hear_odd(now_ns, sender, frame)
        data = frame.data
        known = self._known.get(data) or self._learn(data)
        if known is None:
            return self._hear_odd(now_ns, sender, frame)
        before_ns, self.heard_ns = self.heard_ns, now_ns
        self.before_ns = before_ns
        if NEVER_NS < before_ns < now_ns - GAP_NS:
            self.lost_ns, self.resumed_ns = before_ns, now_ns
        counter, message = known
        if not self._is_in_sequence(counter, True):
            self.is_news, self._last = True, None
            return Message(self.name, sender, True, "counter", message.values)
        values = message.values
        self.is_news = values is not self._last
        self._last = values
        self.newest = message
        self.newest_ns = now_ns
        return message

    def _hear_odd(self, now_ns: int, sender: str, frame: Frame) -> Message:
        """A stranger's frame, one of another kind, or one that is not intact."""
        self.is_news, self._last = True, None
        is_genuine = sender == self.sender
        if frame.kind is not FrameKind.DATA:
            return Message(self.name, sender, is_genuine, "kind", NO_VALUES)
        known = self._learn(frame.data)
        if known is None:
            fault = "crc" if len(frame.data) == self.length else "length"
            return Message(self.name, sender, is_genuine, fault, NO_VALUES)
        counter, genuine = known
        fault = USABLE if self._is_in_sequence(counter, False) else "counter"
        message = Message(self.name, sender, False, fault, genuine.values)
        if fault == USABLE:
            self.newest, self.newest_ns = message, now_ns
        return message

    def _is_in_sequence(self, counter: int, is_genuine: bool) -> bool:
        if self.data_id is None:
            return True
        if self._of_all is None:
            if is_genuine:
                return self._of_sender.accepts(counter)
            self._of_all = copy(self._of_sender)
        is_by_all = self._of_all.accepts(counter)
        return (is_genuine and self._of_sender.accepts(counter)) or is_by_all

    def is_intact(self, data: bytes) -> bool:
        """Whether length, CRC and the counter's range fit."""
        if len(data) != self.length or self.data_id is None:
            return len(data) == self.length
        is_crc_right: bool = e2e_p01_check(bytearray(data), self.data_id)
        return is_crc_right and data[COUNTER_BYTE] & 0x0F < COUNTER_MODULO

    def _learn(self, data: bytes) -> tuple[int, Message] | None:
        """Counter and content of an intact frame of the true sender; kept for the next time."""
        if not self.is_intact(data):
            return None
        payload, counter = data, 0
        if self.data_id is not None:
            payload, counter = data[PAYLOAD_BEGIN:], data[COUNTER_BYTE] & 0x0F
        values = self._values.get(payload) or self._decode(payload, data)
        message = Message(self.name, self.sender or "", True, USABLE, values)
        if len(self._known) >= CACHE_SIZE:
            self._known.clear()
        known = self._known[data] = counter, message
        return known

    def _decode(self, payload: bytes, data: bytes) -> Values:
        bits = int.from_bytes(data, "little")
        values = {field.name: field.read(bits) for field in self._fields}
        if "er0" in values:
            values["codes"] = float(sum(int(values[f"er{n}"]) << n for n in range(7)))
        if len(self._values) >= CACHE_SIZE:
            self._values.clear()
        self._values[payload] = values
        return values


def _field(signal: Any) -> Field:
    assert signal.byte_order == "little_endian", signal.name
    choices = signal.choices or {}
    missing = next((raw for raw, text in choices.items() if str(text) == "not_available"), None)
    return Field(
        signal.name, signal.start, signal.length, signal.is_signed, signal.scale, signal.offset,
        missing,
    )


def channels() -> dict[str, Channel]:
    """Every message of the vehicle bus by name, with nothing heard yet."""
    return {message.name: Channel(message) for message in load(VEHICLE_DBC).messages}


def node_names() -> frozenset[str]:
    """The nodes of the vehicle bus."""
    return frozenset(node.name for node in load(VEHICLE_DBC).nodes)
