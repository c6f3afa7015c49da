"""A human driver who rolls along a straight line, in MANUAL: what `dbw calibrate` is tried on.

His hands tremble and wander, as hands do; he looks where the car points and brings it back.
"""

from __future__ import annotations

import math
from typing import Final

from simulation.hands import hand_torque_nm
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
ROLL_S_MAX: Final = 300.0


def roll_straight(vehicle: Vehicle, seed: int, way_m: float) -> World:
    """The world after a roll of so many metres and a stop; its trace has every frame."""
    world = World(vehicle, seed)
    car, hands = world.car, world.car.driver
    world.run_for(START_S)
    start_s = world.now_ns / 1e9
    cruise_mps = SPEED_SHARE * vehicle.traction.speed_mps_max
    look_m = LOOK_AHEAD_WHEELBASES * vehicle.geometry.wheelbase_m
    while (truth := car.truth).speed_mps > 0.0 or truth.distance_m < way_m:
        time_s = world.now_ns / 1e9 - start_s
        assert time_s < ROLL_S_MAX, "the car does not get there"
        is_over = truth.distance_m >= way_m
        hands.throttle_pedal_ratio = PEDAL_RATIO * (truth.speed_mps < cruise_mps and not is_over)
        hands.brake_pedal_ratio = 0.3 * is_over
        wanted_rad = WANDER_RAD * math.sin(2.0 * math.pi * time_s / WANDER_S)
        wanted_rad -= math.atan(truth.pose.heading_rad * vehicle.geometry.wheelbase_m / look_m)
        hands.steering_torque_nm = hand_torque_nm(car.params.steering, truth, wanted_rad)
        world.run_for(TICK_S)
    return world
