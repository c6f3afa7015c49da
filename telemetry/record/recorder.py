"""A recording: batches into a file, a new file when one is large or old enough."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from canbus.heard import Heard
from telemetry.record.formats import Format, Losses, Setting, Writer
from telemetry.record.log_file import LogFile, LogFullError

BATCH_NS: Final = 250_000_000
"""Frames are kept in memory for so long at most: what a crash may cost, with what is being written.
A batch costs the decoding writers as much as some hundred frames."""
BATCH_FRAMES_MAX: Final = 10_000


class RecordingError(Exception):
    """A recording that had to end, or cannot begin: file and reason in one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rotation:
    """When a new file is begun, and how many stay; None: never, and all.

    Attributes:
        size_bytes: Once a file has so many; it may have a batch more.
        age_ns: Once a file is so old.
        files_max: The oldest of this recording goes when there are more.
    """

    size_bytes: int | None = None
    age_ns: int | None = None
    files_max: int | None = None

    @property
    def is_wanted(self) -> bool:
        """Whether there may be several files."""
        return self.size_bytes is not None or self.age_ns is not None


class Recorder:
    """Takes frames as they are heard; `close` completes the last file.

    Args:
        path: The file; with rotation, `drive-0001.log` and so on in place of `drive.log`.
        kind: Its format.
        setting: For the writers.
        rotation: When to begin new files.
        now_ns: Monotonic time.

    Raises:
        RecordingError: The file exists, or cannot be made.
    """

    def __init__(
        self, path: Path, kind: Format, setting: Setting, rotation: Rotation, now_ns: int
    ) -> None:
        self._path = path
        self._format = kind
        self._setting = setting
        self._rotation = rotation
        self._batch: list[Heard] = []
        self._batch_ns = now_ns
        self._begun = 0
        self._paths: deque[Path] = deque()
        self.frames = 0
        """In the files."""
        self.losses = Losses(kind, with_times=False)
        self._open(now_ns)

    @property
    def paths(self) -> Sequence[Path]:
        """The files, the oldest first, without those that had to go."""
        return tuple(self._paths)

    def add(self, frames: Sequence[Heard], now_ns: int) -> None:
        """Takes what was heard, none if the bus is silent.

        Raises:
            RecordingError: It could not be written; the file is closed, and holds what came before.
        """
        self._batch += frames
        if now_ns - self._batch_ns >= BATCH_NS or len(self._batch) >= BATCH_FRAMES_MAX:
            self._write(now_ns)
            if self._is_due(now_ns):
                self._close()
                self._open(now_ns)

    def close(self, now_ns: int) -> None:
        """Writes what is left and completes the file.

        Raises:
            RecordingError: It did not fit; the file is closed nevertheless.
        """
        self._write(now_ns)
        self._close()

    def _write(self, now_ns: int) -> None:
        batch, self._batch = self._batch, []
        self._batch_ns = now_ns
        if not batch:
            return
        try:
            self._writer.write(batch)
        except LogFullError as error:
            self._end(error, len(batch))
        self.losses.count(batch)
        self.frames += len(batch)

    def _close(self) -> None:
        try:
            self.frames -= self._writer.close()
        except LogFullError as error:
            self._end(error, 0)

    def _end(self, error: LogFullError, lost: int) -> None:
        """Closes as far as that goes, and says so."""
        with suppress(LogFullError):
            lost += self._writer.close()
        self._file.close()
        raise RecordingError(
            f"{self._file.path}: {error.strerror}: the recording ends here; the file is closed, "
            f"the last {lost} frames are not in it"
        ) from error

    def _is_due(self, now_ns: int) -> bool:
        size_bytes, age_ns = self._rotation.size_bytes, self._rotation.age_ns
        is_large = size_bytes is not None and self._file.size >= size_bytes
        return is_large or (age_ns is not None and now_ns - self._opened_ns >= age_ns)

    def _open(self, now_ns: int) -> None:
        self._begun += 1
        path = self._path
        if self._rotation.is_wanted:
            path = path.with_name(f"{path.stem}-{self._begun:04d}{path.suffix}")
        try:
            self._file = LogFile(path)
            self._writer: Writer = self._format.open(self._file, self._setting)
            files_max = self._rotation.files_max
            if files_max is not None and len(self._paths) >= files_max:
                self._paths.popleft().unlink(missing_ok=True)
        except FileExistsError as error:
            raise RecordingError(f"{path} exists: name another file") from error
        except OSError as error:
            raise RecordingError(f"{path} cannot be written: {error.strerror}") from error
        self._paths.append(path)
        self._opened_ns = now_ns
