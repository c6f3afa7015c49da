"""CANopen in words (CiA 301): NMT, heartbeats, EMCY, SDO with the objects' names, PDO."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from canbus.canopen_protocol import (
    HEARTBEAT_ID,
    NMT_ID,
    NODE_ID_MAX,
    SDO_BYTES,
    SDO_REQUEST_ID,
    SDO_RESPONSE_ID,
    NmtCommand,
    NmtState,
)
from canbus.node import NODE_IDS
from dbc.messages import ErrorCode, Reason
from gateway.sentences import REASON_TEXT
from telemetry.monitor.object_names import object_name, object_value
from telemetry.monitor.sdo_aborts import ABORT_TEXT

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

_NODE_MASK: Final = 0x7F
_MULTIPLEXER: Final = struct.Struct("<BHB")
_EXPEDITED: Final = 0x02
_SIZE_GIVEN: Final = 0x01
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
    """

    def __init__(self, *, is_own: bool = True) -> None:
        self._is_own = is_own

    def say(self, can_id: int, data: bytes) -> str | None:
        """The words for a data frame with an 11-bit identifier; None if it is none of CANopen's.

        A PDO's words are only its number and node: what it carries, the DBC says.
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
            return f"{PDO_IDS[function]} of {self._node(node_id)}"
        return None

    def _node(self, node_id: int) -> str:
        name = _NODE_NAMES.get(node_id) if self._is_own else None
        return name or f"node {node_id}"

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
        kind = _EMCY_CLASS.get(error >> 8) or _EMCY_CLASS.get(error >> 8 & 0xF0, "unknown")
        rest = data[3:].hex(" ").upper()
        return f"{who}: 0x{error:04X} {kind}, register 0x{register:02X}, {rest}"

    def _sdo(self, node_id: int, data: bytes, *, is_request: bool) -> str:
        who = f"SDO {'to' if is_request else 'from'} {self._node(node_id)}"
        if len(data) != SDO_BYTES:
            return f"{who}: malformed"
        command, index, subindex = _MULTIPLEXER.unpack_from(data)
        say = (_REQUESTS if is_request else _RESPONSES).get(command >> 5)
        if say is None:
            return f"{who}: unknown command 0x{command:02X}"
        product = self._node(node_id) if self._is_own else ""
        return f"{who}: {say(product, index, subindex, data)}"


def _codes(bits: int) -> str:
    return " ".join(f"ER{n}" for n in range(7) if bits >> n & 1)


_Say = Callable[[str, int, int, bytes], str]
"""Words for a node, an index, a sub-index and the whole frame."""


def _abort(node: str, index: int, subindex: int, data: bytes) -> str:
    code = int.from_bytes(data[4:], "little")
    why = ABORT_TEXT.get(code, "unknown abort code")
    return f"abort {object_name(node, index, subindex)}: {why} (0x{code:08X})"


def _transfer(verb: str) -> _Say:
    """A transfer's start: with the value if that fits, or with the length that is to come."""

    def say(node: str, index: int, subindex: int, data: bytes) -> str:
        target, command = object_name(node, index, subindex), data[0]
        if not command & _EXPEDITED:
            size = int.from_bytes(data[4:], "little")
            return f"{verb} {target} in segments" + f", {size} bytes" * (command & _SIZE_GIVEN)
        size = 4 - (command >> 2 & 3) if command & _SIZE_GIVEN else 4
        return f"{verb} {target} = {object_value(node, index, subindex, data[4 : 4 + size])}"

    return say


def _about_object(verb: str) -> _Say:
    return lambda node, index, subindex, data: f"{verb} {object_name(node, index, subindex)}"


def _segment(verb: str) -> _Say:
    def say(node: str, index: int, subindex: int, data: bytes) -> str:
        content = data[1 : 8 - (data[0] >> 1 & 7)]
        text = content.decode("ascii", errors="replace")
        shown = repr(text) if text.isprintable() and text.isascii() else content.hex(" ").upper()
        return f"{verb} segment {shown}" + ", the last" * (data[0] & 1)

    return say


def _plain(text: str) -> _Say:
    return lambda node, index, subindex, data: text


_REQUESTS: Final[dict[int, _Say]] = {
    0: _segment("write"),
    1: _transfer("write"),
    2: _about_object("read"),
    3: _plain("read the next segment"),
    4: _abort,
    5: _plain("block read"),
    6: _plain("block write"),
}
"""By client command specifier (CiA 301, 7.2.4.3)."""
_RESPONSES: Final[dict[int, _Say]] = {
    0: _segment("read"),
    1: _plain("segment written"),
    2: _transfer("answer"),
    3: _about_object("written"),
    4: _abort,
    5: _plain("block write"),
    6: _plain("block read"),
}
"""By server command specifier."""
