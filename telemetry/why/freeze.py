"""Freeze frames: for each error code that comes up, every frame of the second before and after.

Kept on disk across restarts, one JSON file each, written beside its place and moved there, bounded
in number and size: the oldest go first, the newest of each code stays.
"""

from __future__ import annotations

import json
import os
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dbc.database import dbc_hash
from telemetry.why.watch import CodeOnset
from telemetry.why.window import Window
from telemetry.why.words import signals_of

VERSION: Final = 1
COUNT_MAX: Final = 64
BYTES_MAX: Final = 32_000_000
"""Of all files together: some 300 kB each on our own bus."""
FRAMES_MAX: Final = 10_000
"""Of one freeze frame: what a full bus of 500 kbit/s carries; of more, those next to the code."""
NS_PER_S: Final = 1_000_000_000

_NAME: Final = re.compile(r"(\d{6})-(ER\d)\.json")


class FreezeError(OSError):
    """A freeze frame that cannot be written or read; one line with path and reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """One file of the store. `number` goes up with every one ever written."""

    number: int
    code: str
    path: Path
    size: int


def default_folder(environment: Mapping[str, str]) -> Path:
    """`$XDG_STATE_HOME/can-by-wire/freeze-frames`, by default in `~/.local/state` (XDG Base
    Directory Specification: state that should persist between restarts)."""
    home = environment.get("XDG_STATE_HOME", "")
    base = Path(home) if home.startswith("/") else Path.home() / ".local" / "state"
    return base / "can-by-wire" / "freeze-frames"


class FreezeStore:
    """The folder of the freeze frames.

    Args:
        folder: Made when the first one is written.
        count_max: Files kept; more only if there are more codes.
        bytes_max: Of all files; the newest of each code stays all the same.
    """

    def __init__(
        self, folder: Path, *, count_max: int = COUNT_MAX, bytes_max: int = BYTES_MAX
    ) -> None:
        self.folder = folder
        self._count_max = count_max
        self._bytes_max = bytes_max

    def entries(self) -> list[Stored]:
        """What is stored, oldest first; nothing where the folder is missing.

        Raises:
            FreezeError: The folder cannot be read.
        """
        found = []
        try:
            for path in self.folder.iterdir() if self.folder.exists() else ():
                name = _NAME.fullmatch(path.name)
                if name is not None:
                    size = path.stat().st_size
                    found.append(
                        Stored(number=int(name[1]), code=name[2], path=path, size=size)
                    )
        except OSError as error:
            raise FreezeError(f"{self.folder} cannot be read: {error.strerror}") from error
        return sorted(found, key=lambda item: item.number)

    def load(self, number: int) -> dict[str, Any]:
        """The document of one.

        Raises:
            FreezeError: There is none of this number, or it cannot be read.
        """
        for item in self.entries():
            if item.number == number:
                return read_document(item.path)
        known = ", ".join(str(item.number) for item in self.entries()) or "none"
        raise FreezeError(f"no freeze frame {number} in {self.folder}: stored are {known}")

    def add(self, onset: CodeOnset, *, unix_ns: int, channel: str) -> Stored:
        """Writes one down, in one step, and removes what is too much.

        Args:
            onset: The code, with its frames.
            unix_ns: The system's time at which it came up.
            channel: The bus.

        Raises:
            FreezeError: It cannot be written; what was there before is untouched.
        """
        document = freeze_document(onset, unix_ns=unix_ns, channel=channel)
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            stored = self._write(document, onset.code.name)
        except OSError as error:
            raise FreezeError(f"{self.folder} cannot be written: {error.strerror}") from error
        self._prune()
        return stored

    def _write(self, document: dict[str, Any], code: str) -> Stored:
        entries = self.entries()
        number = entries[-1].number + 1 if entries else 1
        descriptor, name = tempfile.mkstemp(prefix=".unfinished-", dir=self.folder)
        try:
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                json.dump(document, file, separators=(",", ":"))
                file.flush()
                os.fsync(file.fileno())
            while True:
                path = self.folder / f"{number:06d}-{code}.json"
                try:
                    os.link(name, path)  # unlike a rename it never replaces another's
                    break
                except FileExistsError:
                    number += 1
        finally:
            os.unlink(name)
        return Stored(number=number, code=code, path=path, size=path.stat().st_size)

    def _prune(self) -> None:
        entries = self.entries()
        newest = {item.code: item.number for item in entries}
        count, size = len(entries), sum(item.size for item in entries)
        for item in entries:
            if count <= self._count_max and size <= self._bytes_max:
                return
            if newest[item.code] != item.number:
                item.path.unlink(missing_ok=True)
                count, size = count - 1, size - item.size


def freeze_document(onset: CodeOnset, *, unix_ns: int, channel: str) -> dict[str, Any]:
    """What a file holds: raw frames and all signals; times in seconds from the code on."""
    frames = sorted(onset.frames, key=lambda item: abs(item[0] - onset.time_ns))[:FRAMES_MAX]
    window = Window(sorted(frames, key=lambda item: item[0]))
    signals: dict[str, dict[str, list[Any]]] = {}
    for row in window.rows:
        if row.spec is not None and row.content is not None:
            table = signals.setdefault(row.spec.name, {"at_s": []})
            table["at_s"].append(_at_s(row.time_ns, onset.time_ns))
            for name, value in signals_of(row.content).items():
                table.setdefault(name, []).append(value)
    return {
        "version": VERSION,
        "code": onset.code.name,
        "node": onset.node,
        "reason": onset.reason,
        "unix_s": round(unix_ns / NS_PER_S, 6),
        "channel": channel,
        "dbc_hash": f"{dbc_hash():08x}",
        "frames_left_out": len(onset.frames) - len(frames),
        "frames": [
            [_at_s(row.time_ns, onset.time_ns), str(row.frame)] for row in window.rows
        ],
        "signals": signals,
    }


def _at_s(time_ns: int, origin_ns: int) -> float:
    return round((time_ns - origin_ns) / NS_PER_S, 6)


def read_document(path: Path) -> dict[str, Any]:
    """The document in a file.

    Raises:
        FreezeError: It cannot be read, or is none.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FreezeError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise FreezeError(f"{path} is no freeze frame: {error}") from error
    wanted = {"version", "code", "node", "reason", "unix_s", "channel", "frames", "signals"}
    if not isinstance(document, dict) or not wanted <= document.keys():
        raise FreezeError(f"{path} is no freeze frame: keys are missing")
    if document["version"] != VERSION:
        raise FreezeError(f"{path} is of version {document['version']}: {VERSION} is known")
    return document
