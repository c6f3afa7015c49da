"""The car whose steering and rear wheels are turned by drives on the bus."""

from __future__ import annotations

from vehicles import load_vehicle

CAR = load_vehicle("baja_5b")
TEXT = CAR.text
DRIVES = TEXT[TEXT.index("\n[drives]\n") :]
STEER, LEFT, RIGHT = CAR.drive_node_ids
GEAR = "steering_gear_ratio = { value = 20.0"
