"""The driving mode: a total table, and which axes each mode authorises.

Rules (design, driving modes):
  INIT -> MANUAL -(button)-> READY -(request, everything well)-> AUTOMATIC.
  A driver's touch in AUTOMATIC gives MANUAL at once.
  Button or disengage in AUTOMATIC: a controlled stop (STOPPING), then READY.
  EMERGENCY is entered only from AUTOMATIC and STOPPING; by the emergency stop also from READY.
  In MANUAL, and in INIT where a human may drive as well, nothing brakes.
  EMERGENCY is latched: it outranks the driver's input and is left only to MANUAL, by a reset.
  A supervisor that restarts into a car whose ECUs brake on their own adopts that emergency.
"""

from __future__ import annotations

from enum import IntEnum, auto
from typing import Final

from dbc.messages import Mode


class ModeEvent(IntEnum):
    """One event a step, highest priority first."""

    ADOPT = auto()
    """Only after a restart: an ECU is found in its safe state."""
    EMERGENCY_STOP = auto()
    """FAILSAFE frame or the hardware emergency stop."""
    FAULT = auto()
    """Any other cause that calls for the emergency brake."""
    DRIVER = auto()
    """The driver uses pedal, wheel or brake."""
    RESET = auto()
    """An explicit reset, and all that it needs."""
    BUTTON = auto()
    DISENGAGE = auto()
    STANDSTILL = auto()
    """The controlled stop has ended."""
    ENGAGE = auto()
    """The gateway's request, and all that it needs."""
    TIMEOUT = auto()
    """READY for too long."""
    NODES_SEEN = auto()
    """Every ECU has been heard since the start, none of them driving or in a safe state."""
    NOTHING = auto()


_M, _E = Mode, ModeEvent


def _row(default: Mode, **cells: Mode) -> dict[ModeEvent, Mode]:
    return {event: cells.get(event.name, default) for event in ModeEvent}


MODE_AFTER: Final[dict[Mode, dict[ModeEvent, Mode]]] = {
    _M.INIT: _row(_M.INIT, ADOPT=_M.EMERGENCY, NODES_SEEN=_M.MANUAL),
    _M.MANUAL: _row(_M.MANUAL, BUTTON=_M.READY),
    _M.READY: _row(
        _M.READY,
        EMERGENCY_STOP=_M.EMERGENCY,
        DRIVER=_M.MANUAL,
        BUTTON=_M.MANUAL,
        TIMEOUT=_M.MANUAL,
        ENGAGE=_M.AUTOMATIC,
    ),
    _M.AUTOMATIC: _row(
        _M.AUTOMATIC,
        EMERGENCY_STOP=_M.EMERGENCY,
        FAULT=_M.EMERGENCY,
        DRIVER=_M.MANUAL,
        BUTTON=_M.STOPPING,
        DISENGAGE=_M.STOPPING,
    ),
    _M.STOPPING: _row(
        _M.STOPPING,
        EMERGENCY_STOP=_M.EMERGENCY,
        FAULT=_M.EMERGENCY,
        DRIVER=_M.MANUAL,
        STANDSTILL=_M.READY,
    ),
    _M.EMERGENCY: _row(_M.EMERGENCY, RESET=_M.MANUAL),
}
assert set(MODE_AFTER) == set(Mode)

DRIVING_MODES: Final = frozenset({_M.AUTOMATIC, _M.STOPPING})

AUTHORISED: Final[dict[Mode, frozenset[str]]] = {
    _M.INIT: frozenset(),
    _M.MANUAL: frozenset(),
    _M.READY: frozenset(),
    _M.AUTOMATIC: frozenset({"steering", "throttle", "brake"}),
    _M.STOPPING: frozenset({"steering", "throttle", "brake"}),
    _M.EMERGENCY: frozenset({"steering", "brake"}),
}
"""Axes that may move. In EMERGENCY traction is cut; steering may hold until a hand takes it."""

RELAY_CLOSED: Final[dict[Mode, bool | None]] = {
    _M.INIT: None,
    _M.MANUAL: False,
    _M.READY: False,
    _M.AUTOMATIC: True,
    _M.STOPPING: True,
    _M.EMERGENCY: True,
}
"""The manual/automatic multiplexer; INIT leaves the latching relay as a dead supervisor left it."""
