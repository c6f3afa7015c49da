"""Reference motion: the trapezoid of profile position, the ramp of profile velocity. Pure numbers.

Units are encoder units and seconds; the objects' rpm and rpm/s become these at the edge.
"""

from __future__ import annotations

import math


class Reference:
    """Demanded position and velocity; a change of either never outruns the limits it is given."""

    __slots__ = ("acceleration", "position", "velocity")

    def __init__(self, position: float = 0.0) -> None:
        self.position = position
        self.velocity = 0.0
        self.acceleration = 0.0

    def start(self, position: float, velocity: float) -> None:
        """Begins where the motor is."""
        self.position, self.velocity, self.acceleration = position, velocity, 0.0

    def ramp(self, target: float, acceleration: float, deceleration: float, dt_s: float) -> None:
        """Towards a velocity: `deceleration` towards zero, `acceleration` away from it."""
        before = self.velocity
        if before * target < 0.0:
            target = 0.0  # through zero first, at the rate that slows down
        limit = (deceleration if abs(target) < abs(before) else acceleration) * dt_s
        self._move(before + min(max(target - before, -limit), limit), dt_s)

    def approach(
        self,
        target: float,
        velocity_max: float,
        acceleration: float,
        deceleration: float,
        dt_s: float,
    ) -> None:
        """Towards a position, and standing when it is reached."""
        distance = target - self.position
        step = deceleration * dt_s * dt_s
        # Fastest velocity from which the target can still be met in whole steps.
        stopping = deceleration * dt_s * (math.sqrt(0.25 + 2.0 * abs(distance) / step) - 0.5)
        wanted = math.copysign(min(velocity_max, stopping, abs(distance) / dt_s), distance)
        before = self.velocity
        is_slowing = abs(wanted) < abs(before) or wanted * before < 0.0
        limit = (deceleration if is_slowing else acceleration) * dt_s
        self._move(before + min(max(wanted - before, -limit), limit), dt_s)

    def _move(self, velocity: float, dt_s: float) -> None:
        self.acceleration = (velocity - self.velocity) / dt_s
        self.velocity = velocity
        self.position += velocity * dt_s
