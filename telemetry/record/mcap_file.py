"""The container of an MCAP file (mcap.dev/spec), written chunk by chunk with the library's records.

The library's own writer takes one message at a time, which costs more than all the rest of a
recording, and decides for itself when a chunk is whole. Here a chunk is what the caller has
gathered: after a crash the file is readable to its last chunk.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from telemetry.record.log_file import LogFile, LogFullError

LIBRARY: Final = "can-by-wire"
COMPRESSION: Final = "zstd"
COMPRESSION_LEVEL: Final = 1
_MESSAGE: Final = struct.Struct("<BQHIQQ")
"""Opcode, length of what follows, channel, sequence, time of logging, time of publishing."""
_MESSAGE_HEAD_BYTES: Final = 22
_INDEX: Final = struct.Struct("<BQHI")
_INDEX_HEAD_BYTES: Final = 6
_FOOTER: Final = struct.Struct("<BQQQ")
_FOOTER_BYTES: Final = 20
_PAIR_BYTES: Final = 16
_MESSAGE_OPCODE: Final = int(Opcode.MESSAGE)
NO_TIME: Final = 0


@dataclass(slots=True)
class Messages:
    """Messages of a chunk, in parallel lists.

    Attributes:
        channels: Their numbers.
        times_ns: Since 1970.
        texts: JSON.
    """

    channels: list[int] = field(default_factory=list)
    times_ns: list[int] = field(default_factory=list)
    texts: list[bytes] = field(default_factory=list)


@dataclass(slots=True)
class _Written:
    """A chunk in the file."""

    start: int
    index: ChunkIndex
    counts: Mapping[int, int]


class McapFile:
    """One file, its chunks, and in the end its summary.

    Args:
        file: Empty, and open.
    """

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._new: list[McapRecord] = []
        self._chunks: list[_Written] = []
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        file.write(MCAP0_MAGIC + _packed([Header(profile="", library=LIBRARY)]))

    def add_channel(
        self, topic: str, schema_name: str, schema: bytes, metadata: Mapping[str, str]
    ) -> int:
        """A channel of JSON and its schema, known to the next chunk; answers its number."""
        known = next((s for s in self._schemas if (s.name, s.data) == (schema_name, schema)), None)
        if known is None:
            known = Schema(
                id=len(self._schemas) + 1, name=schema_name, encoding="jsonschema", data=schema
            )
            self._schemas.append(known)
            self._new.append(known)
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding="json",
            schema_id=known.id, metadata=dict(metadata),
        )  # fmt: skip
        self._channels.append(channel)
        self._new.append(channel)
        return channel.id

    def write_chunk(self, messages: Messages) -> None:
        """Writes messages as one chunk; none is written for none.

        Raises:
            LogFullError: It did not fit; the file is as before.
        """
        if not messages.texts:
            return
        head = _packed(self._new)
        rows = zip(messages.channels, messages.times_ns, messages.texts, strict=True)
        pieces = [b""] * (2 * len(messages.texts))
        pieces[::2] = [
            _MESSAGE.pack(_MESSAGE_OPCODE, _MESSAGE_HEAD_BYTES + len(text), channel, 0, at, at)
            for channel, at, text in rows
        ]
        pieces[1::2] = messages.texts
        written = self._append(head + b"".join(pieces), len(head), messages)
        self._file.commit()
        self._new.clear()
        self._chunks.append(written)

    def _append(self, content: bytes, first: int, messages: Messages) -> _Written:
        """A chunk whose messages begin at `first`, and their indices."""
        start = self._file.tell()
        times = np.array(messages.times_ns, "<u8")
        sizes = np.array([_MESSAGE.size + len(text) for text in messages.texts], np.int64)
        entries = np.column_stack((times, (first + np.cumsum(sizes) - sizes).astype("<u8")))
        first_ns, last_ns = int(times.min()), int(times.max())
        data = self._compressor.compress(content)
        self._file.write(_packed([Chunk(
            compression=COMPRESSION, data=data, message_start_time=first_ns,
            message_end_time=last_ns, uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )]))  # fmt: skip
        end = self._file.tell()
        offsets: dict[int, int] = {}
        counts: dict[int, int] = {}
        channels = np.array(messages.channels, np.uint16)
        for channel in np.unique(channels).tolist():
            pairs = entries[channels == channel].tobytes()
            offsets[channel] = self._file.tell()
            counts[channel] = len(pairs) // _PAIR_BYTES
            self._file.write(_INDEX.pack(
                Opcode.MESSAGE_INDEX, _INDEX_HEAD_BYTES + len(pairs), channel, len(pairs)
            ) + pairs)  # fmt: skip
        index = ChunkIndex(
            chunk_start_offset=start, chunk_length=end - start, compression=COMPRESSION,
            compressed_size=len(data), uncompressed_size=len(content),
            message_start_time=first_ns, message_end_time=last_ns,
            message_index_offsets=offsets, message_index_length=self._file.tell() - end,
        )  # fmt: skip
        return _Written(start, index, counts)

    def close(self) -> dict[int, int]:
        """Writes the summary and closes the file.

        A summary that does not fit takes the room of the last chunks.

        Returns:
            By channel, how many messages had to go for it.
        """
        dropped: dict[int, int] = {}
        if self._file.is_full:
            self._file.cut(self._file.size)
        while True:
            try:
                self._write_summary()
                self._file.commit()
                break
            except LogFullError:
                if not self._chunks:
                    break
                chunk = self._chunks.pop()
                for channel, count in chunk.counts.items():
                    dropped[channel] = dropped.get(channel, 0) + count
                self._file.cut(chunk.start)
        self._file.close()
        return dropped

    def _write_summary(self) -> None:
        self._file.write(_packed([DataEnd(data_section_crc=0)]))
        start = self._file.tell()
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [chunk.index for chunk in self._chunks]),
        ]
        summary, offsets = b"", []
        for opcode, records in groups:
            packed = _packed(records)
            offsets.append(SummaryOffset(
                group_opcode=opcode, group_start=start + len(summary), group_length=len(packed),
            ))  # fmt: skip
            summary += packed
        offsets_start = start + len(summary)
        summary += _packed(offsets)
        crc = zlib.crc32(summary)
        crc = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, _FOOTER_BYTES, start, offsets_start), crc)
        footer = Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc)
        self._file.write(summary + _packed([footer]) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        counts: dict[int, int] = {}
        for chunk in self._chunks:
            for channel, count in chunk.counts.items():
                counts[channel] = counts.get(channel, 0) + count
        indices = [chunk.index for chunk in self._chunks]
        return Statistics(
            attachment_count=0, metadata_count=0, channel_count=len(self._channels),
            schema_count=len(self._schemas), chunk_count=len(indices),
            channel_message_counts=counts, message_count=sum(counts.values()),
            message_start_time=min((i.message_start_time for i in indices), default=NO_TIME),
            message_end_time=max((i.message_end_time for i in indices), default=NO_TIME),
        )  # fmt: skip


def _packed(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    packed: bytes = builder.end()  # type: ignore[no-untyped-call]
    return packed
