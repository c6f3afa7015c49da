"""Limits that the safety monitor watches, read from the status frames as they are on the bus."""

from __future__ import annotations

import math
from typing import TypeVar

from bench.rig import Rig
from dbc.codec import Decoded, decode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import BrakeStatus, SteerStatus, ThrottleStatus
from safety_monitor.motion import AXLE_SPEED_DIVERGENCE_MPS

ContentT = TypeVar("ContentT")


def _newest(rig: Rig, name: str, kind: type[ContentT]) -> ContentT:
    decoded = decode(rig.newest[SPEC_OF_NAME[name].can_id][1])
    assert isinstance(decoded, Decoded) and isinstance(decoded.message, kind)
    return decoded.message


def steering_diverges(rig: Rig) -> bool:
    """The steering wheel is further from the setpoint in force than the vehicle file allows."""
    status = _newest(rig, "STEER_STATUS", SteerStatus)
    error_rad = status.applied_steering_wheel_angle_rad - status.steering_wheel_angle_rad
    return abs(error_rad) > rig.world.vehicle.envelope.wheel_angle_divergence_rad_max


def speed_diverges(rig: Rig) -> bool:
    """The same of the driven wheels' speed."""
    vehicle = rig.world.vehicle
    status = _newest(rig, "THROTTLE_STATUS", ThrottleStatus)
    error_radps = status.applied_wheel_speed_radps - status.wheel_speed_radps
    error_mps = abs(error_radps) * vehicle.geometry.wheel_radius_m
    return error_mps > vehicle.envelope.speed_divergence_mps_max


def axles_diverge(rig: Rig) -> bool:
    """Driven and rear wheels tell different speeds (UAH Eq. 14)."""
    vehicle = rig.world.vehicle
    angle_rad = _newest(rig, "STEER_STATUS", SteerStatus).steering_wheel_angle_rad
    front_radps = _newest(rig, "THROTTLE_STATUS", ThrottleStatus).wheel_speed_radps
    rear_radps = _newest(rig, "BRAKE_STATUS", BrakeStatus).rear_wheel_speed_radps
    difference_radps = front_radps * math.cos(angle_rad / vehicle.steering.ratio) - rear_radps
    difference_mps = abs(difference_radps) * vehicle.geometry.wheel_radius_m
    return difference_mps > AXLE_SPEED_DIVERGENCE_MPS
