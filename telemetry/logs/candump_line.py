"""One line of candump, in any of the forms in which it writes: the exact and slow way.

`candump -L`: `(1436509052.249713) vcan0 181#0011223344556677`, with `##` and a digit of flags for
FD, `#R` for remote frames, and ` R` or ` T` behind it for the direction. On the screen:
`(1436509052.249713)  vcan0  181   [8]  00 11 22 33 44 55 66 77`, with or without a time.
"""

from __future__ import annotations

import re
from typing import Final

from canbus.heard import ERROR_FLAG, EXTENDED_ID_MAX, FD_BIT_RATE_SWITCH, FD_ERROR_STATE
from telemetry.logs.frames import CLASSIC_BYTES, FD_BYTES, FrameFlag, LogFrame

FD_LENGTHS: Final = frozenset({*range(9), 12, 16, 20, 24, 32, 48, 64})

_TIME: Final = r"\((?P<s>\d{1,11})\.(?P<frac>\d{1,9})\)"
_LOG_LINE: Final = re.compile(
    _TIME + r" +(?P<channel>\S+) +(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"#(?:#(?P<fd>[0-9A-Fa-f])|(?P<remote>[Rr](?P<dlc>[0-8])?(?:_[9A-Fa-f])?))?"
    r"(?P<data>[0-9A-Fa-f]*)(?:_[9A-Fa-f])?(?: +(?P<dir>[RTrt]))?"
)
_SCREEN_LINE: Final = re.compile(
    rf"(?:{_TIME})?\s*(?P<channel>\S+)\s+(?:(?P<dir>RX|TX)\s+(?P<fdflags>[B-])\s+(?P<esi>[E-])\s+)?"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+(?P<bracket>\[(?P<len>\d{1,2})\]|\{\d{1,2}\})"
    r"(?P<rest>.*)"
)


class LineError(ValueError):
    """Why a line holds no frame."""


def parse_line(line: str) -> LogFrame:
    """The frame in a line.

    Raises:
        LineError: There is none.
    """
    text = line.strip()
    found = _LOG_LINE.fullmatch(text)
    if found:
        return _from_log_line(found)
    found = _SCREEN_LINE.fullmatch(text)
    if found:
        return _from_screen_line(found)
    raise LineError(_why(text))


def _why(text: str) -> str:
    if not text.isprintable():
        return "no text"
    if re.fullmatch(rf"{_TIME} +\S+ +[0-9A-Fa-f]+#.*", text):
        return "an identifier of 3 or 8 digits and hexadecimal data are wanted"
    return "no frame of candump"


def _time_ns(seconds: str | None, fraction: str | None) -> int:
    if seconds is None or fraction is None:
        return 0
    return int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0"))


def _identifier(digits: str) -> tuple[int, FrameFlag]:
    number = int(digits, 16)
    if len(digits) == 3:
        if number > 0x7FF:
            raise LineError("the identifier is above 7FF")
        return number, FrameFlag(0)
    if number & ERROR_FLAG:
        return number & EXTENDED_ID_MAX, FrameFlag.ERROR
    if number > EXTENDED_ID_MAX:
        raise LineError("the identifier is above 1FFFFFFF")
    return number, FrameFlag.EXTENDED


def _data(digits: str, *, is_fd: bool) -> bytes:
    if len(digits) % 2:
        raise LineError("half a byte at the end: cut off?")
    data = bytes.fromhex(digits)
    if len(data) > (FD_BYTES if is_fd else CLASSIC_BYTES):
        raise LineError("too many bytes for a frame")
    if is_fd and len(data) not in FD_LENGTHS:
        raise LineError("no length of a CAN FD frame")
    return data


def _from_log_line(found: re.Match[str]) -> LogFrame:
    can_id, flags = _identifier(found["id"])
    if (found["dir"] or "").upper() == "T":
        flags |= FrameFlag.SENT
    if found["remote"]:
        if found["data"]:
            raise LineError("a remote frame with data")
        flags |= FrameFlag.REMOTE
        length, data = int(found["dlc"] or 0), b""
    else:
        if found["fd"]:
            flags |= fd_flags(int(found["fd"], 16))
        data = _data(found["data"], is_fd=FrameFlag.FD in flags)
        length = len(data)
    time_ns = _time_ns(found["s"], found["frac"])
    return LogFrame(time_ns, found["channel"], can_id, flags, length, data)


def fd_flags(digit: int) -> FrameFlag:
    """Flags of an FD frame by the digit behind its `##`."""
    flags = FrameFlag.FD
    if digit & FD_BIT_RATE_SWITCH:
        flags |= FrameFlag.BITRATE_SWITCH
    if digit & FD_ERROR_STATE:
        flags |= FrameFlag.ERROR_STATE
    return flags


def _from_screen_line(found: re.Match[str]) -> LogFrame:
    can_id, flags = _identifier(found["id"])
    if found["dir"] == "TX":
        flags |= FrameFlag.SENT
    if found["len"] is None:
        raise LineError("a CAN XL or raw DLC line")
    length = int(found["len"])
    if len(found["bracket"]) == 4 or length > CLASSIC_BYTES:  # [08]: candump writes FD with two
        flags |= FrameFlag.FD
        if found["fdflags"] == "B":
            flags |= FrameFlag.BITRATE_SWITCH
        if found["esi"] == "E":
            flags |= FrameFlag.ERROR_STATE
    rest = found["rest"].strip()
    time_ns = _time_ns(found["s"], found["frac"])
    if rest.startswith("remote request"):
        flags |= FrameFlag.REMOTE
        return LogFrame(time_ns, found["channel"], can_id, flags, length, b"")
    digits = "".join(rest.split()[:length])
    if len(digits) != 2 * length or not re.fullmatch("[0-9A-Fa-f]*", digits):
        raise LineError("fewer bytes than the line says: cut off?")
    return LogFrame(time_ns, found["channel"], can_id, flags, length, bytes.fromhex(digits))
