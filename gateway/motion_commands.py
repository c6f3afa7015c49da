"""UNICAMP's two command sets as decisions: CarCommand (wheels and angle), CmdVel (speed, yaw rate).

UNICAMP: Nogueira et al., Section 4. The bus carries one speed, that of the rear axle's centre, and
one angle; what the wheels turn at in a bend is the electronic differential's, and follows from the
two. A CarCommand that asks for other wheel speeds is refused, never rounded off.
"""

from __future__ import annotations

from typing import Final

from gateway.commands import CommandError, Decision, checked, checked_speed_mps, decide
from gateway.kinematics import Kinematics
from vehicles.vehicle import Vehicle

WHEEL_MISMATCH_MPS: Final = 0.02
WHEEL_MISMATCH_RATIO: Final = 0.02
"""How far the wheels' difference may lie from the differential's, besides a share of the speed.

Assumption: rounding, and the turning radius's uncertainty of a planner that knows its car.
"""


def decide_cmd_vel(vehicle: Vehicle, *, speed_mps: object, yaw_rate_radps: object) -> Decision:
    """The decision that a CmdVel asks for: curvature is yaw rate over speed.

    Args:
        vehicle: Whose limits hold.
        speed_mps: Of the rear axle's centre, negative backwards, within the vehicle's limits.
        yaw_rate_radps: Positive turns the car to the left, at most speed times the largest
            curvature; so 0 at speed 0, where the wheels go straight: a car does not turn on the
            spot. Backwards it is the steering wheel to the right that turns the car left.

    Raises:
        TypeError: A value that is no number.
        CommandError: NaN, infinite or out of range.
    """
    speed = checked_speed_mps(vehicle, speed_mps)
    curvature_max = vehicle.curvature_per_m_max
    high = abs(speed) * curvature_max
    yaw_rate = checked("yaw_rate_radps", yaw_rate_radps, -high, high, "rad/s")
    curvature = yaw_rate / speed if yaw_rate else 0.0
    # a division may be out by the last bit
    curvature = min(max(curvature, -curvature_max), curvature_max)
    return decide(vehicle, speed_mps=speed, curvature_per_m=curvature)


def decide_car_command(
    vehicle: Vehicle, *, left_mps: object, right_mps: object, ackermann_rad: object
) -> Decision:
    """The decision that a CarCommand asks for: the wheels' mean speed and the angle's curvature.

    Args:
        vehicle: Whose limits hold.
        left_mps: Speed of the left rear wheel over ground, negative backwards.
        right_mps: Of the right one. The two must differ as the electronic differential makes them
            (`Kinematics.rear_wheel_speeds_mps`), but for 0.02 m/s and 2 % of the speed.
        ackermann_rad: Angle of the imagined wheel in the middle of the front axle, positive left.

    Raises:
        TypeError: A value that is no number.
        CommandError: NaN, infinite, out of range, or wheels that do not fit the angle.
    """
    kinematics = Kinematics.of(vehicle.geometry, vehicle.steering)
    curvature_max = vehicle.curvature_per_m_max
    angle_max = kinematics.road_wheel_angle_rad(curvature_max)
    angle = checked("ackermann_rad", ackermann_rad, -angle_max, angle_max, "rad")
    curvature = kinematics.curvature_of_road_wheel_per_m(angle)
    curvature = min(max(curvature, -curvature_max), curvature_max)
    fastest = kinematics.rear_wheel_speeds_mps(vehicle.traction.speed_mps_max, abs(curvature))
    wheel_max = fastest.right_mps + WHEEL_MISMATCH_MPS
    back_mps = vehicle.traction.reverse_speed_mps_max
    back = kinematics.rear_wheel_speeds_mps(back_mps, abs(curvature))
    wheel_min = -(back.right_mps + WHEEL_MISMATCH_MPS) if back_mps > 0.0 else 0.0
    left = checked("left_mps", left_mps, wheel_min, wheel_max, "m/s")
    right = checked("right_mps", right_mps, wheel_min, wheel_max, "m/s")
    speed = (left + right) / 2.0
    wheels = kinematics.rear_wheel_speeds_mps(speed, curvature)
    room = WHEEL_MISMATCH_MPS + WHEEL_MISMATCH_RATIO * abs(speed)
    difference = wheels.right_mps - wheels.left_mps
    if abs(right - left - difference) > room:
        raise CommandError(
            f"right_mps - left_mps = {right - left:.6g}: at ackermann_rad = {angle:.6g} and their"
            f" mean of {speed:.6g} m/s allowed {difference - room:.6g} to {difference + room:.6g}"
            " m/s, as the electronic differential turns them"
        )
    return decide(vehicle, speed_mps=speed, curvature_per_m=curvature)
