"""Changing a number in a vehicle file: every comment, and all the rest of the text, stays."""

from __future__ import annotations

import shutil
from pathlib import Path

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Item, Table

from vehicles.vehicle import VehicleError


def with_number(text: str, section: str, name: str, value: float, source: str) -> str:
    """The text of a vehicle file with another value for one field, or with the field added.

    Raises:
        VehicleError: It is no TOML, or has no such section.
    """
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as error:
        raise VehicleError(f"not valid TOML: {error}") from error
    table = document.get(section)
    if not isinstance(table, Table):
        raise VehicleError(f"[{section}] is missing")
    quoted = tomlkit.string(source).as_string()
    entry = tomlkit.value(f"{{ value = {value!r}, source = {quoted} }}")
    entry.trivia.trail = "\r\n" if "\r\n" in text else "\n"
    if name in table:  # what follows on its line, a comment say, stays
        before = table.item(name)
        assert isinstance(before, Item)
        entry.trivia.comment_ws = before.trivia.comment_ws
        entry.trivia.comment = before.trivia.comment
    table[name] = entry
    return tomlkit.dumps(document)


def replace_text(path: Path, text: str) -> None:
    """Writes a file, line ends as they are: afterwards it is there as a whole, or as it was.

    Raises:
        OSError: It may not be written, or the folder may not.
    """
    place = path.resolve()
    with place.open("r+b"):
        pass  # a file that is read-only stays as it is, whatever its folder allows
    beside = place.with_name(f".{place.name}.new")
    try:
        beside.write_bytes(text.encode())
        shutil.copymode(place, beside)
        beside.replace(place)
    finally:
        beside.unlink(missing_ok=True)
