"""CANopen in words (CiA 301): NMT, heartbeats, EMCY, SDO with the objects' names, PDO."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Final

from canbus.canopen_protocol import (
    HEARTBEAT_ID,
    NMT_ID,
    NODE_ID_MAX,
    SDO_REQUEST_ID,
    SDO_RESPONSE_ID,
    NmtCommand,
    NmtState,
)
from canbus.node import NODE_IDS
from dbc.messages import ErrorCode, Reason
from gateway.sentences import REASON_TEXT

SYNC_ID: Final = 0x080
TIME_ID: Final = 0x100
EMCY_ID: Final = 0x080
EMCY_BYTES: Final = 8
PDO_IDS: Final = {
    0x180: "TPDO1", 0x200: "RPDO1", 0x280: "TPDO2", 0x300: "RPDO2",
    0x380: "TPDO3", 0x400: "RPDO3", 0x480: "TPDO4", 0x500: "RPDO4",
}  # fmt: skip
EMCY_DEVICE: Final = 0xFF00
"""Emergency codes from here on are the device's own; ours are this and the number of ERn."""

NO_DRIVES: Final[Mapping[int, str]] = {}

_NODE_MASK: Final = 0x7F
_EMCY: Final = struct.Struct("<HBBBB")
_NODE_NAMES: Final = {number: name for name, number in NODE_IDS.items()}
_NMT_TEXT: Final = {
    NmtCommand.START: "start",
    NmtCommand.STOP: "stop",
    NmtCommand.ENTER_PRE_OPERATIONAL: "enter pre-operational",
    NmtCommand.RESET_NODE: "reset node",
    NmtCommand.RESET_COMMUNICATION: "reset communication",
}
_EMCY_CLASS: Final = {
    0x00: "no error", 0x10: "generic error", 0x20: "current", 0x21: "current, input side",
    0x22: "current inside", 0x23: "current, output side", 0x30: "voltage", 0x31: "mains voltage",
    0x32: "voltage inside", 0x33: "output voltage", 0x40: "temperature",
    0x41: "ambient temperature", 0x42: "device temperature", 0x50: "hardware",
    0x60: "software", 0x61: "internal software", 0x62: "user software", 0x63: "data set",
    0x70: "additional modules", 0x80: "monitoring", 0x81: "communication", 0x82: "protocol",
    0x90: "external error", 0xF0: "additional functions", 0xFF: "device specific",
}  # fmt: skip
"""By the high byte of the emergency code (CiA 301, table 26)."""


class CanopenWords:
    """Says what a frame of the predefined connection set means.

    Args:
        is_own: Whether nodes, EMCY's manufacturer bytes and objects are this project's.
        drives: Names of the car's motor drives, by node id.
    """

    def __init__(self, *, is_own: bool = True, drives: Mapping[int, str] = NO_DRIVES) -> None:
        self._is_own = is_own
        self._drives = drives
        self._names = {**(_NODE_NAMES if is_own else {}), **drives}

    def say(self, can_id: int, data: bytes) -> str | None:
        """The words for a data frame with an 11-bit identifier; None if it is none of CANopen's.

        A PDO's words are only its number and node, unless it is a drive's: what it carries, the DBC
        says.
        """
        node_id, function = can_id & _NODE_MASK, can_id & ~_NODE_MASK
        if can_id == NMT_ID:
            return self._nmt(data)
        if can_id == TIME_ID:
            return "TIME"
        if function == EMCY_ID:
            return self._emcy(node_id, data) if node_id else "SYNC"
        if not node_id:
            return None
        if function == HEARTBEAT_ID:
            return self._heartbeat(node_id, data)
        if function in (SDO_RESPONSE_ID, SDO_REQUEST_ID):
            return self._sdo(node_id, data, is_request=function == SDO_REQUEST_ID)
        if function in PDO_IDS:
            return self._pdo(function, node_id, data)
        return None

    def _node(self, node_id: int) -> str:
        return self._names.get(node_id) or f"node {node_id}"

    def _pdo(self, function: int, node_id: int, data: bytes) -> str:
        words = f"{PDO_IDS[function]} of {self._node(node_id)}"
        if node_id not in self._drives:
            return words
        from telemetry.monitor.drive_words import drive_words

        said = drive_words(function, data)
        return words if said is None else f"{words}: {said}"

    def _nmt(self, data: bytes) -> str:
        if len(data) != 2 or data[1] > NODE_ID_MAX:
            return "NMT: malformed"
        command, node_id = data
        what = _NMT_TEXT.get(command, f"unknown command {command}")  # type: ignore[call-overload]
        return f"NMT: {what}: {self._node(node_id) if node_id else 'all nodes'}"

    def _heartbeat(self, node_id: int, data: bytes) -> str:
        if len(data) != 1:
            return f"heartbeat of {self._node(node_id)}: malformed"
        if data[0] == NmtState.INITIALISING:
            return f"boot-up of {self._node(node_id)}"
        try:  # the highest bit is node guarding's toggle
            state = NmtState(data[0] & 0x7F).name.replace("_", "-").lower()
        except ValueError:
            state = f"unknown state {data[0]}"
        return f"heartbeat of {self._node(node_id)}: {state}"

    def _emcy(self, node_id: int, data: bytes) -> str:
        who = f"EMCY of {self._node(node_id)}"
        if len(data) != EMCY_BYTES:
            return f"{who}: malformed"
        error, register, code, reason, bits = _EMCY.unpack_from(data)
        if not error:
            still = f", latched {_codes(bits)}" if self._is_own and bits else ""
            return f"{who}: error reset{still}"
        if self._is_own and error & EMCY_DEVICE == EMCY_DEVICE:
            name = ErrorCode(code).name if code in list(ErrorCode) else f"code {code}"
            why = REASON_TEXT[Reason(reason)] if reason in list(Reason) else f"reason {reason}"
            return f"{who}: {name}: {why}; latched {_codes(bits) or 'none'}"
        rest = data[3:].hex(" ").upper()
        return f"{who}: {error_text(error)}, register 0x{register:02X}, {rest}"

    def _sdo(self, node_id: int, data: bytes, *, is_request: bool) -> str:
        from telemetry.monitor.sdo_words import sdo_words  # reads EDS files

        node = self._node(node_id)
        device = "Drive" if node_id in self._drives else node if self._is_own else ""
        said = sdo_words(data, device, is_request=is_request)
        return f"SDO {'to' if is_request else 'from'} {node}: {said}"


def error_text(error: int) -> str:
    """An emergency code with its class: `0x2310 current, output side`."""
    kind = _EMCY_CLASS.get(error >> 8) or _EMCY_CLASS.get(error >> 8 & 0xF0, "unknown")
    return f"0x{error:04X} {kind}"


def _codes(bits: int) -> str:
    return " ".join(f"ER{n}" for n in range(7) if bits >> n & 1)
