"""MCAP: a channel and a schema for each message of the DBC, and one of raw frames for each bus.

Values are JSON, under the names of the signals; `mode_name` beside `mode` is the name of a value.
What the sender did not have is left out. Frames are decoded column by column, a batch at a time.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any, Final

from canbus.heard import Heard
from telemetry.databases import Databases
from telemetry.decode.export import columns_of
from telemetry.decode.tables import Decoder, Names, Table
from telemetry.logs.frames import ChannelNames, columns_of_heard
from telemetry.logs.mcap_raw import BUS_KEY, RAW_SCHEMA_NAME, raw_json, raw_schema
from telemetry.record.log_file import LogFile
from telemetry.record.mcap_file import McapFile, Messages
from telemetry.schemas import schema_of

NOT_SIGNALS: Final = ("time_ns", "channel")


class McapWriter:
    """See `telemetry.record.formats.Writer`.

    Args:
        file: Empty, and open.
        databases: What to decode with.
    """

    def __init__(self, file: LogFile, databases: Databases) -> None:
        self._mcap = McapFile(file)
        self._decoder = Decoder(databases)
        self._channels = ChannelNames()
        self._raw: dict[str, int] = {}
        self._decoded: dict[tuple[str, str], int] = {}

    def write(self, frames: Sequence[Heard]) -> None:
        """Writes a chunk: the frames as they are, and what they say."""
        raw = {bus: self._raw_channel(bus) for bus in {item.channel for item in frames}}
        messages = Messages(
            channels=[raw[item.channel] for item in frames],
            times_ns=[max(0, item.time_ns) for item in frames],
            texts=[raw_json(item) for item in frames],
        )
        decoded = self._decoder.decode(columns_of_heard(frames, self._channels))
        for table in decoded.tables.values():
            self._add(table, messages)
        self._mcap.write_chunk(messages)

    def close(self) -> int:
        """Completes the file; answers how many frames had to go for that."""
        dropped = self._mcap.close()
        return sum(dropped.get(channel, 0) for channel in self._raw.values())

    def _raw_channel(self, bus: str) -> int:
        if bus not in self._raw:
            self._raw[bus] = self._mcap.add_channel(
                f"/{bus}/raw", RAW_SCHEMA_NAME, raw_schema(), {BUS_KEY: bus}
            )
        return self._raw[bus]

    def _add(self, table: Table, messages: Messages) -> None:
        buses = table.frames.channels
        places = table.frames.channel.tolist()
        numbers = {place: self._channel_of(buses[place], table) for place in set(places)}
        messages.channels += [numbers[place] for place in places]
        messages.times_ns += table.frames.time_ns.clip(0).tolist()
        messages.texts += json_rows(table)

    def _channel_of(self, bus: str, table: Table) -> int:
        message = table.message
        key = bus, message.name
        if key not in self._decoded:
            metadata = {BUS_KEY: bus, "id": f"0x{message.frame_id:X}",
                        "sender": ", ".join(message.senders)}  # fmt: skip
            has_verdict = table.protection is not None
            schema = json.dumps(schema_of(message, has_verdict=has_verdict)).encode()
            self._decoded[key] = self._mcap.add_channel(
                f"/{bus}/{message.name}", message.name, schema, metadata
            )
        return self._decoded[key]


def json_rows(table: Table) -> list[bytes]:
    """A JSON object for each frame of a message."""
    columns = [
        _fragments(name, column)
        for name, column in columns_of(table).items()
        if name not in NOT_SIGNALS
    ]
    if not columns:
        return [b"{}"] * len(table.rows)
    return [f"{{{''.join(row)[:-1]}}}".encode() for row in zip(*columns, strict=True)]


def _fragments(name: str, column: Any) -> list[str]:
    """Of each row `"name":value,`, or nothing where there is no value."""
    key = json.dumps(name)
    if isinstance(column, Names):
        texts = [f"{key}:{json.dumps(text)}," if text else "" for text in column.texts]
        return [texts[place] for place in column.places.tolist()]
    if column.dtype.kind != "f":
        return [f"{key}:{value}," for value in column.tolist()]
    finite = math.isfinite
    return [f"{key}:{value:.12g}," if finite(value) else "" for value in column.tolist()]
