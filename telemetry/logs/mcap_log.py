"""MCAP files of `dbw record`: the channels of raw frames, read from the beginning on.

A file that was cut off has no summary, on which the library's seeking reader insists; its records
are read one by one here, until one of them is not whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mcap.records import Channel, Footer, Message, Schema
from mcap.stream_reader import StreamReader

from telemetry.logs.frames import ChannelNames, FrameColumns, LogFrame, columns_of
from telemetry.logs.mcap_raw import BUS_KEY, RAW_SCHEMA_NAME, frame_of_json
from telemetry.logs.problems import Problems

CHUNK_FRAMES: Final = 10_000
RECORD_BYTES_MAX: Final = 1 << 30


def read_mcap(path: Path, channels: ChannelNames, problems: Problems) -> Iterator[FrameColumns]:
    """Frames of a file, a chunk at a time.

    Args:
        path: The file.
        channels: Names of channels, filled as they come.
        problems: Is told what could not be read.
    """
    reader = _Reader(problems)
    frames: list[LogFrame] = []
    places: list[int] = []
    with path.open("rb") as file:
        records = StreamReader(file, validate_crcs=True, record_size_limit=RECORD_BYTES_MAX).records
        while True:
            try:
                record = next(records, None)
            except Exception as error:  # a reader that is fed anything raises anything
                reason = str(error) or type(error).__name__
                problems.remark(f"reading ends after frame {reader.number}, cut off? {reason}")
                break
            if record is None:
                break
            frame = reader.frame(record)
            if frame is not None:
                frames.append(frame)
                places.append(reader.number)
            if len(frames) == CHUNK_FRAMES:
                yield columns_of(frames, places, channels)
                frames, places = [], []
    if frames:
        yield columns_of(frames, places, channels)
    reader.tell()


class _Reader:
    """Knows the schemas and channels that came so far."""

    def __init__(self, problems: Problems) -> None:
        self._problems = problems
        self._raw_schemas: set[int] = set()
        self._bus: dict[int, str] = {}
        self._others = 0
        self._is_complete = False
        self.number = 0

    def frame(self, record: object) -> LogFrame | None:
        """The frame of a record, if it is one."""
        if isinstance(record, Message):
            return self._of_message(record)
        if isinstance(record, Schema):
            if record.name == RAW_SCHEMA_NAME:
                self._raw_schemas.add(record.id)
        elif isinstance(record, Channel):
            if record.schema_id in self._raw_schemas:
                self._bus[record.id] = record.metadata.get(BUS_KEY, record.topic)
        elif isinstance(record, Footer):
            self._is_complete = True
        return None

    def _of_message(self, message: Message) -> LogFrame | None:
        bus = self._bus.get(message.channel_id)
        if bus is None:
            self._others += 1
            return None
        self.number += 1
        try:
            return frame_of_json(message.data, message.log_time, bus)
        except (ValueError, KeyError, TypeError) as error:
            self._problems.add(self.number, f"no frame: {type(error).__name__}")
            return None

    def tell(self) -> None:
        """What the file as a whole lacks."""
        if not self._is_complete:
            self._problems.remark("the file has no end: it was not closed, or is cut off")
        if self._others and not self.number:
            self._problems.remark(
                f"{self._others} messages, and none is a frame: dbw reads its own raw frames alone"
            )
