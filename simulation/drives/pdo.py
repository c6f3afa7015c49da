"""PDO of a drive (CiA 301, 7.2.2): mapping, values, timing, and the rules for changing them.

Asynchronous PDO alone (transmission types 254 and 255): no SYNC is sent on this bus. A TPDO leaves
when a value in it changed and the inhibit time is over, and in any case after the event time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from canbus.canopen_protocol import ABORT_NO_OBJECT, ABORT_STATE, ABORT_VALUE
from canbus.frame import Frame

RPDO_SETTINGS: Final = range(0x1400, 0x1402)
RPDO_MAPPINGS: Final = range(0x1600, 0x1602)
TPDO_SETTINGS: Final = range(0x1800, 0x1802)
TPDO_MAPPINGS: Final = range(0x1A00, 0x1A02)
SETTINGS: Final = frozenset({*RPDO_SETTINGS, *TPDO_SETTINGS})
MAPPINGS: Final = frozenset({*RPDO_MAPPINGS, *TPDO_MAPPINGS})
_MAPPING_DISTANCE: Final = RPDO_MAPPINGS.start - RPDO_SETTINGS.start

INVALID: Final = 1 << 31
_REMOTE_FORBIDDEN: Final = 1 << 30
_COB_IDS: Final = range(0x181, 0x580)
"""Between EMCY and SDO: where PDO lie in the predefined connection set."""
_COB_ID_MASK: Final = 0x7FF
_BITS_MAX: Final = 64

ABORT_NOT_MAPPABLE: Final = 0x06040041
ABORT_MAPPING_LENGTH: Final = 0x06040042

_INHIBIT_UNIT_NS: Final = 100_000
_EVENT_UNIT_NS: Final = 1_000_000

Entry = tuple[int, int, bool]
"""A mapped value: object, bytes, whether it is signed."""


def entry_of(raw: int, is_signed: Callable[[int], bool]) -> Entry:
    """A mapping entry as an object, its bytes and its sign."""
    return raw >> 8, (raw & 0xFF) // 8, is_signed(raw >> 8)


def refusal(
    number: Callable[[int, int], int],
    bits_of_mappable: Callable[[int, bool], int],
    index: int,
    subindex: int,
    raw: int,
) -> int:
    """Abort code for a write to a PDO's settings or mapping; 0: it is allowed.

    Args:
        number: Present value of an index and sub-index.
        bits_of_mappable: Length of an object that may be mapped, for a PDO that is received
            (True) or sent; 0 when it may not.
        index: Where the client writes.
        subindex: Likewise.
        raw: What it writes.
    """
    settings = index if index in SETTINGS else index - _MAPPING_DISTANCE
    is_valid = not number(settings, 1) & INVALID
    if index in SETTINGS:
        if subindex != 1:
            return 0
        if raw & _COB_ID_MASK not in _COB_IDS or raw & ~(INVALID | _REMOTE_FORBIDDEN | 0x7FF):
            return ABORT_VALUE
        changes = (raw ^ number(settings, 1)) & _COB_ID_MASK
        return ABORT_STATE if is_valid and changes else 0
    if is_valid:  # CiA 301: first invalid, then no entries, then entries, then their number
        return ABORT_STATE
    is_received = index in RPDO_MAPPINGS
    if subindex:
        if number(index, 0):
            return ABORT_STATE
        bits = bits_of_mappable(raw >> 8, is_received)
        return 0 if bits and bits == raw & 0xFF else ABORT_NOT_MAPPABLE
    entries = [number(index, member) for member in range(1, min(raw, 8) + 1)]
    if any(not bits_of_mappable(entry >> 8, is_received) for entry in entries):
        return ABORT_NO_OBJECT
    return ABORT_MAPPING_LENGTH if sum(entry & 0xFF for entry in entries) > _BITS_MAX else 0


class Received:
    """A PDO that comes in."""

    def __init__(self, cob_id: int, entries: list[Entry]) -> None:
        self.cob_id = cob_id
        self.entries = entries
        self.byte_count = sum(count for _, count, _ in entries)

    def values(self, data: bytes) -> dict[int, int]:
        """The values by object; `data` holds all of them, more is not looked at."""
        found, place = {}, 0
        for key, count, is_signed in self.entries:
            part = data[place : place + count]
            found[key] = int.from_bytes(part, "little", signed=is_signed)
            place += count
        return found


class Sent:
    """A PDO that goes out."""

    def __init__(self, cob_id: int, entries: list[Entry], inhibit: int, event: int) -> None:
        self.cob_id = cob_id
        self.entries = entries
        self._inhibit_ns = inhibit * _INHIBIT_UNIT_NS
        self._event_ns = event * _EVENT_UNIT_NS
        self._last: bytes | None = None
        self._last_ns = 0

    def due(self, now_ns: int, values: dict[int, int]) -> Iterable[Frame]:
        """The frame, if it leaves now."""
        age_ns = now_ns - self._last_ns
        if self._last is not None and age_ns < self._inhibit_ns:
            return ()
        data = b"".join(
            values[key].to_bytes(count, "little", signed=is_signed)
            for key, count, is_signed in self.entries
        )
        is_over = self._event_ns > 0 and age_ns >= self._event_ns
        if data == self._last and not is_over:
            return ()
        self._last, self._last_ns = data, now_ns
        return (Frame(self.cob_id, data),)
