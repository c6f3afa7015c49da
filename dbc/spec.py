"""What the DBC says about one message, as the codec and the nodes use it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

NAN: Final = float("nan")


class SignalRangeError(ValueError):
    """A value that its DBC signal cannot carry. Ours when encoding, the bus's when decoding."""

    def __init__(self, signal: str, value: float, low: float, high: float, unit: str) -> None:
        super().__init__(f"{signal} = {value!r}: allowed {low} to {high} {unit}".rstrip())


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageSpec:
    """One message of a DBC.

    `pack` turns the message's dataclass into the frame's payload as a little-endian integer with
    CRC and counter zero; `unpack` is its inverse. Times are the DBC's attributes in ns, 0 = none.
    `units` has the message's signals, in the DBC's order, with their units.
    """

    can_id: int
    name: str
    length: int
    sender: str | None
    receivers: frozenset[str]
    cycle_ns: int
    timeout_ns: int
    min_interval_ns: int
    data_id: int | None
    units: Mapping[str, str]
    pack: Callable[[Any], int]
    unpack: Callable[[int], Any]


def snake_case(name: str) -> str:
    """`BrakeServo` to `brake_servo`: names of the DBC as files and attributes have them."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
