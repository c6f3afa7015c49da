"""SDO abort codes in words (CiA 301, table 22)."""

from __future__ import annotations

from typing import Final

ABORT_TEXT: Final = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "timed out",
    0x05040001: "unknown command",
    0x05040002: "invalid block size",
    0x05040003: "invalid sequence number",
    0x05040004: "CRC error",
    0x05040005: "out of memory",
    0x06010000: "access not supported",
    0x06010001: "object is write-only",
    0x06010002: "object is read-only",
    0x06020000: "no such object",
    0x06040041: "object cannot be mapped to a PDO",
    0x06040042: "mapped objects are longer than a PDO",
    0x06040043: "parameters do not fit together",
    0x06040047: "incompatible inside the device",
    0x06060000: "access failed, hardware error",
    0x06070010: "wrong data type or length",
    0x06070012: "too long",
    0x06070013: "too short",
    0x06090011: "no such sub-index",
    0x06090030: "value out of range",
    0x06090031: "value too high",
    0x06090032: "value too low",
    0x06090036: "maximum below minimum",
    0x060A0023: "resource not available",
    0x08000000: "general error",
    0x08000020: "cannot be stored",
    0x08000021: "cannot be stored: local control",
    0x08000022: "not in this state of the device",
    0x08000023: "no object dictionary",
    0x08000024: "no data",
}
