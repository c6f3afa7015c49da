"""The DBC files, read by cantools. The only import of cantools outside the tests."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.resources import files

from canbus.hidden import ASAMMDF, hidden

with hidden(ASAMMDF):
    from cantools.database import load_string
    from cantools.database.can import Database

VEHICLE_DBC = "vehicle.dbc"
HARNESS_DBC = "harness.dbc"
BYTE_COMMANDS_DBC = "byte_commands.dbc"


def dbc_text(name: str) -> str:
    """The text of one of them as shipped."""
    return files("dbc").joinpath(name).read_text(encoding="utf-8")


@cache
def load(name: str) -> Database:
    """The parsed database, strictly checked (overlapping or overlong signals are refused)."""
    database = load_string(dbc_text(name), database_format="dbc", strict=True)
    assert isinstance(database, Database)
    return database


def configuration_hash(text: str) -> int:
    """32 bits of SHA-256 over a configuration text, as the nodes compare it at boot."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


@cache
def dbc_hash() -> int:
    """Hash of the vehicle bus's description; nodes with different ones never drive together."""
    return configuration_hash(dbc_text(VEHICLE_DBC))
