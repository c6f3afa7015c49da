"""What the project knows of its own bus beyond the DBC: codes in words, and parameters by SDO."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeVar

from canbus.node import NODE_IDS
from dbc.messages import Inhibit, MonitorReason, Reason
from gateway.sentences import INHIBIT_TEXT, MONITOR_TEXT, REASON_TEXT
from telemetry.monitor.object_names import eds_of

EnumT = TypeVar("EnumT", bound=IntEnum)

PARAMETERS = "2100"
"""Index of the record in each node's object dictionary (hexadecimal, as the EDS writes it)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterRow:
    """One parameter of a node, as its EDS has it; range in SI."""

    place: str
    name: str
    span: str
    unit: str
    access: str
    comment: str


def words() -> dict[str, dict[int, str]]:
    """By value table and number, what a code means to a driver."""
    return {
        Reason.__name__: _by_number(REASON_TEXT),
        Inhibit.__name__: _by_number(INHIBIT_TEXT),
        MonitorReason.__name__: _by_number(MONITOR_TEXT),
    }


def _by_number(texts: Mapping[EnumT, str]) -> dict[int, str]:
    return {int(member): text for member, text in texts.items()}


def parameters() -> dict[str, list[ParameterRow]]:
    """By node, what can be read, and in MANUAL written, by SDO."""
    return {node: list(_parameters(node)) for node in NODE_IDS}


def _parameters(node: str) -> Iterator[ParameterRow]:
    eds = eds_of(node)
    for section in eds.sections():
        found = re.fullmatch(rf"{PARAMETERS}sub([1-9A-F]+)", section)
        if found:
            entry = eds[section]
            factor = float(entry["Factor"])
            low, high = (factor * int(entry[key], 0) for key in ("LowLimit", "HighLimit"))
            yield ParameterRow(
                place=f"0x{PARAMETERS}:{int(found[1], 16)}",
                name=entry["ParameterName"],
                span=f"{low:g} to {high:g}",
                unit=entry["Unit"],
                access="read, write in MANUAL" if entry["AccessType"] == "rw" else "read",
                comment=entry["Description"],
            )
