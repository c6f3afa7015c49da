"""The DBC files as cantools reads them, for tests that hold our codec against it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from cantools.database.can import Message, Signal

from dbc import byte_commands, harness, messages
from dbc.database import BYTE_COMMANDS_DBC, HARNESS_DBC, VEHICLE_DBC, load
from dbc.generate import class_name
from dbc.spec import MessageSpec

MODULES: dict[str, Any] = {
    VEHICLE_DBC: messages,
    HARNESS_DBC: harness,
    BYTE_COMMANDS_DBC: byte_commands,
}
PROTECTION = ("crc", "alive_counter")


@dataclass(frozen=True)
class Case:
    """One message of one DBC: cantools' view, and ours."""

    dbc: str
    message: Message
    spec: MessageSpec
    kind: type[Any]

    @property
    def payload(self) -> list[Signal]:
        """Signals a node works with."""
        return [signal for signal in self.message.signals if signal.name not in PROTECTION]

    @property
    def zero_protection(self) -> dict[str, int]:
        """CRC and counter as our pack leaves them."""
        return {s.name: 0 for s in self.message.signals if s.name in PROTECTION}


CASES = [
    Case(dbc, message, MODULES[dbc].SPECS[message.frame_id],
         getattr(MODULES[dbc], class_name(message)))
    for dbc in MODULES
    for message in load(dbc).messages
]
CASE_IDS = [f"{case.dbc}:{case.message.name}" for case in CASES]


def raw_domain(signal: Signal) -> tuple[int, int]:
    """Smallest and largest raw value the signal's bits hold."""
    if signal.is_signed:
        return -(1 << signal.length - 1), (1 << signal.length - 1) - 1
    return 0, (1 << signal.length) - 1


def choice_names(signal: Signal) -> dict[int, str]:
    return {int(raw): str(name) for raw, name in (signal.choices or {}).items()}


def is_enum(signal: Signal) -> bool:
    """Whether every value has a name; a lone "not_available" makes no enumeration."""
    names = choice_names(signal)
    return bool(names) and set(names.values()) != {"not_available"}


def not_available(signal: Signal) -> int | None:
    return next((r for r, name in choice_names(signal).items() if name == "not_available"), None)


def is_valid(signal: Signal, raw: int) -> bool:
    """Whether the DBC allows this raw value."""
    if is_enum(signal):
        return raw in choice_names(signal)
    assert signal.minimum is not None and signal.maximum is not None
    return raw == not_available(signal) or signal.minimum <= raw * signal.scale <= signal.maximum


def edge_raws(signal: Signal) -> list[int]:
    """Valid raw values at every edge."""
    low, high = raw_domain(signal)
    assert signal.minimum is not None and signal.maximum is not None
    first, last = round(signal.minimum / signal.scale), round(signal.maximum / signal.scale)
    wanted = {low, low + 1, first, first + 1, -1, 0, 1, last - 1, last, high - 1, high}
    wanted |= set(choice_names(signal))
    return sorted(raw for raw in wanted if low <= raw <= high and is_valid(signal, raw))


def physical(signal: Signal, raw: int) -> Any:
    """What our dataclass holds for a raw value."""
    if raw == not_available(signal):
        return math.nan
    if signal.length == 1:
        return bool(raw)
    return raw if is_enum(signal) else raw * signal.scale


def for_cantools(signal: Signal, value: Any) -> Any:
    """A field of ours as cantools wants it: NaN is a name there."""
    return "not_available" if isinstance(value, float) and math.isnan(value) else value
