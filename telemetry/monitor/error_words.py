"""Error frames of SocketCAN in words (linux/can/error.h)."""

from __future__ import annotations

from typing import Final

from canbus.bus import (
    CONTROLLER_RX_OVERFLOW,
    ERROR_CLASS_BUS_OFF,
    ERROR_CLASS_CONTROLLER,
    ERROR_CLASS_TEXT,
)

ARBITRATION_LOST: Final = 0x002
PROTOCOL: Final = 0x008
TRANSCEIVER: Final = 0x010
COUNTERS: Final = 0x200

_CONTROLLER: Final = {
    CONTROLLER_RX_OVERFLOW: "receive buffer overflowed",
    0x02: "transmit buffer overflowed",
    0x04: "warning level of receive errors",
    0x08: "warning level of transmit errors",
    0x10: "error passive by receive errors",
    0x20: "error passive by transmit errors",
    0x40: "error active again",
}
_PROTOCOL: Final = {
    0x01: "single bit",
    0x02: "frame format",
    0x04: "bit stuffing",
    0x08: "could not send a dominant bit",
    0x10: "could not send a recessive bit",
    0x20: "bus overload",
    0x40: "active error announced",
    0x80: "while sending",
}
_PLACE: Final = {
    0x03: "start of frame",
    0x02: "ID bits 28-21",
    0x06: "ID bits 20-18",
    0x04: "substitute RTR",
    0x05: "identifier extension",
    0x07: "ID bits 17-13",
    0x0F: "ID bits 12-5",
    0x0E: "ID bits 4-0",
    0x0C: "RTR",
    0x0D: "reserved bit 1",
    0x09: "reserved bit 0",
    0x0B: "data length",
    0x0A: "data",
    0x08: "CRC",
    0x18: "CRC delimiter",
    0x19: "acknowledge slot",
    0x1B: "acknowledge delimiter",
    0x1A: "end of frame",
    0x12: "intermission",
}
_TRANSCEIVER: Final = {
    0x04: "CANH: no wire",
    0x05: "CANH: short to battery",
    0x06: "CANH: short to supply",
    0x07: "CANH: short to ground",
    0x40: "CANL: no wire",
    0x50: "CANL: short to battery",
    0x60: "CANL: short to supply",
    0x70: "CANL: short to ground",
    0x80: "CANL: short to CANH",
}
_SHORT: Final = {ERROR_CLASS_CONTROLLER: "controller", ERROR_CLASS_BUS_OFF: "BUS-OFF"}


def error_words(classes: int, data: bytes) -> str:
    """What an error frame says: each class, with its details where the driver gives some."""
    data = data.ljust(8, b"\0")
    details = {
        ARBITRATION_LOST: f"at bit {data[0]}" if data[0] else "",
        ERROR_CLASS_CONTROLLER: _bits(_CONTROLLER, data[1]),
        PROTOCOL: _protocol(data[2], data[3]),
        TRANSCEIVER: _transceiver(data[4]),
        COUNTERS: f"{data[6]} transmit, {data[7]} receive",
    }
    said = []
    for bit, text in ERROR_CLASS_TEXT.items():
        if classes & bit:
            detail = details.get(bit, "")
            said.append(_SHORT.get(bit, text) + (f": {detail}" if detail else ""))
    if unknown := classes & ~sum(ERROR_CLASS_TEXT):
        said.append(f"unknown classes 0x{unknown:X}")
    if any(data[6:8]) and not classes & COUNTERS:
        said.append(f"error counters {details[COUNTERS]}")
    return "; ".join(said) or "no class given"


def _bits(names: dict[int, str], value: int) -> str:
    return ", ".join(text for bit, text in names.items() if value & bit)


def _protocol(kinds: int, place: int) -> str:
    where = _PLACE.get(place, f"place 0x{place:02X}") if place else ""
    what = _bits(_PROTOCOL, kinds)
    return f"{what} in {where}" if what and where else what or (where and f"in {where}")


def _transceiver(status: int) -> str:
    if not status:
        return ""
    found = [_TRANSCEIVER.get(half) for half in (status & 0x0F, status & 0xF0) if half]
    return ", ".join(text or f"status 0x{status:02X}" for text in found)
