"""DBC files, one or several, ours and foreign ones: strictly, or as far as they can be read.

Loading is strict unless asked otherwise: what is wrong in a file decides what its frames seem to
say. Relaxed loading leaves out what cannot be read and tells everything that it tolerated.
"""

from __future__ import annotations

import difflib
import logging
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from canbus.hidden import ASAMMDF, hidden
from dbc.database import BYTE_COMMANDS_DBC, HARNESS_DBC, VEHICLE_DBC, dbc_text
from telemetry.dbc_text import keyword, line_of_error, line_of_id, line_of_message, statement_at

with hidden(ASAMMDF):
    from cantools.database import load_string
    from cantools.database.can import Database, Message, Signal
    from cantools.database.errors import Error

__all__ = [
    "Database", "DatabaseError", "Databases", "Message", "Signal", "load_databases", "nearest",
]

OWN: Final = {
    name: file
    for file in (VEHICLE_DBC, HARNESS_DBC, BYTE_COMMANDS_DBC)
    for name in (file, file[:-4])
}
"""The project's own files by the names under which they can be asked for."""
LEFT_OUT_MAX: Final = 100
"""Statements that relaxed loading leaves out before it gives a file up."""
EXTENDED_BIT: Final = 1 << 31
"""Set by a DBC in the number of a message with a 29-bit identifier."""
EVERY_CHANNEL: Final = ""

_CHANNEL_AND_FILE: Final = re.compile(r"([\w.:-]+)=(.+)")


class DatabaseError(ValueError):
    """A DBC that cannot be used, or a name that is in none: file, line and reason in one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Source:
    """One file: its name as a person gave it, what it says, the channel that it is for."""

    name: str
    channel: str
    text: str
    is_own: bool
    """The vehicle bus's, as shipped."""


class Databases:
    """The messages of one or several DBC files.

    Attributes:
        messages: All of them, in the order of the files.
        databases: As cantools has parsed them, one for each file.
        notes: What relaxed loading tolerated, and what was done about names used twice; one line
            each.
    """

    def __init__(self) -> None:
        self.messages: list[Message] = []
        self.databases: list[Database] = []
        self.notes: list[str] = []
        self._by_id: dict[tuple[str, int, bool], Message] = {}
        self._by_name: dict[str, Message] = {}
        self._by_plain_name: dict[str, Message] = {}
        self._file_of: dict[int, _Source] = {}

    def find(self, can_id: int, is_extended: bool, channel: str = EVERY_CHANNEL) -> Message | None:
        """The message of an identifier; a file given for this very channel goes first."""
        found = self._by_id.get((channel, can_id, is_extended))
        return found or self._by_id.get((EVERY_CHANNEL, can_id, is_extended))

    def named(self, name: str) -> Message:
        """A message by its name; capitals and underscores do not count (`SteerStatus`).

        Raises:
            DatabaseError: There is none; the nearest names are told.
        """
        found = self._by_name.get(name) or self._by_plain_name.get(_plain(name))
        if found is None:
            raise DatabaseError(f"no message {name!r}{nearest(name, self._by_name)}")
        return found

    def signal(self, message: Message, name: str) -> Signal:
        """A signal of a message.

        Raises:
            DatabaseError: There is none; the nearest names are told.
        """
        found = next((signal for signal in message.signals if signal.name == name), None)
        if found is None:
            names = [signal.name for signal in message.signals]
            raise DatabaseError(f"{message.name} has no signal {name!r}{nearest(name, names)}")
        return found

    def of_node(self, name: str) -> list[Message]:
        """The messages that a node sends.

        Raises:
            DatabaseError: No node has this name; the nearest names are told.
        """
        nodes = {sender for message in self.messages for sender in message.senders}
        if name not in nodes:
            raise DatabaseError(f"no message of a node {name!r}{nearest(name, nodes)}")
        return [message for message in self.messages if name in message.senders]

    def is_own(self, message: Message) -> bool:
        """Whether a message is one of this project's vehicle bus, from the file as shipped."""
        return self._file_of[id(message)].is_own

    def _add(self, source: _Source, message: Message, *, relaxed: bool) -> None:
        key = (source.channel, message.frame_id, message.is_extended_frame)
        other = self._by_id.get(key)
        if other is not None:
            self._refuse_twice(source, message, other, relaxed=relaxed)
            return
        if message.name in self._by_name:
            new = f"{message.name}_{source.channel or hex(message.frame_id)}"
            while new in self._by_name:
                new += "_"
            self.notes.append(f"{source.name}: message {message.name} is called {new} here, since "
                              "its name is used twice")  # fmt: skip
            message.name = new
        self._by_id[key] = self._by_name[message.name] = message
        self._by_plain_name.setdefault(_plain(message.name), message)
        self._file_of[id(message)] = source
        self.messages.append(message)

    def _refuse_twice(
        self, source: _Source, message: Message, other: Message, *, relaxed: bool
    ) -> None:
        first = self._file_of[id(other)]
        lines = source.text.splitlines()
        number = message.frame_id | EXTENDED_BIT * message.is_extended_frame
        line = line_of_id(lines, number, 2 if first is source else 1)
        where = "" if first is source else f" of {first.name}"
        text = (
            f"{source.name}: line {line}: {message.name} has the identifier 0x{message.frame_id:X} "
            f"of {other.name}{where}"
        )
        if not relaxed:
            advice = "" if first is source else "give each file its bus (--dbc CHANNEL=FILE), or "
            raise DatabaseError(f"{text}; {advice}--relaxed takes the first")
        self.notes.append(f"{text}; the first is taken")


