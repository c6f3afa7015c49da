"""Who sends which identifier of the motor drives on a car that has them.

Its own reading of CANopen's predefined connection set (CiA 301, 7.3.3) and of docs/drives.md.
"""

from __future__ import annotations

from typing import Final

from vehicles import Vehicle
from vehicles.vehicle import DRIVE_NAMES

STEERING_DRIVE: Final = DRIVE_NAMES[0]
LEFT_DRIVE: Final = DRIVE_NAMES[1]
RIGHT_DRIVE: Final = DRIVE_NAMES[2]

_OF_DRIVE: Final = (0x080, 0x180, 0x280, 0x580, 0x700)
"""EMCY, TPDO 1 and 2, SDO answer, heartbeat."""
_SDO_REQUEST: Final = 0x600


def drive_owners(vehicle: Vehicle) -> dict[int, str]:
    """The station that alone may send an identifier; empty for a car without drives."""
    drives = vehicle.drives
    if drives is None:
        return {}
    owners: dict[int, str] = {}
    for drive, node_id, ecu, command in (
        (STEERING_DRIVE, drives.steering_node_id, "Steering", 0x200),  # RPDO 1: position
        (LEFT_DRIVE, drives.left_wheel_node_id, "Throttle", 0x300),  # RPDO 2: velocity
        (RIGHT_DRIVE, drives.right_wheel_node_id, "Throttle", 0x300),
    ):
        owners |= {base + node_id: drive for base in _OF_DRIVE}
        owners |= {base + node_id: ecu for base in (command, _SDO_REQUEST)}
    return owners
