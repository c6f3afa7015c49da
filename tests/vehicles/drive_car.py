"""A car whose steering and rear wheels are turned by drives on the bus."""

from __future__ import annotations

from vehicles import load_vehicle, parse_vehicle

DRIVES = """
[drives]
steering_node_id = { value = 0x11, source = "test" }
left_wheel_node_id = { value = 0x12, source = "test" }
right_wheel_node_id = { value = 0x13, source = "test" }
encoder_counts_per_rev = { value = 4096, source = "test" }
steering_gear_ratio = { value = 20.0, source = "test" }
"""
TEXT = load_vehicle("baja_5b").text + DRIVES
CAR = parse_vehicle(TEXT, "drive_car.toml")
STEER, LEFT, RIGHT = CAR.drive_node_ids