def load_databases(files: Iterable[str | Path] = (), *, relaxed: bool = False) -> Databases:
    """Loads DBC files.

    Args:
        files: Paths, or `vehicle` and `harness` for the project's own; without any, `vehicle`.
            `CHANNEL=FILE` is for the frames of one channel alone.
        relaxed: Leave out what cannot be read, and tell it in `notes`.

    Raises:
        DatabaseError: A file cannot be read; file, line and reason are named.
    """
    result = Databases()
    with _without_log():
        for given in [str(file) for file in files] or [VEHICLE_DBC]:
            source = _read(given, result.notes, relaxed=relaxed)
            database = _parse(source, result.notes, relaxed=relaxed)
            result.databases.append(database)
            for message in database.messages:
                result._add(source, message, relaxed=relaxed)
    return result


def nearest(name: str, names: Iterable[str]) -> str:
    """`: did you mean ...?` with the names closest to a mistyped one, or which names there are."""
    known = sorted(names)
    lower = {other.lower(): other for other in reversed(known)}
    close = difflib.get_close_matches(name.lower(), list(lower), n=3, cutoff=0.6)
    if close:
        return ": did you mean " + " or ".join(lower[text] for text in close) + "?"
    shown = ", ".join(known[:12]) + (f" and {len(known) - 12} more" if len(known) > 12 else "")
    return f": there are {shown}" if known else ""


@contextmanager
def _without_log() -> Iterator[None]:
    """While it lasts, cantools writes no warnings of its own: they are told as notes or errors."""
    logger = logging.getLogger("cantools")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def _read(given: str, notes: list[str], *, relaxed: bool) -> _Source:
    channel, path = EVERY_CHANNEL, given
    found = _CHANNEL_AND_FILE.fullmatch(given)
    if found and not Path(given).exists():
        channel, path = found[1], found[2]
    if path in OWN and not Path(path).exists():
        return _source(path, channel, dbc_text(OWN[path]))
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise DatabaseError(f"{path}: cannot be read: {error.strerror or error}") from error
    return _source(path, channel, _decoded(path, content, notes, relaxed=relaxed))


def _source(name: str, channel: str, text: str) -> _Source:
    is_own = text == dbc_text(VEHICLE_DBC)
    return _Source(name=name, channel=channel, text=text, is_own=is_own)


def _plain(name: str) -> str:
    return name.replace("_", "").lower()


