"""The channel of an MCAP file that holds every frame as it was on the bus: its JSON, both ways."""

from __future__ import annotations

import json
from functools import cache
from typing import Any, Final

from canbus.heard import EXTENDED_ID_MAX, Heard
from telemetry.logs.frames import FrameFlag, LogFrame, flags_of

RAW_SCHEMA_NAME: Final = "can_by_wire.RawFrame"
BUS_KEY: Final = "bus"
"""Of a channel's metadata: the name of the CAN channel."""
_FLAG_OF_KEY: Final = {
    "extended": FrameFlag.EXTENDED, "remote": FrameFlag.REMOTE, "error": FrameFlag.ERROR,
    "fd": FrameFlag.FD, "bitrate_switch": FrameFlag.BITRATE_SWITCH,
    "error_state": FrameFlag.ERROR_STATE, "sent": FrameFlag.SENT,
}  # fmt: skip


def raw_schema() -> bytes:
    """The JSON schema."""
    properties: dict[str, Any] = {
        "id": {"type": "integer"},
        "length": {"type": "integer", "description": "bytes; of a remote frame, those asked for"},
        "data": {"type": "string", "description": "hexadecimal"},
    }
    properties |= {key: {"type": "boolean"} for key in _FLAG_OF_KEY}
    return json.dumps({"type": "object", "properties": properties}).encode()


def raw_json(item: Heard) -> bytes:
    """A frame."""
    tail = _tail(item.word >> 29, item.fd_flags, item.is_sent)
    can_id = item.word & EXTENDED_ID_MAX
    return f'{{"id":{can_id},"length":{item.length},"data":"{item.data.hex()}"{tail}'.encode()


@cache
def _tail(word_flags: int, fd_flags: int, is_sent: bool) -> str:
    """The flags, of which there are few different sets."""
    flags = flags_of(Heard(0, "", word_flags << 29, b"", 0, fd_flags, is_sent))
    pairs = (f',"{key}":{json.dumps(flag in flags)}' for key, flag in _FLAG_OF_KEY.items())
    return "".join(pairs) + "}"


def frame_of_json(text: bytes, time_ns: int, channel: str) -> LogFrame:
    """The frame again.

    Raises:
        ValueError, KeyError, TypeError: It is none.
    """
    content = json.loads(text)
    flags = FrameFlag(sum(flag for key, flag in _FLAG_OF_KEY.items() if content[key]))
    data = bytes.fromhex(content["data"])
    return LogFrame(time_ns, channel, int(content["id"]), flags, int(content["length"]), data)
