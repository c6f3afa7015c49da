"""How commands read a log: the file or standard input, and the signals that are asked for."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING

from dbw.failures import UserMistake
from dbw.options import STANDARD_INPUT

if TYPE_CHECKING:
    from telemetry.databases import Databases
    from telemetry.logs.reading import Log


def open_log(name: str) -> Log:
    """A log by its name, `-` for standard input.

    Raises:
        LogError: It cannot be read.
    """
    from telemetry.logs.reading import Log, LogStream

    return LogStream(sys.stdin.fileno()) if name == STANDARD_INPUT else Log(name)


def signals_of(databases: Databases, given: Iterable[str]) -> list[tuple[str, str]]:
    """`MESSAGE.SIGNAL` as the names of both, as the DBC has them.

    Raises:
        DatabaseError, UserMistake: There is no such signal.
    """
    found = []
    for text in given:
        owner, _, name = text.rpartition(".")
        if not owner:
            raise UserMistake(f"--signal {text}: MESSAGE.SIGNAL is wanted")
        message = databases.named(owner)
        found.append((message.name, databases.signal(message, name).name))
    return found
