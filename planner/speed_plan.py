"""Speed along a line: sqrt(a_lat * R), the speed limit, and what motor and brakes can follow."""

import math

import numpy as np

from planner.line import Line
from planner.road import FloatArray

SPEED_MPS_MAX = 25.0 / 3.6  # UAH section 5.2
LATERAL_ACCELERATION_MPS2 = 2.0  # comfort; the safety monitor's envelope starts at 3.0


def speed_plan(
    line: Line,
    speed_mps_max: float = SPEED_MPS_MAX,
    lateral_acceleration_mps2: float = LATERAL_ACCELERATION_MPS2,
    acceleration_mps2: float = 0.8,
    deceleration_mps2: float = 1.0,
    from_standstill: bool = True,
    to_standstill: bool = True,
) -> FloatArray:
    """Return the speed in m/s at each point of the line, shape (N,).

    Args:
        line: The line; its end joins its start.
        speed_mps_max: Never faster.
        lateral_acceleration_mps2: Bounds v^2 times curvature.
        acceleration_mps2: Bounds how speed rises along the line.
        deceleration_mps2: Bounds how it falls.
        from_standstill: The plan is zero at s = 0 and rises from there.
        to_standstill: The plan falls towards zero at the line's end, s = length.

    Without either, the plan is periodic: it may be driven lap after lap.

    Raises:
        ValueError: If a number is not positive and finite; names it.
    """
    for name, value in (
        ("speed_mps_max", speed_mps_max),
        ("lateral_acceleration_mps2", lateral_acceleration_mps2),
        ("acceleration_mps2", acceleration_mps2),
        ("deceleration_mps2", deceleration_mps2),
    ):
        if not 0.0 < value < math.inf:
            raise ValueError(f"{name} is {value}, a positive finite number is needed")
    curvature = np.maximum(np.abs(line.curvature_per_m), 1e-9)
    cap = np.minimum(speed_mps_max, np.sqrt(lateral_acceleration_mps2 / curvature))
    squares = (cap * cap).tolist()
    rise = 2.0 * acceleration_mps2 * line.step_m
    fall = 2.0 * deceleration_mps2 * line.step_m
    count = len(squares)
    # Twice round: the first round finds the speed carried over the joint, the second uses it.
    for place in range(2 * count):
        index = place % count
        squares[index] = min(squares[index], squares[index - 1] + rise)
    for place in range(2 * count, 0, -1):
        index = place % count
        squares[index - 1] = min(squares[index - 1], squares[index] + fall)
    plan = np.sqrt(np.array(squares))
    if from_standstill:
        plan = np.minimum(plan, np.sqrt(2.0 * acceleration_mps2 * line.s_m))
    if to_standstill:
        plan = np.minimum(plan, np.sqrt(2.0 * deceleration_mps2 * (line.length_m - line.s_m)))
    result: FloatArray = plan
    return result
