"""Names of the nodes' objects and what their values mean, from the EDS files."""

from __future__ import annotations

import struct
from configparser import ConfigParser, SectionProxy
from functools import cache
from importlib.resources import files
from typing import Final

from canbus.canopen_parameters import INTEGER32, UNSIGNED32
from dbc.spec import snake_case

_SIGNED: Final = frozenset({0x02, 0x03, INTEGER32, 0x15})
_UNSIGNED: Final = frozenset({0x01, 0x05, 0x06, UNSIGNED32, 0x1B})
_TEXT: Final = 0x09
_REAL32: Final = 0x08
"""Data types of CiA 301, table 44."""


@cache
def eds_of(node: str) -> ConfigParser:
    """The EDS of a node by its DBC name; an empty one for a node that has none."""
    parser = ConfigParser(interpolation=None, strict=False)
    name = snake_case(node)
    file = files("dbc").joinpath("eds", f"{name}.eds")
    if name.isidentifier() and file.is_file():
        parser.read_string(file.read_text(encoding="utf-8"))
    return parser


def _entry(node: str, index: int, subindex: int) -> SectionProxy | None:
    """What the EDS says of an object, or of its member."""
    eds = eds_of(node)
    for section in (f"{index:04X}sub{subindex:X}", f"{index:04X}"):
        if eds.has_section(section):
            return eds[section]
    return None


def object_name(node: str, index: int, subindex: int) -> str:
    """`0x2100:01 position_gain_per_s`; index and sub-index alone for an object without a name."""
    number = f"0x{index:04X}:{subindex:02X}"
    entry = _entry(node, index, subindex)
    return number if entry is None else f"{number} {entry.get('ParameterName', '')}".rstrip()


def object_value(node: str, index: int, subindex: int, raw: bytes) -> str:
    """A value as its object's type has it, scaled and with its unit; bytes if that is unknown."""
    entry = _entry(node, index, subindex)
    kind = 0 if entry is None else int(entry.get("DataType", "0"), 0)
    if entry is None or not (kind in _SIGNED or kind in _UNSIGNED):
        return _unscaled(kind, raw)
    number = int.from_bytes(raw, "little", signed=kind in _SIGNED)
    if "Factor" not in entry:
        return f"{number} (0x{number:X})" if kind in _UNSIGNED and number > 9 else str(number)
    return f"{number * float(entry['Factor']):.10g} {entry.get('Unit', '')}".rstrip()


def _unscaled(kind: int, raw: bytes) -> str:
    if kind == _TEXT and raw.isascii():
        return repr(raw.decode("ascii"))
    if kind == _REAL32 and len(raw) == 4:
        return f"{struct.unpack('<f', raw)[0]:.7g}"
    return raw.hex(" ").upper()
