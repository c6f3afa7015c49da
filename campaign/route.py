"""A road without end, drawn as the car goes: bends and speeds by chance, and how far off it is.

The road is a curve whose curvature changes at a bounded rate, so that speed, lateral acceleration
and jerk stay within what the vehicle allows. It begins wherever the car stands when it engages.
Offsets are those of the Frenet frame that moves along with the car (Samson 1992).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin, sqrt
from typing import Final, Self

from numpy.random import Generator

from vehicles import Vehicle

LATERAL_MPS2_MAX = 1.6
"""Below the reference planner's 2.0, so that what a fault adds is seen and not the road."""
LATERAL_JERK_MPS3 = 1.2
PATTERN_WHEELBASE_M = 2.36
"""Of the car that the next numbers are for: TABBY EVO's. A shorter one gets as much tighter bends,
so that both turn their wheels alike."""
CURVATURE_PER_M_MAX = 0.07
CURVATURE_RATE_PER_MS = 0.03
"""Largest change of curvature, 1/m/s: what the steering can do with room to spare."""
CURVATURE_SHARE_MAX = 0.8
SPEED_SHARE_MAX = 0.9
"""Of what the car can do: the rest is for finding back to the road."""
SPEED_MPS = (1.0, 6.5)
STANDS_SHARE = 0.1
"""Of all pieces: the road has a stop."""
PIECE_S = (1.5, 5.0)
SPEED_FLOOR_MPS = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadLimits:
    """What a road asks of a car.

    Attributes:
        scale: Of the car against the pattern, by wheelbase.
        speed_mps: Slowest and fastest, stops apart.
        curvature_per_m_max: Of the tightest bend.
        curvature_rate_per_ms: Largest change of curvature, 1/m/s.
    """

    scale: float
    speed_mps: tuple[float, float]
    curvature_per_m_max: float
    curvature_rate_per_ms: float

    @classmethod
    def of(cls, vehicle: Vehicle) -> Self:
        """What suits a vehicle."""
        scale = vehicle.geometry.wheelbase_m / PATTERN_WHEELBASE_M
        fastest_mps = min(SPEED_MPS[1], SPEED_SHARE_MAX * vehicle.traction.speed_mps_max)
        return cls(
            scale=scale,
            speed_mps=(min(SPEED_MPS[0], 0.5 * fastest_mps), fastest_mps),
            curvature_per_m_max=min(
                CURVATURE_PER_M_MAX / scale, CURVATURE_SHARE_MAX * vehicle.curvature_per_m_max
            ),
            curvature_rate_per_ms=CURVATURE_RATE_PER_MS / scale,
        )


class Route:
    """What is to be driven, and where the car is beside it.

    Args:
        rng: Chance of the route.
        limits: Of the road.

    Attributes:
        speed_mps: Wanted now.
        curvature_per_m: Of the road beside the car.
        curvature_rate_per_ms: How it changes now.
        offset_m: Of the car, positive left.
        heading_error_rad: Of the car, positive left.
    """

    __slots__ = ("_heading_rad", "_left_s", "_limits", "_rng", "_target_per_m",
                 "_x_m", "_y_m", "curvature_per_m", "curvature_rate_per_ms", "heading_error_rad",
                 "offset_m", "speed_mps")

    def __init__(self, rng: Generator, limits: RoadLimits) -> None:
        self._rng: Final = rng
        self._limits: Final = limits
        self._x_m = self._y_m = self._heading_rad = 0.0
        self._left_s = 0.0
        self._target_per_m = 0.0
        self.speed_mps = 0.0
        self.curvature_per_m = 0.0
        self.curvature_rate_per_ms = 0.0
        self.offset_m = 0.0
        self.heading_error_rad = 0.0

    def begin(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """The road begins here, straight on."""
        self._x_m, self._y_m, self._heading_rad = x_m, y_m, heading_rad
        self._left_s = 0.0
        self.curvature_per_m = 0.0
        self.offset_m = self.heading_error_rad = 0.0

    def offset_of(self, x_m: float, y_m: float) -> float:
        """How far a place is off the road beside the car, positive left."""
        dx_m, dy_m = x_m - self._x_m, y_m - self._y_m
        return dy_m * cos(self._heading_rad) - dx_m * sin(self._heading_rad)

    def go_on(self, x_m: float, y_m: float, heading_rad: float, speed_mps: float,
              span_s: float) -> None:
        """The car has come here in this time; the road beside it goes on as far."""
        self._choose(span_s)
        fast_mps = max(speed_mps, self.speed_mps, SPEED_FLOOR_MPS)
        rate_per_ms = self._limits.curvature_rate_per_ms
        limit = min(rate_per_ms, LATERAL_JERK_MPS3 / fast_mps**2) * span_s
        change = min(max(self._target_per_m - self.curvature_per_m, -limit), limit)
        if speed_mps < min(SPEED_FLOOR_MPS, self._limits.speed_mps[0]):
            change = 0.0  # a road does not bend under a standing car
        self.curvature_rate_per_ms = change / span_s
        ahead_m = ((x_m - self._x_m) * cos(self._heading_rad)
                   + (y_m - self._y_m) * sin(self._heading_rad))
        turn_rad = ahead_m * (self.curvature_per_m + 0.5 * change)
        middle_rad = self._heading_rad + 0.5 * turn_rad
        self._x_m += ahead_m * cos(middle_rad)
        self._y_m += ahead_m * sin(middle_rad)
        self._heading_rad += turn_rad
        self.curvature_per_m += change
        self.offset_m = self.offset_of(x_m, y_m)
        self.heading_error_rad = heading_rad - self._heading_rad

    def _choose(self, span_s: float) -> None:
        """A piece is over: another bend, another speed."""
        self._left_s -= span_s
        if self._left_s > 0.0:
            return
        rng, limits = self._rng, self._limits
        self._left_s = float(rng.uniform(*PIECE_S))
        wanted_mps = float(rng.uniform(*limits.speed_mps))
        tight_per_m = max(abs(self.curvature_per_m), 1e-3)
        self.speed_mps = min(wanted_mps, sqrt(LATERAL_MPS2_MAX / tight_per_m))
        slow_mps = max(self.speed_mps, 2.0)
        bend_per_m = min(LATERAL_MPS2_MAX / slow_mps**2, limits.curvature_per_m_max)
        self._target_per_m = float(rng.uniform(-bend_per_m, bend_per_m))
        if rng.random() < STANDS_SHARE:
            self.speed_mps = 0.0
