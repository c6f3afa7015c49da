"""The other cars on vcan0, one of them with its motor drives on the bus."""

from __future__ import annotations

from pathlib import Path

import pytest

from canbus.cia402 import identifiers
from dbc.messages import ErrorCode, Mode
from tests.vcan.shell import cansend
from tests.vcan.stack import VEHICLE, Stack
from vehicles import known_vehicles, load_vehicle

SPEED_MPS = 2.4
"""Less than what any of them may."""


@pytest.mark.parametrize("name", [name for name in known_vehicles() if name != VEHICLE])
def test_every_vehicle_drives_and_is_stopped(name: str, tmp_path: Path) -> None:
    vehicle = load_vehicle(name)
    with Stack(tmp_path, vehicle=name) as stack:
        stack.recover()
        stack.drive(SPEED_MPS)
        sent_s = cansend("001#")
        stack.brakes()
        assert stack.mode is Mode.EMERGENCY
        assert ErrorCode.ER1 in stack.planner.state().codes
        of_drives = {line.can_id for line in stack.log(sent_s)} & identifiers(
            vehicle.drive_node_ids
        )
        assert bool(of_drives) == (vehicle.drives is not None)
        stack.recover()
