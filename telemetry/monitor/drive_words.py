"""What PDOs between a motor drive and its master carry, in words (CiA 402, dbc/eds/drive.eds)."""

from __future__ import annotations

import struct
from typing import Final

from canbus import cia402
from canbus.cia402 import OperationMode
from canbus.cia402_power import PowerEvent, command_of, state_of

_MODES: Final = {mode.value: mode.name.replace("_", " ").lower() for mode in OperationMode}
_TPDO1: Final = struct.Struct("<Hib")
_TPDO2: Final = struct.Struct("<Hih")
_RPDO: Final = struct.Struct("<Hi")


def drive_words(function: int, data: bytes) -> str | None:
    """The words for a PDO's data; None for a PDO that drives do not have.

    Args:
        function: Identifier less the node id.
        data: Malformed if its length is not the one of the mapping.
    """
    layout = _LAYOUTS.get(function)
    if layout is None:
        return None
    if len(data) != layout.size:
        return "malformed"
    word, value, *more = layout.unpack(data)
    if function == cia402.POSITION_ID:
        mode = _MODES.get(more[0], f"mode {more[0]}")
        return f"{_status(word)}; position {value}, {mode}"
    if function == cia402.VELOCITY_ID:
        return f"{_status(word)}; velocity {value} rpm, current {more[0]} mA"
    if function == cia402.TARGET_POSITION_ID:
        new = ", new setpoint" if word & cia402.NEW_SETPOINT else ""
        return f"{_command(word)}{new}; target position {value}"
    return f"{_command(word)}; target velocity {value} rpm"


_LAYOUTS: Final = {
    cia402.POSITION_ID: _TPDO1,
    cia402.VELOCITY_ID: _TPDO2,
    cia402.TARGET_POSITION_ID: _RPDO,
    cia402.TARGET_VELOCITY_ID: _RPDO,
}


def _status(statusword: int) -> str:
    state = state_of(statusword)
    name = f"status 0x{statusword:04X}" if state is None else state.name.replace("_", " ").lower()
    return f"{name}, target reached" if statusword & cia402.TARGET_REACHED else name


def _command(controlword: int) -> str:
    event = command_of(controlword, 0)
    assert event is not None, "a reset that rises"
    halt = ", halt" if controlword & cia402.HALT and event is PowerEvent.ENABLE_OPERATION else ""
    return event.name.replace("_", " ").lower() + halt
