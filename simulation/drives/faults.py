"""What may break in a drive, and what that means: a table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

GENERIC: Final = 0x01
CURRENT: Final = 0x02
VOLTAGE: Final = 0x04
TEMPERATURE: Final = 0x08
COMMUNICATION: Final = 0x10
PROFILE: Final = 0x20
"""Bits of the error register (1001), CiA 301, 7.5.2.2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultKind:
    """Error code (CiA 301, table 26; CiA 402-2), register, and whether the motor can be braked."""

    error_code: int
    register: int
    is_controllable: bool
    """False: nobody can brake with this broken, so the power goes off whatever 605E says."""


class DriveFault(Enum):
    """Faults of a drive. Which of them an EPOS2 can still brake with is an assumption."""

    OVERCURRENT = FaultKind(error_code=0x2310, register=CURRENT, is_controllable=False)
    UNDERVOLTAGE = FaultKind(error_code=0x3220, register=VOLTAGE, is_controllable=False)
    OVERTEMPERATURE = FaultKind(error_code=0x4210, register=TEMPERATURE, is_controllable=True)
    ENCODER = FaultKind(error_code=0x7320, register=PROFILE, is_controllable=False)
    HEARTBEAT = FaultKind(error_code=0x8130, register=COMMUNICATION, is_controllable=True)
    FOLLOWING_ERROR = FaultKind(error_code=0x8611, register=PROFILE, is_controllable=True)
