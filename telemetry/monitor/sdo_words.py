"""SDO frames in words (CiA 301, 7.2.4.3), with the objects' names and values."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from canbus.canopen_protocol import SDO_BYTES
from telemetry.monitor.object_names import object_name, object_value
from telemetry.monitor.sdo_aborts import ABORT_TEXT

_MULTIPLEXER: Final = struct.Struct("<BHB")
_EXPEDITED: Final = 0x02
_SIZE_GIVEN: Final = 0x01


def sdo_words(data: bytes, node: str, *, is_request: bool) -> str:
    """What an SDO frame says.

    Args:
        data: Of the frame.
        node: DBC name of the server, whose EDS names the objects; empty if it is not known.
        is_request: Whether the client sent it.
    """
    if len(data) != SDO_BYTES:
        return "malformed"
    command, index, subindex = _MULTIPLEXER.unpack_from(data)
    say = (_REQUESTS if is_request else _RESPONSES).get(command >> 5)
    return f"unknown command 0x{command:02X}" if say is None else say(node, index, subindex, data)


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
