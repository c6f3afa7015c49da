"""The numbers that the oracle judges by, each with its source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from oracle.words import NS_PER_MS, NS_PER_S
from vehicles import Vehicle
from vehicles.vehicle import DriverPolicy

SENSED_NS: Final = 21 * NS_PER_MS
"""docs/safety.md and the time budget: a sensed cause is on the bus within 20 ms and the wire."""
SILENT_NS: Final = 75 * NS_PER_MS
"""A cause that is a silence: 60 ms, a cycle and the wire."""
HAZARD_NS: Final = 100 * NS_PER_MS
"""Any injected fault (the planner's silence apart)."""
DRIVER_WINS_NS: Final = 100 * NS_PER_MS
"""docs/safety.md: from a touch to MANUAL."""
DRIVER_WINS_FAULTY_NS: Final = 150 * NS_PER_MS
"""The same while something is faulty: 100 ms from the debounced touch."""
MEMORY_NS: Final = 2 * NS_PER_S
"""So long a fault that has ended may still be the reason for what happens."""
NO_DRIVE_RATIO: Final = 1.0 / 64.0
"""Share of the motor's torque that counts as none: 2 N.m of tabby_evo's."""
REGENERATING_RATIO: Final = 1.0 / 12.0
"""Share of the regeneration that counts as some: 5 N.m of tabby_evo's."""
assert SENSED_NS < SILENT_NS < HAZARD_NS < MEMORY_NS


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Limits of one vehicle; `of` makes them, everything can be replaced.

    Attributes:
        sample_ns: How far apart the looks at the truth are.
        hazard_ns: From a hazardous fault to EMERGENCY_BRAKE or the servo's full setpoint.
        sensed_ns: The same of what a node senses, while nothing is faulty.
        memory_ns: So long a fault that has ended excuses an emergency brake.
        servo_travel_ns: Brake from released to full (UWA Testing: 0.29 s).
        deceleration_mps2_min: Of the full brake on the worst road.
        drive_cut_ns: From the brake's beginning until drive torque no longer rises: the slowest
            way to notice it, and the traction controller's dead time of 40 ms.
        drive_gone_ns: Until there is none, the controller's lag included.
        drive_torque_nm_max: What counts as none, of either sign.
        regenerating_nm: Regeneration that counts as some.
        motor_torque_nm_full: Of the traction motor.
        moving_mps: The speed above which no brake is released, and a little (ER3: 0.2 m/s).
        standing_mps: Below this the car stands.
        driver_torque_nm: Hand torque that is the driver's for certain: threshold and 30 %.
        throttle_pedal_ratio: The same of the throttle pedal.
        brake_pedal_ratio: The same of the foot beyond the servo.
        debounce_ns: So long an input must last to count.
        driver_wins_ns: From a touch to MANUAL.
        driver_wins_faulty_ns: The same while something is faulty.
        is_touch_a_hazard: The vehicle's policy lets some touches brake (UWA).
        steering_window_s: So long after a setpoint was replaced its reference may still coast on.
        path_error_m_max: While engaged (UAH Section 5.3: 0.863 m).
    """

    sample_ns: int = 10 * NS_PER_MS
    hazard_ns: int = HAZARD_NS
    sensed_ns: int = SENSED_NS
    memory_ns: int = MEMORY_NS
    servo_travel_ns: int
    deceleration_mps2_min: float
    drive_cut_ns: int = SILENT_NS + 50 * NS_PER_MS
    drive_gone_ns: int = SILENT_NS + 600 * NS_PER_MS
    drive_torque_nm_max: float
    regenerating_nm: float
    motor_torque_nm_full: float
    moving_mps: float = 0.25
    standing_mps: float = 0.15
    driver_torque_nm: float
    throttle_pedal_ratio: float
    brake_pedal_ratio: float
    debounce_ns: int
    driver_wins_ns: int = DRIVER_WINS_NS
    driver_wins_faulty_ns: int = DRIVER_WINS_FAULTY_NS
    is_touch_a_hazard: bool
    steering_window_s: float
    path_error_m_max: float = 0.863

    @classmethod
    def of(cls, vehicle: Vehicle, **changes: Any) -> Settings:
        """Those of a vehicle, some of them changed."""
        steering, brake, policy = vehicle.steering, vehicle.brake, vehicle.policy
        policies = (policy.driver_steers_against, policy.driver_brakes_alone)
        values: dict[str, Any] = {
            "servo_travel_ns": round(brake.full_travel_s * NS_PER_S),
            "deceleration_mps2_min": brake.deceleration_mps2_min,
            "drive_torque_nm_max": NO_DRIVE_RATIO * vehicle.traction.motor_torque_nm_max,
            "regenerating_nm": REGENERATING_RATIO * vehicle.traction.regen_torque_nm_max,
            "motor_torque_nm_full": vehicle.traction.motor_torque_nm_max,
            "driver_torque_nm": 1.3 * steering.driver_torque_nm_max,
            "throttle_pedal_ratio": 1.3 * vehicle.traction.pedal_ratio_max,
            "brake_pedal_ratio": 1.3 * brake.pedal_ratio_max,
            "debounce_ns": round(vehicle.times.driver_debounce_s * NS_PER_S),
            "is_touch_a_hazard": DriverPolicy.EMERGENCY in policies,
            "steering_window_s": 0.1
            + steering.wheel_rate_radps_max / steering.wheel_acceleration_radps2_max,
        }
        return cls(**(values | changes))
