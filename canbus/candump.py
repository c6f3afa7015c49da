"""What `candump` of can-utils writes: its columns, and its log format in both directions.

Columns as `fprint_long_canframe` of can-utils' lib.c, the log as its `fprint_canframe`; a test
compares both with the program `log2long`.
"""

from __future__ import annotations

import re
from typing import Final

from canbus.heard import (
    CLASSICAL,
    ERROR_FLAG,
    EXTENDED_FLAG,
    EXTENDED_ID_MAX,
    REMOTE_FLAG,
    Heard,
)

US_PER_S: Final = 1_000_000
NS_PER_US: Final = 1_000

_LINE: Final = re.compile(
    r"\s*\((\d+)\.(\d{1,9})\)\s+([!-~]+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})(##?)(\S*)(?:\s+[RT]\S*)?\s*"
)
_REMOTE: Final = re.compile(r"[Rr]([0-8]?)(?:_[9A-Fa-f])?")
_DATA: Final = re.compile(r"((?:[0-9A-Fa-f]{2}\.?)*)(?:_[9A-Fa-f])?")
DATA_BYTES_MAX: Final = 8
FD_BYTES_MAX: Final = 64


def id_text(word: int) -> str:
    """The identifier as candump writes it: three digits, or eight for 29 bits and error frames."""
    if word & ERROR_FLAG:
        return f"{word & (EXTENDED_ID_MAX | ERROR_FLAG):08X}"
    return f"{word & EXTENDED_ID_MAX:08X}" if word & EXTENDED_FLAG else f"{word & 0x7FF:03X}"


def columns(heard: Heard) -> str:
    """Identifier, length and data: `123   [8]  11 22 33 44 55 66 77 88`."""
    number = id_text(heard.word)
    length = f" [{heard.length:02d}]" if heard.is_fd else f"  [{heard.length}]"
    head = f"{number} {length} "
    if heard.is_remote:
        return f"{head} remote request"
    return f"{head} {heard.data.hex(' ').upper()}"


def log_line(heard: Heard) -> str:
    """The line of `candump -L`: `(1436509052.249713) vcan0 123#1122`."""
    us = heard.time_ns // NS_PER_US
    stamp = f"({us // US_PER_S:010d}.{us % US_PER_S:06d}) {heard.channel} {id_text(heard.word)}"
    if heard.is_fd:
        return f"{stamp}##{heard.fd_flags & 0xF:X}{heard.data.hex().upper()}"
    if heard.is_remote:
        return f"{stamp}#R{heard.length or ''}"
    return f"{stamp}#{heard.data.hex().upper()}"


def parse_log_line(line: str) -> Heard | None:
    """The frame of a line of `candump -L`; None for any other text."""
    found = _LINE.fullmatch(line)
    if found is None:
        return None
    seconds, fraction, channel, number, mark, rest = found.groups()
    time_ns = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0"))
    word = int(number, 16)
    if len(number) == 8 and not word & ERROR_FLAG:
        word |= EXTENDED_FLAG
    fd_flags = CLASSICAL
    if mark == "##":
        if not rest or rest[0] not in "0123456789ABCDEFabcdef":
            return None
        fd_flags, rest = int(rest[0], 16), rest[1:]
    elif remote := _REMOTE.fullmatch(rest):
        return Heard(time_ns, channel, word | REMOTE_FLAG, b"", int(remote[1] or 0))
    content = _DATA.fullmatch(rest)
    if content is None:
        return None
    data = bytes.fromhex(content[1].replace(".", ""))
    if len(data) > (DATA_BYTES_MAX if fd_flags == CLASSICAL else FD_BYTES_MAX):
        return None
    return Heard(time_ns, channel, word, data, len(data), fd_flags)
