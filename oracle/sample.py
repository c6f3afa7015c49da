"""The truth about car and driver at one instant, as the oracle wants to be told it.

A named tuple: made a hundred times a second, it costs a quarter of a frozen dataclass.
"""

from __future__ import annotations

from math import nan
from typing import NamedTuple


class Sample(NamedTuple):
    """One look at the car; by default it is parked, and nobody touches anything.

    Attributes:
        true_ns: True time.
        speed_mps: At the rear-axle centre, negative backwards.
        longitudinal_acceleration_mps2: At the centre of gravity.
        yaw_rate_radps: Positive to the left.
        column_angle_rad: Steering column, positive to the left.
        column_rate_radps: Its rate.
        steering_motor_powered: The motor driver's outputs are closed, by ECU, watchdog and relay.
        servo_powered: The same of the brake servo.
        servo_target_ratio: Where the servo is sent, 0 to 1.
        servo_position_ratio: Where it is.
        brake_ratio: The brake pedal: servo or foot, whichever is further.
        motor_torque_nm: Traction motor; negative when it regenerates.
        relay_closed: The manual/automatic relay; closed = automatic.
        steering_torque_nm: The driver's hands on the wheel.
        throttle_pedal_ratio: The driver's foot, 0 to 1.
        brake_pedal_ratio: The driver's foot, 0 to 1.
        button_pressed: The manual/automatic button.
        emergency_stop_pressed: The emergency-stop button.
        path_error_m: Distance from the path to be driven; NaN where there is none.
    """

    true_ns: int = 0
    speed_mps: float = 0.0
    longitudinal_acceleration_mps2: float = 0.0
    yaw_rate_radps: float = 0.0
    column_angle_rad: float = 0.0
    column_rate_radps: float = 0.0
    steering_motor_powered: bool = False
    servo_powered: bool = False
    servo_target_ratio: float = 0.0
    servo_position_ratio: float = 0.0
    brake_ratio: float = 0.0
    motor_torque_nm: float = 0.0
    relay_closed: bool = False
    steering_torque_nm: float = 0.0
    throttle_pedal_ratio: float = 0.0
    brake_pedal_ratio: float = 0.0
    button_pressed: bool = False
    emergency_stop_pressed: bool = False
    path_error_m: float = nan

    @property
    def is_full_brake_asked(self) -> bool:
        """The servo is powered and sent to its end."""
        return self.servo_powered and self.servo_target_ratio >= 0.99
