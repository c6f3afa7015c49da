"""Writes a module for each DBC file (`OUTPUTS`): `python -m dbc.generate`.

Plain shifts and masks, a tenth of the cost of a general encoder. A test regenerates the text and
compares, another checks every signal bit for bit against cantools: the code cannot drift.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cantools.database.can import Database, Message, Signal

from dbc.database import BYTE_COMMANDS_DBC, HARNESS_DBC, VEHICLE_DBC, load
from dbc.spec import snake_case

NOT_AVAILABLE = "not_available"
PROTECTION_SIGNALS = ("crc", "alive_counter")
NS_PER_MS = 1_000_000
OUTPUTS = {
    VEHICLE_DBC: "messages.py",
    HARNESS_DBC: "harness.py",
    BYTE_COMMANDS_DBC: "byte_commands.py",
}
NO_NODE = "Vector__XXX"

DATACLASS = "@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)"
"""Plain data of the loop; see `canbus.frame` for why the constructor is written out."""


def payload_signals(message: Message) -> list[Signal]:
    """The signals a node works with: all but CRC and alive counter."""
    return [s for s in message.signals if s.name not in PROTECTION_SIGNALS]


def not_available_raw(signal: Signal) -> int | None:
    """The raw value that means "not available" (NaN in Python), if the signal has one."""
    for raw, name in (signal.choices or {}).items():
        if str(name) == NOT_AVAILABLE:
            return int(raw)
    return None


def attribute(message: Message, name: str, default: int | str) -> int | str:
    """A DBC attribute of the message, or the default where the file sets none."""
    assert message.dbc is not None
    found = message.dbc.attributes.get(name)
    if found is None:
        return default
    assert isinstance(found.value, int | str)
    return found.value


def class_name(message: Message) -> str:
    """The dataclass that carries the message; messages of one layout share one."""
    return str(attribute(message, "MessageClass", ""))


Tables = dict[tuple[tuple[int, str], ...], str]


def _table_names(database: Database) -> Tables:
    assert database.dbc is not None
    tables = database.dbc.value_tables
    return {_choices(table): name for name, table in tables.items()}


def _choices(table: object) -> tuple[tuple[int, str], ...]:
    assert isinstance(table, dict)
    return tuple(sorted((int(raw), str(name)) for raw, name in table.items()))


class _Field:
    """One signal on its way into Python: its type, and the lines that pack and unpack it."""

    def __init__(self, owner: str, signal: Signal, tables: Tables) -> None:
        self.signal = signal
        self.name = signal.name
        self.label = f"{owner}.{signal.name}"
        self.na = not_available_raw(signal)
        self.mask = (1 << signal.length) - 1
        assert signal.minimum is not None and signal.maximum is not None
        self.low, self.high = signal.minimum, signal.maximum
        self.enum = tables.get(_choices(signal.choices)) if signal.choices else None
        scaled = signal.scale != 1 or self.na is not None or isinstance(self.low, float)
        if self.enum:
            self.type = self.enum
        elif signal.length == 1:
            self.type = "bool"
        else:
            self.type = "float" if scaled else "int"
        half = 1 << (signal.length - 1)
        raw_low, raw_high = (-half, half - 1) if signal.is_signed else (0, self.mask)
        raw_low, raw_high = raw_low + (self.na == raw_low), raw_high - (self.na == raw_high)
        self.every_raw_is_valid = (
            self.low <= raw_low * signal.scale and raw_high * signal.scale <= self.high
        )

    def _refusal(self, variable: str) -> str:
        unit, limits = self.signal.unit or "", f"{self.low}, {self.high}"
        return f'raise SignalRangeError("{self.label}", {variable}, {limits}, "{unit}")'

    def pack_lines(self) -> Iterator[str]:
        shift = f" << {self.signal.start}" if self.signal.start else ""
        if self.type == "bool":
            yield f"if message.{self.name}:\n    bits |= 0x{1 << self.signal.start:X}"
            return
        if self.enum:
            yield f"bits |= message.{self.name}{shift}"
            return
        x = "x" if self.type == "float" else "n"  # one variable, one type
        yield f"{x} = message.{self.name}"
        raw = f"round({x} / {self.signal.scale})" if self.signal.scale != 1 else f"round({x})"
        first = "if"
        if self.na is not None:
            yield f"if {x} != {x}:\n    bits |= 0x{self.na & self.mask:X}{shift}"
            first = "elif"
        yield f"{first} {self.low} <= {x} <= {self.high}:"
        field = f"{raw} & 0x{self.mask:X}"
        yield f"    bits |= ({field}){shift}" if shift else f"    bits |= {field}"
        yield f"else:\n    {self._refusal(x)}"

    def unpack_lines(self) -> Iterator[str]:
        shift = f" >> {self.signal.start}" if self.signal.start else ""
        name = self.name
        if self.type == "bool":
            yield f"{name} = bits & 0x{1 << self.signal.start:X} != 0"
        elif self.enum:
            yield f"{name} = _{snake_case(self.enum).upper()}[bits{shift} & 0x{self.mask:X}]"
        else:
            yield f"r = bits{shift} & 0x{self.mask:X}"
            yield from self._scale_lines()

    def _scale_lines(self) -> Iterator[str]:
        name, indent = self.name, ""
        scale = f" * {self.signal.scale}" if self.signal.scale != 1 else ""
        to_float = " * 1.0" if self.type == "float" and not scale else ""
        if self.na is not None and self.every_raw_is_valid and not self.signal.is_signed:
            yield f"{name} = NAN if r == 0x{self.na:X} else r{scale}{to_float}"
            return
        if self.na is not None:
            yield f"if r == 0x{self.na & self.mask:X}:\n    {name} = NAN\nelse:"
            indent = "    "
        if self.signal.is_signed:
            half = 1 << (self.signal.length - 1)
            yield f"{indent}if r & 0x{half:X}:\n{indent}    r -= 0x{self.mask + 1:X}"
        yield f"{indent}{name} = r{scale}{to_float}"
        if not self.every_raw_is_valid:
            yield f"{indent}if not {self.low} <= {name} <= {self.high}:"
            yield f"{indent}    {self._refusal(name)}"


def _indent(lines: Iterator[str] | list[str], spaces: int = 4) -> list[str]:
    pad = " " * spaces
    return [pad + part for line in lines for part in line.split("\n")]


def _dataclass_lines(name: str, message: Message, fields: list[_Field]) -> list[str]:
    comment = (message.comment or message.name).replace("\n", " ")
    out = ["", "", DATACLASS, f"class {name}:"]
    out += [f'    """{comment}"""', ""]
    for field in fields:
        out.append(f"    {field.name}: Final[{field.type}]")
        notes = [field.signal.comment or ""]
        if field.na is not None:
            notes.append("NaN: not available")
        if text := ". ".join(note for note in notes if note):
            out.append(f'    """{text}."""')
    if not fields:
        out.pop()
        return out
    out += ["", "    def __init__(", "        self,", "        *,"]
    out += [f"        {field.name}: {field.type}," for field in fields]
    out.append("    ) -> None:")
    out += [f"        self.{field.name} = {field.name}" for field in fields]
    return out


def _codec_lines(name: str, fields: list[_Field]) -> list[str]:
    low = snake_case(name)
    out = ["", "", f"def _pack_{low}(message: {name}) -> int:"]
    out.append("    bits = 0")
    for field in fields:
        out += _indent(field.pack_lines())
    out += ["    return bits", "", "", f"def _unpack_{low}(bits: int) -> {name}:"]
    for field in fields:
        out += _indent(field.unpack_lines())
    if not fields:
        return [*out, f"    return {name}()"]
    out += [f"    return {name}("]
    out += [f"        {field.name}={field.name}," for field in fields]
    return [*out, "    )"]


def _spec_lines(message: Message) -> list[str]:
    def ns(name: str) -> str:
        return f"{int(attribute(message, name, 0)) * NS_PER_MS:_}"

    is_protected = bool(attribute(message, "E2EProfile", ""))
    data_id = hex(int(attribute(message, "E2EDataId", 0))) if is_protected else None
    senders = [s for s in message.senders if s != NO_NODE]
    receivers = ", ".join(repr(r) for r in sorted(message.receivers) if r != NO_NODE)
    low = snake_case(class_name(message))
    units = ", ".join(f"{s.name!r}: {s.unit or ''!r}" for s in payload_signals(message))
    return [
        f"    0x{message.frame_id:03X}: MessageSpec(",
        f"        can_id=0x{message.frame_id:03X},",
        f'        name="{message.name}",',
        f"        length={message.length},",
        f"        sender={repr(senders[0]) if senders else None},",
        f"        receivers=frozenset({{{receivers}}})," if receivers
        else "        receivers=frozenset(),",
        f"        cycle_ns={ns('GenMsgCycleTime')},",
        f"        timeout_ns={ns('TimeoutTime')},",
        f"        min_interval_ns={ns('GenMsgDelayTime')},",
        f"        data_id={data_id},",
        f"        units={{{units}}},",
        f"        pack=_pack_{low},",
        f"        unpack=_unpack_{low},",
        "    ),",
    ]


def generate(dbc_name: str) -> str:
    """The Python text for one DBC."""
    database = load(dbc_name)
    tables = _table_names(database)
    out: list[str] = []
    assert database.dbc is not None
    for name, table in database.dbc.value_tables.items():
        out += ["", "", f"class {name}(IntEnum):", f'    """Value table `{name}`."""', ""]
        out += [f"    {label} = {raw}" for raw, label in table.items()]
        members = f"{{member.value: member for member in {name}}}"
        out += ["", "", f"_{snake_case(name).upper()}: Final = {members}"]
    done: set[str] = set()
    for message in database.messages:
        name = class_name(message)
        if name not in done:
            done.add(name)
            fields = [_Field(name, s, tables) for s in payload_signals(message)]
            out += _dataclass_lines(name, message, fields) + _codec_lines(name, fields)
    out += ["", "", "SPECS: Final[dict[int, MessageSpec]] = {"]
    for message in database.messages:
        out += _spec_lines(message)
    body = "\n".join([*out, "}", ""])
    return "\n".join([*_head_lines(dbc_name, body), body])


def _head_lines(dbc_name: str, body: str) -> list[str]:
    """What comes before the body; imports what it uses."""
    spec = ", ".join(n for n in ("NAN", "MessageSpec", "SignalRangeError") if n in body)
    return [
        f'"""Messages of `{dbc_name}`. Generated by `python -m dbc.generate`: do not edit."""',
        "# ruff: noqa: E501",
        "", "from __future__ import annotations", "",
        "from dataclasses import dataclass",
        *(["from enum import IntEnum"] if "(IntEnum)" in body else []),
        "from typing import Final", "",
        f"from dbc.spec import {spec}",
    ]


def main() -> None:
    """Writes the files beside this one."""
    for dbc_name, module in OUTPUTS.items():
        Path(__file__).with_name(module).write_text(generate(dbc_name), encoding="utf-8")


if __name__ == "__main__":
    main()
