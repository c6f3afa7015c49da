"""Where a DBC's statements stand in its text: to name a line, and to leave one out."""

from __future__ import annotations

import re
from typing import Final

_KEYWORD: Final = re.compile(
    r"\s*(VERSION|NS_|BS_|BU_|VAL_TABLE_|BO_|SG_|BO_TX_BU_|EV_|ENVVAR_DATA_|SGTYPE_|SIG_GROUP_|CM_"
    r"|BA_DEF_|BA_DEF_REL_|BA_DEF_DEF_|BA_DEF_DEF_REL_|BA_|BA_REL_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_)"
    r"(?=[\s:])"
)
_WITHOUT_SEMICOLON: Final = frozenset({"VERSION", "NS_", "BS_", "BU_", "BO_", "SG_"})


def keyword(line: str) -> str:
    """The keyword that a line begins with; empty for a line that begins no statement."""
    found = _KEYWORD.match(line)
    return found[1] if found else ""


def line_of_message(lines: list[str], name: str) -> int:
    """Number of the line, counted from 1, that begins a message; 0 if there is none."""
    wanted = re.compile(rf"\s*BO_\s+\d+\s+{re.escape(name)}\s*:")
    return next((n for n, line in enumerate(lines, 1) if wanted.match(line)), 0)


def line_of_id(lines: list[str], frame_id: int, occurrence: int = 1) -> int:
    """Number of the line that begins a message with this number, as the DBC writes it."""
    wanted = re.compile(rf"\s*BO_\s+{frame_id}\s")
    found = [n for n, line in enumerate(lines, 1) if wanted.match(line)]
    return found[occurrence - 1] if len(found) >= occurrence else 0


def line_of_error(lines: list[str], text: str) -> int:
    """Number of the line that a parser's complaint is about, by the names in it; 0 if unknown."""
    if found := re.search(r"at line (\d+)", text):
        return int(found[1])
    if found := re.search(r"\b([A-Z]+(?:_[A-Z]+)*_) (\d+) (\w+)", text):
        wanted = re.compile(rf"\s*{found[1]}\s+{found[2]}\s+{found[3]}\b")
        return next((n for n, line in enumerate(lines, 1) if wanted.match(line)), 0)
    if found := re.search(r"in message (\w+)", text):
        start = line_of_message(lines, found[1])
        if signal := re.search(r"signals? (\w+)", text):
            wanted = re.compile(rf"\s*SG_\s+{signal[1]}\b")
            rest = enumerate(lines[start:], start + 1)
            return next((n for n, line in rest if wanted.match(line)), start)
        return start
    if found := re.fullmatch(r"['\"]([^'\"]+)['\"]", text.strip()):  # a KeyError: a name not known
        quoted = f'"{found[1]}"'
        return next(
            (n for n, line in enumerate(lines, 1)
             if quoted in line and keyword(line) in ("BA_", "BA_REL_")), 0,
        )  # fmt: skip
    return 0


def statement_at(lines: list[str], number: int) -> range:
    """Numbers of the lines to leave out so that the complaint about one of them is over.

    A statement that lacks its semicolon is complained about at the next one, so the one before is
    taken; a message is taken with its signals; anything else is the line with what continues it.
    """
    if keyword(lines[number - 1]):
        before = number - 1
        while before and not keyword(lines[before - 1]):
            before -= 1
        if before and keyword(lines[before - 1]) not in _WITHOUT_SEMICOLON:
            told = " ".join(lines[before - 1 : number - 1]).rstrip()
            if told and not told.endswith(";"):
                return range(before, number)
    kind = keyword(lines[number - 1])
    end = number + 1
    while end <= len(lines):
        following = keyword(lines[end - 1])
        goes_on = following == "SG_" if kind == "BO_" else False
        if following and not goes_on:
            break
        if kind in ("", "SG_") or (kind == "BO_" and not following and lines[end - 1].strip()):
            break
        end += 1
    return range(number, end)