def _decoded(name: str, content: bytes, notes: list[str], *, relaxed: bool) -> str:
    """UTF-8, or cp1252 as the tools for DBCs write it."""
    is_utf16 = content[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        if not is_utf16:
            try:
                return content.decode("utf-8-sig")
            except UnicodeDecodeError:
                return content.decode("cp1252")
        text, what = content.decode("utf-16", errors="replace"), "the text is UTF-16"
        line = 1
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        text = content.decode("cp1252", errors="replace")
        what = f"byte 0x{content[error.start]:02X} is neither UTF-8 nor cp1252"
    if not relaxed:
        raise DatabaseError(f"{name}: line {line}: {what}; --relaxed reads it")
    notes.append(f"{name}: line {line}: {what}")
    return text


def _parse(source: _Source, notes: list[str], *, relaxed: bool) -> Database:
    """The parsed file; in relaxed mode without the statements that stand in the way."""
    lines = source.text.splitlines()
    if not any(keyword(line) == "BO_" for line in lines):
        raise DatabaseError(f"{source.name}: line 1: no DBC: there is no message (BO_) in it")
    for _ in range(LEFT_OUT_MAX):
        try:
            database = load_string(
                "\n".join(lines) + "\n", database_format="dbc", strict=not relaxed
            )
        except Exception as error:  # a parser that is fed anything raises anything
            number, reason = _complaint(lines, error)
            where = f"{source.name}: line {number}: " if number else f"{source.name}: "
            if not relaxed:
                raise DatabaseError(f"{where}{reason}; --relaxed loads the rest") from error
            if not 1 <= number <= len(lines) or not any(line.strip() for line in lines):
                raise DatabaseError(f"{where}{reason}, in spite of --relaxed") from error
            taken = statement_at(lines, number)
            notes.append(
                f"{source.name}: line {taken[0]} left out: {reason}: "
                f"{_shortened(lines[taken[0] - 1])}"
            )
            for n in taken:
                lines[n - 1] = ""
            continue
        assert isinstance(database, Database)
        _check(source, database, lines, notes, relaxed=relaxed)
        return database
    raise DatabaseError(f"{source.name}: more than {LEFT_OUT_MAX} statements cannot be read")


def _complaint(lines: list[str], error: Exception) -> tuple[int, str]:
    """Line and reason of what the parser did not like."""
    inner = getattr(error, "e_dbc", None) or error
    text = str(inner)
    number = line_of_error(lines, text)
    if found := re.match(r"Invalid syntax at line \d+, column (\d+)", text):
        is_all = not any(lines[number - 1 :])
        return number, "the text ends too early" if is_all else f"bad syntax at column {found[1]}"
    if isinstance(inner, KeyError):
        return number, f"{text} is not defined"
    return number, " ".join(text.rstrip(".").split())


def _check(
    source: _Source, database: Database, lines: list[str], notes: list[str], *, relaxed: bool
) -> None:
    """What cantools leaves unsaid: no messages, a cut end, what only strict loading refuses."""
    if not database.messages:
        raise DatabaseError(f"{source.name}: line 1: no message in it can be read")
    nodes = {node.name for node in database.nodes}
    for message in database.messages:
        try:
            message.refresh(strict=True)
        except Error as error:  # relaxed, or it would not have come so far
            number = line_of_error(lines, str(error)) or line_of_message(lines, message.name)
            notes.append(f"{source.name}: line {number}: {str(error).rstrip('.')}")
            message.refresh(strict=False)
    last = database.messages[-1]
    strangers = [
        receiver for signal in last.signals for receiver in signal.receivers
        if nodes and receiver not in nodes
    ]  # fmt: skip
    if lines[-1].lstrip().startswith(("SG_", "BO_")) and not source.text.endswith("\n"):
        text = f"{source.name}: line {len(lines)}: the text ends in message {last.name}"
        if strangers and not relaxed:
            raise DatabaseError(
                f"{text}, and {strangers[-1]!r} is no node: was it cut off? --relaxed takes it"
            )
        notes.append(f"{text}: was it cut off?")


def _shortened(line: str) -> str:
    text = " ".join(line.split())
    return text if len(text) <= 60 else text[:57] + "..."
