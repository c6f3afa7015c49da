"""A human driver's hands on the steering wheel."""

from __future__ import annotations

import math
from typing import Final

from simulation.plant.params import SteeringColumnParams
from simulation.plant.state import Truth

FEEL_RAD: Final = math.radians(0.05)
"""Of road wheel: an error that a driver feels, and pushes past the column's friction for."""
HAND_RADPS: Final = 8.0
"""How fast hands move a wheel, whatever its size: the pole pair of hands and column."""
HAND_DAMPING_S: Final = 0.15


def hand_torque_nm(column: SteeringColumnParams, truth: Truth, road_wheel_rad: float) -> float:
    """What hands do that want the road wheels at this angle; the motor does nothing."""
    ratio = column.column_to_road_wheel_ratio
    inertia_kgm2 = column.column_inertia_kgm2 + column.hand_wheel_inertia_kgm2
    error_rad = road_wheel_rad * ratio - truth.column_angle_rad
    error_rad -= HAND_DAMPING_S * truth.column_rate_radps
    against_friction = math.tanh(error_rad / (FEEL_RAD * ratio))
    return inertia_kgm2 * HAND_RADPS**2 * error_rad + column.coulomb_torque_nm * against_friction
