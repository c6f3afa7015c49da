"""The steering motor on a drive of CiA 402: profile position, in the steering sensor's angle.

A drive counts from where its power came on. Where the wheel's zero lies in its counts is learned
from the steering sensor while the drive does not follow, so no homing run turns the wheels.
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
from vehicles import Vehicle
from vehicles.vehicle import Drives

RATE_MARGIN: Final = 1.5
"""The ECU's reference obeys the limits; the drive's own profile only must not hold it back."""
ACCELERATION_MARGIN: Final = 4.0

ZERO_SHARE: Final = 0.1
"""What each reading counts for in the zero: a tenth of a second's mean at 10 ms."""


COUNTS_MAX: Final = (1 << 31) - 1
"""Of a target: a drive that counts so far that the wheel's way would leave them is not used."""


class SteeringDrive(DriveOutput):
    """The drive of the steering motor."""

    def __init__(self, vehicle: Vehicle, drives: Drives) -> None:
        self._counts_per_rad = drives.encoder_counts_per_rev * drives.steering_gear_ratio / math.tau
        self._zero: float | None = None
        self._reach = 2.0 * vehicle.steering.sensor_angle_rad_max * self._counts_per_rad
        super().__init__(
            drives.steering_node_id,
            NODE_IDS["Steering"],
            OperationMode.PROFILE_POSITION,
            _settings(vehicle, drives, self._counts_per_rad),
            ErrorCode.ER4,
        )

    def measure(self, angle_rad: float) -> None:
        """Learns the zero from a reading of the steering sensor; NaN teaches nothing."""
        if not self.client.is_ready:
            self._zero = None  # a drive that restarts counts anew
        elif not self.client.is_following and not math.isnan(angle_rad):
            zero = self.client.position - angle_rad * self._counts_per_rad
            self._zero = zero if self._zero is None else (
                self._zero + ZERO_SHARE * (zero - self._zero)
            )
        self.is_placed = self._zero is not None and abs(self._zero) + self._reach <= COUNTS_MAX

    def turn_to(self, angle_rad: float) -> None:
        """Follows an angle of the steering wheel; one whose zero is not known stops."""
        if self._zero is None or not self.is_placed:
            self.stop()
        else:
            self.follow(round(self._zero + angle_rad * self._counts_per_rad))


def _settings(vehicle: Vehicle, drives: Drives, counts_per_rad: float) -> list[Setting]:
    steering = vehicle.steering
    rpm_per_radps = drives.steering_gear_ratio * RPM_PER_RADPS
    rate_rpm = round(RATE_MARGIN * steering.wheel_rate_radps_max * rpm_per_radps)
    ramp = round(ACCELERATION_MARGIN * steering.wheel_acceleration_radps2_max * rpm_per_radps)
    error = round(vehicle.envelope.wheel_angle_divergence_rad_max * counts_per_rad)
    values = {
        cia402.PROFILE_VELOCITY_MAX: rate_rpm,
        cia402.PROFILE_VELOCITY: rate_rpm,
        cia402.PROFILE_ACCELERATION: ramp,
        cia402.PROFILE_DECELERATION: ramp,
        cia402.QUICK_STOP_DECELERATION: ramp,
        cia402.FOLLOWING_ERROR_WINDOW: error,
    }
    return [Setting(key=key, value=value, byte_count=4) for key, value in values.items()]
