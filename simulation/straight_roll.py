"""A human driver who rolls along a straight line, in MANUAL: what `dbw calibrate` is tried on.

His hands tremble and wander, as hands do; he looks where the car points and brings it back.
"""

from __future__ import annotations

import math
from typing import Final

from simulation.world import World
from vehicles import Vehicle

TICK_S: Final = 0.02
START_S: Final = 1.0
"""Until every node has started."""
SPEED_SHARE: Final = 0.5
"""Of the vehicle's top speed."""
PEDAL_RATIO: Final = 0.2
LOOK_AHEAD_WHEELBASES: Final = 5.0
WANDER_RAD: Final = math.radians(0.3)
"""Of road wheel, besides what the direction asks for."""
WANDER_S: Final = 3.7
FEEL_RAD: Final = math.radians(0.05)
"""Of road wheel: an error that a driver feels, and pushes past the column's friction for."""
HAND_RADPS: Final = 8.0
"""How fast hands move a wheel, whatever its size: the pole pair of hands and column."""
HAND_DAMPING_S: Final = 0.15
ROLL_S_MAX: Final = 300.0


def roll_straight(vehicle: Vehicle, seed: int, way_m: float) -> World:
    """The world after a roll of so many metres and a stop; its trace has every frame."""
    world = World(vehicle, seed)
    car, hands = world.car, world.car.driver
    world.run_for(START_S)
    start_s = world.now_ns / 1e9
    cruise_mps = SPEED_SHARE * vehicle.traction.speed_mps_max
    column = car.params.steering
    inertia_kgm2 = column.column_inertia_kgm2 + column.hand_wheel_inertia_kgm2
    stiffness_nm_per_rad = inertia_kgm2 * HAND_RADPS**2
    look_m = LOOK_AHEAD_WHEELBASES * vehicle.geometry.wheelbase_m
    while (truth := car.truth).speed_mps > 0.0 or truth.distance_m < way_m:
        time_s = world.now_ns / 1e9 - start_s
        assert time_s < ROLL_S_MAX, "the car does not get there"
        is_over = truth.distance_m >= way_m
        hands.throttle_pedal_ratio = PEDAL_RATIO * (truth.speed_mps < cruise_mps and not is_over)
        hands.brake_pedal_ratio = 0.3 * is_over
        wanted_rad = WANDER_RAD * math.sin(2.0 * math.pi * time_s / WANDER_S)
        wanted_rad -= math.atan(truth.pose.heading_rad * vehicle.geometry.wheelbase_m / look_m)
        column_rad = wanted_rad * vehicle.steering.ratio
        error_rad = column_rad - truth.column_angle_rad - HAND_DAMPING_S * truth.column_rate_radps
        against_friction = math.tanh(error_rad / (FEEL_RAD * vehicle.steering.ratio))
        hands.steering_torque_nm = (
            stiffness_nm_per_rad * error_rad + column.coulomb_torque_nm * against_friction
        )
        world.run_for(TICK_S)
    return world
