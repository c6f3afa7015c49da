"""Numbers of the drive profile CiA 402-2: objects, modes, bits. Drives and masters share them.

An object is index and sub-index in one number, as the upper 24 bits of a PDO mapping entry:
0x604100 is 6041 sub 0. Units are those of an EPOS2: encoder units, rpm, rpm/s, ms, mA.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import IntEnum
from typing import Final

from canbus.canopen_protocol import HEARTBEAT_ID, SDO_REQUEST_ID, SDO_RESPONSE_ID

RPM_PER_RADPS: Final = 30.0 / math.pi
"""The profile's velocities of a motor are in turns per minute."""

DRIVE_NODE_ID_MIN: Final = 0x11
"""Node ids of drives begin here."""

EMCY_ID: Final = 0x080
POSITION_ID: Final = 0x180  # TPDO 1: statusword, position, mode
VELOCITY_ID: Final = 0x280  # TPDO 2: statusword, velocity, current
TARGET_POSITION_ID: Final = 0x200  # RPDO 1: controlword, target position
TARGET_VELOCITY_ID: Final = 0x300  # RPDO 2: controlword, target velocity
"""Where a drive's identifiers begin, as `dbc/eds/drive.eds` has them; its node id is added."""

SENT_IDS: Final = (EMCY_ID, POSITION_ID, VELOCITY_ID, SDO_RESPONSE_ID, HEARTBEAT_ID)
"""What the drive itself sends; the rest is its master's."""


def identifiers(node_ids: Iterable[int]) -> frozenset[int]:
    """All identifiers in use between some drives and their masters."""
    bases = (*SENT_IDS, TARGET_POSITION_ID, TARGET_VELOCITY_ID, SDO_REQUEST_ID)
    return frozenset(base + node_id for node_id in node_ids for base in bases)


ABORT_CONNECTION_OPTION: Final = 0x600700
ERROR_CODE: Final = 0x603F00
CONTROLWORD: Final = 0x604000
STATUSWORD: Final = 0x604100
QUICK_STOP_OPTION: Final = 0x605A00
HALT_OPTION: Final = 0x605D00
FAULT_REACTION_OPTION: Final = 0x605E00
MODE: Final = 0x606000
MODE_DISPLAY: Final = 0x606100
POSITION_DEMAND: Final = 0x606200
POSITION_ACTUAL: Final = 0x606400
FOLLOWING_ERROR_WINDOW: Final = 0x606500
POSITION_WINDOW: Final = 0x606700
POSITION_WINDOW_TIME: Final = 0x606800
VELOCITY_DEMAND: Final = 0x606B00
VELOCITY_ACTUAL: Final = 0x606C00
VELOCITY_WINDOW: Final = 0x606D00
VELOCITY_WINDOW_TIME: Final = 0x606E00
VELOCITY_THRESHOLD: Final = 0x606F00
CURRENT_MAX: Final = 0x607300
CURRENT_RATED: Final = 0x607500
CURRENT_ACTUAL: Final = 0x607800
TARGET_POSITION: Final = 0x607A00
HOME_OFFSET: Final = 0x607C00
POSITION_LIMIT_MIN: Final = 0x607D01
POSITION_LIMIT_MAX: Final = 0x607D02
PROFILE_VELOCITY_MAX: Final = 0x607F00
PROFILE_VELOCITY: Final = 0x608100
PROFILE_ACCELERATION: Final = 0x608300
PROFILE_DECELERATION: Final = 0x608400
QUICK_STOP_DECELERATION: Final = 0x608500
HOMING_METHOD: Final = 0x609800
HOMING_SPEED_STOP: Final = 0x609901
HOMING_SPEED_INDEX: Final = 0x609902
HOMING_ACCELERATION: Final = 0x609A00
TARGET_VELOCITY: Final = 0x60FF00
SUPPORTED_MODES: Final = 0x650200

HOMING_CURRENT: Final = 0x208000
"""The maker's: number and meaning after the EPOS2 (assumption: not checked on one)."""


class OperationMode(IntEnum):
    """Modes of operation (6060) that a drive of ours has."""

    NONE = 0
    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    HOMING = 6


class HomingMethod(IntEnum):
    """Homing method (6098): CiA 402's numbers, and below zero the maker's (EPOS2)."""

    STOP_NEGATIVE = -4  # against the end stop until the homing current flows
    STOP_POSITIVE = -3
    INDEX_NEGATIVE = 33
    INDEX_POSITIVE = 34
    HERE = 35


class StopOption(IntEnum):
    """Option codes 605A, 605D and 605E; which of them an object takes, its EDS and code say."""

    DISABLE = 0
    SLOW_DOWN = 1
    QUICK_STOP = 2
    SLOW_DOWN_AND_STAY = 5
    QUICK_STOP_AND_STAY = 6


class AbortOption(IntEnum):
    """Abort connection option (6007): what a lost master does to a drive that runs."""

    NOTHING = 0
    FAULT = 1
    DISABLE_VOLTAGE = 2
    QUICK_STOP = 3


# Controlword (6040), by mode where a bit has several meanings
NEW_SETPOINT: Final = 1 << 4
HOMING_START: Final = 1 << 4
CHANGE_AT_ONCE: Final = 1 << 5
RELATIVE: Final = 1 << 6
HALT: Final = 1 << 8

# Statusword (6041), likewise
VOLTAGE_ENABLED: Final = 1 << 4
REMOTE: Final = 1 << 9
TARGET_REACHED: Final = 1 << 10
LIMIT_ACTIVE: Final = 1 << 11
SETPOINT_ACKNOWLEDGED: Final = 1 << 12
STANDING: Final = 1 << 12
HOMING_ATTAINED: Final = 1 << 12
FOLLOWING_ERROR: Final = 1 << 13
HOMING_ERROR: Final = 1 << 13
