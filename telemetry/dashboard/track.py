"""Where the car has gone, by dead reckoning from what it says of speed and curvature."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

NS_PER_S: Final = 1_000_000_000
POINTS_MAX: Final = 4_000
"""Kept of the driven path, POINT_M apart: 2 km."""
POINT_M: Final = 0.5
GAP_NS_MAX: Final = 500_000_000
"""Across a longer time without readings the way driven is not guessed."""


class Track:
    """Integrates speed and curvature; begins at 0, 0, heading along x.

    The errors of wheel radius and steering zero add up: it shows a drive, it is no position.

    Attributes:
        x_m, y_m, heading_rad: Where the car is, y to the left.
        driven_m: Way so far.
        points: Of the driven path, the oldest first.
    """

    def __init__(self) -> None:
        self.x_m = self.y_m = self.heading_rad = self.driven_m = 0.0
        self.points: deque[tuple[float, float]] = deque([(0.0, 0.0)], maxlen=POINTS_MAX)
        self._before: tuple[int, float, float] | None = None

    def take(self, time_ns: int, speed_mps: float, curvature_per_m: float) -> bool:
        """The next reading; NaN for one that is not there. Answers whether a point was added."""
        before = self._before
        if math.isnan(speed_mps + curvature_per_m):
            return False
        self._before = time_ns, speed_mps, curvature_per_m
        if before is None or not 0 < time_ns - before[0] <= GAP_NS_MAX:
            return False
        way_m = 0.5 * (speed_mps + before[1]) * (time_ns - before[0]) / NS_PER_S
        turn_rad = 0.5 * (curvature_per_m + before[2]) * way_m
        middle_rad = self.heading_rad + 0.5 * turn_rad
        self.x_m += way_m * math.cos(middle_rad)
        self.y_m += way_m * math.sin(middle_rad)
        self.heading_rad = math.remainder(self.heading_rad + turn_rad, math.tau)
        self.driven_m += abs(way_m)
        last_x_m, last_y_m = self.points[-1]
        if math.hypot(self.x_m - last_x_m, self.y_m - last_y_m) < POINT_M:
            return False
        self.points.append((self.x_m, self.y_m))
        return True
