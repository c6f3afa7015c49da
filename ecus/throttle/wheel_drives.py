"""The rear wheels on two drives of CiA 402: profile velocity, and the electronic differential.

Setpoints and speeds on the bus are those of an imagined wheel in the middle of the front axle
(UAH Eq. 14); the rear wheels roll about the same centre, each on its own radius.
"""

from __future__ import annotations

import math
from typing import Final

from canbus import cia402
from canbus.cia402 import RPM_PER_RADPS, OperationMode
from canbus.drive_client import Setting
from canbus.node import NODE_IDS
from dbc.messages import ErrorCode
from ecus.common.drive_output import DriveOutput
from ecus.throttle.params import ThrottleParams
from vehicles import Vehicle
from vehicles.vehicle import Drives

RAMP_MARGIN: Final = 1.5
"""The ECU's reference obeys the limits; the drives' own ramps only must not hold it back, nor lie
above the speed of a car that the servo brakes as well: its wheels would push."""

SPEED_MARGIN: Final = 1.1


class WheelDrives:
    """Both drives; speeds are the front wheel's, over ground.

    Attributes:
        outputs: left and right.
    """

    def __init__(self, vehicle: Vehicle, drives: Drives, params: ThrottleParams) -> None:
        geometry = vehicle.geometry
        self._half_track_per_wheelbase = 0.5 * geometry.track_m / geometry.wheelbase_m
        self._rpm_per_mps = params.gear_ratio / geometry.wheel_radius_m * RPM_PER_RADPS
        settings = _settings(vehicle, params, self._rpm_per_mps)
        self.outputs = tuple(
            DriveOutput(
                node_id,
                NODE_IDS["Throttle"],
                OperationMode.PROFILE_VELOCITY,
                settings,
                ErrorCode.ER1,
            )
            for node_id in (drives.left_wheel_node_id, drives.right_wheel_node_id)
        )

    def speed_mps(self, road_wheel_rad: float) -> float:
        """What the wheels do, by the drives' encoders; NaN if one of them is not heard."""
        if not all(output.is_heard for output in self.outputs):
            return math.nan
        mean_rpm = 0.5 * sum(output.client.velocity_rpm for output in self.outputs)
        return mean_rpm / self._rpm_per_mps / math.cos(road_wheel_rad)

    def follow(self, speed_mps: float, road_wheel_rad: float) -> None:
        """Turns the wheels about the centre that the front wheels point at."""
        rear_rpm = speed_mps * math.cos(road_wheel_rad) * self._rpm_per_mps
        share = math.tan(road_wheel_rad) * self._half_track_per_wheelbase
        left, right = self.outputs
        left.follow(round(rear_rpm * (1.0 - share)))
        right.follow(round(rear_rpm * (1.0 + share)))

    def brake(self) -> None:
        """Brakes both wheels by the drives' ramp, switched on for it if need be."""
        for output in self.outputs:
            output.follow(0)


def _settings(vehicle: Vehicle, params: ThrottleParams, rpm_per_mps: float) -> list[Setting]:
    half = 0.5 * vehicle.geometry.track_m * vehicle.curvature_per_m_max
    speed_mps = SPEED_MARGIN * params.speed_mps_max * (1.0 + half)
    slowing_mps2 = RAMP_MARGIN * max(
        params.deceleration_mps2_max, params.regen_deceleration_mps2_full, params.brake_mps2_full
    )
    values = {
        cia402.PROFILE_VELOCITY_MAX: speed_mps * rpm_per_mps,
        cia402.PROFILE_ACCELERATION: RAMP_MARGIN * params.acceleration_mps2_max * rpm_per_mps,
        cia402.PROFILE_DECELERATION: slowing_mps2 * rpm_per_mps,
        cia402.QUICK_STOP_DECELERATION: slowing_mps2 * rpm_per_mps,
    }
    return [
        Setting(key=key, value=max(1, round(value)), byte_count=4)
        for key, value in values.items()
    ]
