"""A log file that is written batch by batch: a batch is in it whole, or not at all."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any, Final

MODE: Final = 0o666
"""As far as the umask allows."""


class LogFullError(OSError):
    """A log could not be written any further: disk full, quota, or a medium that is gone."""


class LogFile(io.RawIOBase):
    """A new file; what is written to it is kept in memory until `commit`.

    When a commit fails, the file is cut back to what it held before, and takes nothing more at its
    end: what a format writes on closing goes nowhere, but places within it can be written again.
    An unwritten batch costs less than a log that no program reads. Nothing is forced out to the
    medium before `close`: what was committed survives this process, not a loss of power.

    Args:
        path: Must not exist.

    Raises:
        OSError: It exists, or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_full = False
        self.size = 0
        """Bytes in the file."""
        self._pending = bytearray()
        self._place = 0
        self._number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, MODE)

    def writable(self) -> bool:
        """It is."""
        return True

    def seekable(self) -> bool:
        """It is, for headers that are completed in the end."""
        return True

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._place + len(self._pending)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Goes to a place counted from the beginning, after a commit."""
        assert whence == os.SEEK_SET
        self.commit()
        self._place = offset
        return offset

    def write(self, data: Any) -> int:
        """Takes bytes in; never fails."""
        if not (self.is_full and self.tell() >= self.size):
            self._pending += data
        return len(data)

    def commit(self) -> None:
        """Writes what was taken in.

        Raises:
            LogFullError: It did not fit, and none of it is in the file.
        """
        written = 0
        pending, self._pending = memoryview(bytes(self._pending)), bytearray()
        try:
            while written < len(pending):
                written += os.pwrite(self._number, pending[written:], self._place + written)
        except OSError as error:
            self.cut(self.size)
            self.is_full = True
            raise LogFullError(error.errno, error.strerror, str(self.path)) from error
        self._place += written
        self.size = max(self.size, self._place)

    def cut(self, size: int) -> None:
        """Takes away what lies behind `size`; there is room again then."""
        os.ftruncate(self._number, size)
        self.size = self._place = size
        self.is_full = False

    def close(self) -> None:
        """Commits, forces all of it out to the medium and closes; closing twice is harmless."""
        if self.closed:
            return
        try:
            self.commit()
            os.fsync(self._number)
        finally:
            os.close(self._number)
            super().close()
