"""The power state machine of a drive: a total table (CiA 402-2, finite state automaton).

Rules:
  Only ENABLE_OPERATION out of SWITCHED_ON (or out of a quick stop that waits) moves the motor.
  FAULT beats everything: whatever the state, the fault reaction comes first, then FAULT.
  FAULT is left by a rising edge of fault reset alone, and leads to SWITCH_ON_DISABLED.
  DISABLE_VOLTAGE takes the power off at once, wherever there is power.
  What the table does not let happen changes nothing.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final


class PowerState(Enum):
    """State of the automaton."""

    NOT_READY_TO_SWITCH_ON = auto()
    SWITCH_ON_DISABLED = auto()
    READY_TO_SWITCH_ON = auto()
    SWITCHED_ON = auto()
    OPERATION_ENABLED = auto()
    QUICK_STOP_ACTIVE = auto()
    FAULT_REACTION_ACTIVE = auto()
    FAULT = auto()


class PowerEvent(Enum):
    """A command in the controlword, or something that happened inside."""

    SHUTDOWN = auto()
    SWITCH_ON = auto()  # in OPERATION_ENABLED the same bits are "disable operation"
    ENABLE_OPERATION = auto()
    DISABLE_VOLTAGE = auto()
    QUICK_STOP = auto()
    FAULT_RESET = auto()
    INITIALISED = auto()
    STOPPED = auto()  # the quick stop's ramp ended, and its option code does not stay
    FAULT = auto()
    REACTION_ENDED = auto()


_S, _E = PowerState, PowerEvent


def _row(here: PowerState, **after: PowerState) -> dict[PowerEvent, PowerState]:
    """A whole row; a fault leads into its reaction, events that are not named change nothing."""
    named = {_E.FAULT: _S.FAULT_REACTION_ACTIVE} | {_E[name]: to for name, to in after.items()}
    return {event: named.get(event, here) for event in PowerEvent}


STATE_AFTER: Final[dict[PowerState, dict[PowerEvent, PowerState]]] = {
    # The numbers are the transitions of CiA 402-2.
    _S.NOT_READY_TO_SWITCH_ON: _row(
        _S.NOT_READY_TO_SWITCH_ON,
        INITIALISED=_S.SWITCH_ON_DISABLED,  # 1
    ),
    _S.SWITCH_ON_DISABLED: _row(
        _S.SWITCH_ON_DISABLED,
        SHUTDOWN=_S.READY_TO_SWITCH_ON,  # 2
    ),
    _S.READY_TO_SWITCH_ON: _row(
        _S.READY_TO_SWITCH_ON,
        SWITCH_ON=_S.SWITCHED_ON,  # 3
        ENABLE_OPERATION=_S.SWITCHED_ON,  # 3, and 4 follows, as the command still stands
        DISABLE_VOLTAGE=_S.SWITCH_ON_DISABLED,  # 7
        QUICK_STOP=_S.SWITCH_ON_DISABLED,  # 7
    ),
    _S.SWITCHED_ON: _row(
        _S.SWITCHED_ON,
        ENABLE_OPERATION=_S.OPERATION_ENABLED,  # 4
        SHUTDOWN=_S.READY_TO_SWITCH_ON,  # 6
        DISABLE_VOLTAGE=_S.SWITCH_ON_DISABLED,  # 10
        QUICK_STOP=_S.SWITCH_ON_DISABLED,  # 10
    ),
    _S.OPERATION_ENABLED: _row(
        _S.OPERATION_ENABLED,
        SWITCH_ON=_S.SWITCHED_ON,  # 5
        SHUTDOWN=_S.READY_TO_SWITCH_ON,  # 8
        DISABLE_VOLTAGE=_S.SWITCH_ON_DISABLED,  # 9
        QUICK_STOP=_S.QUICK_STOP_ACTIVE,  # 11
    ),
    _S.QUICK_STOP_ACTIVE: _row(
        _S.QUICK_STOP_ACTIVE,
        DISABLE_VOLTAGE=_S.SWITCH_ON_DISABLED,  # 12
        STOPPED=_S.SWITCH_ON_DISABLED,  # 12
        ENABLE_OPERATION=_S.OPERATION_ENABLED,  # 16
    ),
    _S.FAULT_REACTION_ACTIVE: _row(
        _S.FAULT_REACTION_ACTIVE,
        REACTION_ENDED=_S.FAULT,  # 14
    ),
    _S.FAULT: _row(
        _S.FAULT,
        FAULT=_S.FAULT,
        FAULT_RESET=_S.SWITCH_ON_DISABLED,  # 15
    ),
}
assert all(set(row) == set(PowerEvent) for row in STATE_AFTER.values())
assert set(STATE_AFTER) == set(PowerState)

STATUSWORD_OF: Final[dict[PowerState, int]] = {
    _S.NOT_READY_TO_SWITCH_ON: 0x00,
    _S.SWITCH_ON_DISABLED: 0x40,
    _S.READY_TO_SWITCH_ON: 0x21,
    _S.SWITCHED_ON: 0x23,
    _S.OPERATION_ENABLED: 0x27,
    _S.QUICK_STOP_ACTIVE: 0x07,
    _S.FAULT_REACTION_ACTIVE: 0x0F,
    _S.FAULT: 0x08,
}
"""Bits 0 to 3, 5 and 6 of the statusword (6041) by state."""
STATUSWORD_MASK: Final = 0x6F
assert len(set(STATUSWORD_OF.values())) == len(PowerState)

POWERED: Final = frozenset(
    {_S.SWITCHED_ON, _S.OPERATION_ENABLED, _S.QUICK_STOP_ACTIVE, _S.FAULT_REACTION_ACTIVE}
)
"""States in which the power stage has voltage."""

CONTROLLED: Final = frozenset(
    {_S.OPERATION_ENABLED, _S.QUICK_STOP_ACTIVE, _S.FAULT_REACTION_ACTIVE}
)
"""States in which the motor may carry a current."""

FAULTED: Final = frozenset({_S.FAULT_REACTION_ACTIVE, _S.FAULT})

_FAULT_RESET_BIT: Final = 0x80


def command_of(controlword: int, before: int) -> PowerEvent | None:
    """The command that a controlword (6040) gives, with the one before it for the edge of bit 7.

    Bit 7 alone resets, and only as it rises; while it stands nothing else is commanded.
    """
    if controlword & _FAULT_RESET_BIT:
        return None if before & _FAULT_RESET_BIT else PowerEvent.FAULT_RESET
    if not controlword & 0x2:
        return PowerEvent.DISABLE_VOLTAGE
    if not controlword & 0x4:
        return PowerEvent.QUICK_STOP
    if not controlword & 0x1:
        return PowerEvent.SHUTDOWN
    return PowerEvent.ENABLE_OPERATION if controlword & 0x8 else PowerEvent.SWITCH_ON


def state_of(statusword: int) -> PowerState | None:
    """The state that a statusword (6041) tells; None for a pattern that no state has.

    Bit 5 is not looked at where CiA 402 leaves it open.
    """
    for state, bits in STATUSWORD_OF.items():
        has_free_bit = state in FAULTED or not bits & 0x1F
        mask = STATUSWORD_MASK & ~0x20 if has_free_bit else STATUSWORD_MASK
        if statusword & mask == bits & mask:
            return state
    return None
