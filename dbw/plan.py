"""What is to be driven: the line on the road, its speeds and the planner's tuning, per vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dbw.failures import UserMistake
from planner.line import Line, drivable_line
from planner.pure_pursuit import PursuitParams
from planner.road import FloatArray, Road
from planner.speed_plan import SPEED_MPS_MAX, speed_plan
from vehicles import Vehicle

RADIUS_RESERVE = 1.2
"""Of the tightest bend planned over the tightest steered: 12 m for TABBY EVO. The rest corrects."""

TYRE_WIDTH_M = 0.173
"""Added to the track for the body's width: TABBY EVO is 1.488 m wide (UAH Table 1)."""

DISTANCE_M_MIN = 5.0

STOP_MPS2 = 1.0
"""Of the planned stop at the end of a part of a lap, as the speed plan's own at its end."""

STEERING_LAG_S = 0.14
"""From a curvature decision to the curvature driven, whole stack: bus, steering loop and the tyres'
side slip. Measured on the campus as the lag at which the driven curvature fits the commanded one
best, scale and offset apart (seed 0, above 4 m/s): 0.39e-3 1/m RMS remain at 0.14 s, 0.69e-3 at
0.10 s, 0.71e-3 at 0.18 s, 1.5e-3 at 0.24 s."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrivePlan:
    """A drive before it begins."""

    vehicle: Vehicle
    road: Road
    line: Line
    speeds_mps: FloatArray
    """Per point of the line."""
    pursuit: PursuitParams
    planner_period_ns: int
    goal_m: float
    """Way to drive along the line; its length for a whole lap."""

    @property
    def is_whole_lap(self) -> bool:
        """Whether the goal is the line's end."""
        return self.goal_m >= self.line.length_m

    @property
    def time_s_max(self) -> float:
        """Longest time a drive may take before it counts as stuck."""
        mean_mps = max(0.5, float(self.speeds_mps.mean()))
        return 30.0 + 3.0 * self.goal_m / mean_mps


def make_plan(
    *, vehicle: Vehicle, road: Road, planner_period_ns: int, distance_m: float | None = None
) -> DrivePlan:
    """Plans a line that this vehicle can steer, and speeds that it can follow.

    Args:
        vehicle: Its steering stop gives the tightest bend, its track the body's width.
        road: Where to.
        planner_period_ns: What the planner will promise.
        distance_m: Part of the lap to drive; None for all of it.

    Raises:
        RoadError: The road holds no such line.
        UserMistake: The distance is not on the lap; names the range.
    """
    line = drivable_line(
        road,
        radius_m_min=RADIUS_RESERVE / vehicle.curvature_per_m_max,
        vehicle_width_m=vehicle.geometry.track_m + TYRE_WIDTH_M,
    )
    if distance_m is not None and not DISTANCE_M_MIN <= distance_m <= line.length_m:
        raise UserMistake(
            f"--distance-m {distance_m:g}: allowed {DISTANCE_M_MIN:g} to {line.length_m:.1f} m, "
            f"the length of {road.name}"
        )
    speeds_mps = speed_plan(line, speed_mps_max=min(SPEED_MPS_MAX, vehicle.traction.speed_mps_max))
    if distance_m is not None:
        rest_m = np.maximum(distance_m - line.s_m, 0.0)
        speeds_mps = np.minimum(speeds_mps, np.sqrt(2.0 * STOP_MPS2 * rest_m))
    return DrivePlan(
        vehicle=vehicle,
        road=road,
        line=line,
        speeds_mps=speeds_mps,
        pursuit=PursuitParams(
            steering_lag_s=STEERING_LAG_S, curvature_per_m_max=vehicle.curvature_per_m_max
        ),
        planner_period_ns=planner_period_ns,
        goal_m=line.length_m if distance_m is None else distance_m,
    )
