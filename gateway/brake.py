"""The brake setpoint that follows from a speed: the planner gives no brake of its own."""

from __future__ import annotations

from typing import Final

from gateway.commands import Decision
from vehicles.vehicle import Vehicle

HOLD_SPEED_MPS_MAX: Final = 0.5
"""Below it a car told to stand is held by the servo; regeneration cannot hold (design: 0.5 m/s)."""

REGEN_MARGIN_MPS: Final = 0.5
"""Excess over the setpoint left to regeneration: above noise and a well-tuned loop's error."""

BRAKE_GAIN_PER_S: Final = 2.0
"""Deceleration per m/s of excess beyond the margin. With the servo's 0.29 s (UWA Section 8) the
loop keeps more than 50 degrees of phase."""

BRAKE_RATIO_MAX: Final = 0.6
"""A planner's braking ends here; the rest of the travel belongs to emergencies."""

assert BRAKE_GAIN_PER_S * 0.29 < 0.7  # crossover well below the servo's own speed


def brake_position_ratio(
    vehicle: Vehicle,
    decision: Decision,
    measured_wheel_speed_radps: float,
    applied_wheel_speed_radps: float,
) -> float:
    """Servo setpoint, 0 to 1.

    Args:
        vehicle: What the gateway believes about the car.
        decision: The planner's.
        measured_wheel_speed_radps: Front wheel's speed; NaN when not available.
        applied_wheel_speed_radps: The throttle ECU's setpoint in force (its echo); NaN when not
            available, and then nothing but holding is asked of the brake.
    """
    # The front wheel's own speed, not the rear axle's: no steering angle is needed, and in a turn
    # it is the larger one.
    radius_m = vehicle.geometry.wheel_radius_m
    sign = _travel_sign(decision, measured_wheel_speed_radps, applied_wheel_speed_radps)
    measured_mps = sign * measured_wheel_speed_radps * radius_m
    if decision.speed_mps == 0.0 and abs(measured_mps) < HOLD_SPEED_MPS_MAX:
        return vehicle.brake.hold_ratio
    # Told to stand, and still rolling when it should: on a slope regeneration fades and the margin
    # would let the car creep for ever.
    is_told_to_stand = decision.speed_mps == 0.0 and applied_wheel_speed_radps == 0.0
    is_late = is_told_to_stand and measured_mps > HOLD_SPEED_MPS_MAX
    ratio_min = vehicle.brake.hold_ratio if is_late else 0.0
    excess_mps = measured_mps - sign * applied_wheel_speed_radps * radius_m - REGEN_MARGIN_MPS
    if not excess_mps > 0.0:  # NaN as well: no echo, no braking by speed
        return ratio_min
    wanted_mps2 = BRAKE_GAIN_PER_S * excess_mps
    return max(
        min(wanted_mps2 / vehicle.brake.deceleration_mps2_full, BRAKE_RATIO_MAX), ratio_min
    )


def _travel_sign(
    decision: Decision, measured_wheel_speed_radps: float, applied_wheel_speed_radps: float
) -> float:
    """-1.0 for a car that drives backwards, or was told to and still rolls so; else 1.0."""
    is_backwards = applied_wheel_speed_radps < 0.0 or decision.speed_mps < 0.0
    is_rolling_out = (
        decision.speed_mps == 0.0
        and applied_wheel_speed_radps == 0.0
        and measured_wheel_speed_radps < 0.0
    )
    return -1.0 if is_backwards or is_rolling_out else 1.0
