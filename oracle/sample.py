"""The truth about car and driver at one instant, as the oracle wants to be told it."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import Final


@dataclass(slots=True, init=False)
class Sample:
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
        drive_torque_nm: What it would be without regeneration.
        reverse_selected: The drive's reverse contact is closed, by ECU, watchdog and relay.
        relay_closed: The manual/automatic relay; closed = automatic.
        steering_torque_nm: The driver's hands on the wheel.
        throttle_pedal_ratio: The driver's foot, 0 to 1.
        brake_pedal_ratio: The driver's foot, 0 to 1.
        button_pressed: The manual/automatic button.
        emergency_stop_pressed: The emergency-stop button.
        path_error_m: Distance from the path to be driven; NaN where there is none.
    """

    true_ns: Final[int]
    speed_mps: Final[float]
    longitudinal_acceleration_mps2: Final[float]
    yaw_rate_radps: Final[float]
    column_angle_rad: Final[float]
    column_rate_radps: Final[float]
    steering_motor_powered: Final[bool]
    servo_powered: Final[bool]
    servo_target_ratio: Final[float]
    servo_position_ratio: Final[float]
    brake_ratio: Final[float]
    motor_torque_nm: Final[float]
    drive_torque_nm: Final[float]
    reverse_selected: Final[bool]
    relay_closed: Final[bool]
    steering_torque_nm: Final[float]
    throttle_pedal_ratio: Final[float]
    brake_pedal_ratio: Final[float]
    button_pressed: Final[bool]
    emergency_stop_pressed: Final[bool]
    path_error_m: Final[float]

    def __init__(
        self,
        *,
        true_ns: int = 0,
        speed_mps: float = 0.0,
        longitudinal_acceleration_mps2: float = 0.0,
        yaw_rate_radps: float = 0.0,
        column_angle_rad: float = 0.0,
        column_rate_radps: float = 0.0,
        steering_motor_powered: bool = False,
        servo_powered: bool = False,
        servo_target_ratio: float = 0.0,
        servo_position_ratio: float = 0.0,
        brake_ratio: float = 0.0,
        motor_torque_nm: float = 0.0,
        drive_torque_nm: float = 0.0,
        reverse_selected: bool = False,
        relay_closed: bool = False,
        steering_torque_nm: float = 0.0,
        throttle_pedal_ratio: float = 0.0,
        brake_pedal_ratio: float = 0.0,
        button_pressed: bool = False,
        emergency_stop_pressed: bool = False,
        path_error_m: float = nan,
    ) -> None:
        self.true_ns = true_ns
        self.speed_mps = speed_mps
        self.longitudinal_acceleration_mps2 = longitudinal_acceleration_mps2
        self.yaw_rate_radps = yaw_rate_radps
        self.column_angle_rad = column_angle_rad
        self.column_rate_radps = column_rate_radps
        self.steering_motor_powered = steering_motor_powered
        self.servo_powered = servo_powered
        self.servo_target_ratio = servo_target_ratio
        self.servo_position_ratio = servo_position_ratio
        self.brake_ratio = brake_ratio
        self.motor_torque_nm = motor_torque_nm
        self.drive_torque_nm = drive_torque_nm
        self.reverse_selected = reverse_selected
        self.relay_closed = relay_closed
        self.steering_torque_nm = steering_torque_nm
        self.throttle_pedal_ratio = throttle_pedal_ratio
        self.brake_pedal_ratio = brake_pedal_ratio
        self.button_pressed = button_pressed
        self.emergency_stop_pressed = emergency_stop_pressed
        self.path_error_m = path_error_m

    @property
    def is_full_brake_asked(self) -> bool:
        """The servo is powered and sent to its end."""
        return self.servo_powered and self.servo_target_ratio >= 0.99
