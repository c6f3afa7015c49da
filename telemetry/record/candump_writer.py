"""A log of `candump -L`: a line for each frame, ` T` behind those that this computer sent."""

from __future__ import annotations

from collections.abc import Sequence

from canbus.candump import log_line
from canbus.heard import Heard
from telemetry.record.log_file import LogFile


class CandumpWriter:
    """See `telemetry.record.formats.Writer`."""

    def __init__(self, file: LogFile) -> None:
        self._file = file

    def write(self, frames: Sequence[Heard]) -> None:
        """Writes lines."""
        lines = [log_line(item) + (" T\n" if item.is_sent else "\n") for item in frames]
        self._file.write("".join(lines).encode("ascii", errors="replace"))
        self._file.commit()

    def close(self) -> int:
        """Closes the file."""
        self._file.close()
        return 0
