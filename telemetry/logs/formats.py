"""Which format a log is of, by what it begins with."""

from __future__ import annotations

from pathlib import Path
from typing import Final

GZIP: Final = b"\x1f\x8b"
CANDUMP: Final = "candump"
BEGINNINGS: Final = (
    (b"LOGG", "blf"), (b";$FILEVERSION", "trc"), (b"date ", "asc"), (b"base ", "asc"),
    (b"\x89MCAP0\r\n", "mcap"), (b"MDF ", "mf4"), (b"UnFinMF ", "mf4"),
)  # fmt: skip
"""What a file of a format begins with; anything else is taken for candump's text."""
FOREIGN: Final = (
    (b"SQLite format 3", "SQLite"), (b"PK\x03\x04", "a ZIP archive"), (b"\x7fELF", "a program"),
)  # fmt: skip
FORMATS: Final = "candump (also .gz), ASC, BLF, TRC, MCAP and MF4"
HEAD_BYTES: Final = 64


class LogError(ValueError):
    """A log that cannot be read at all: the file and the reason in one line."""


def head_of(path: Path) -> bytes:
    """What a file begins with.

    Raises:
        LogError: It cannot be opened, or is of a format that is not known here.
    """
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    for beginning, what in FOREIGN:
        if head.startswith(beginning):
            raise LogError(f"{path}: {what} cannot be read here: {FORMATS} can")
    return head


def format_of(head: bytes) -> str:
    """The format: `candump`, `asc`, `blf`, `trc`, `mcap` or `mf4`."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return next((kind for mark, kind in BEGINNINGS if text.startswith(mark)), CANDUMP)
