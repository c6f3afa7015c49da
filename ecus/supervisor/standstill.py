"""Whether the car stands, as far as wheels can tell.

Wheels that stop faster than tyres can stop a car have locked, and the car slides on. It is then
given the time that its last rolling speed takes to end on the worst road of the vehicle file.
"""

from __future__ import annotations

import math
from typing import Final

from ecus.common.driver_input import Debounce

STANDSTILL_MPS_MAX: Final = 0.1
"""Both axles slower than this: the wheels stand."""
STANDSTILL_NS: Final = 300_000_000

GRIP_MARGIN: Final = 1.3
"""Times the deceleration of the full brake on a dry road, which no tyre exceeds."""
LOCK_MPS: Final = 1.0
"""Wheels so much slower than the car can be have locked; above noise and the encoders' lag."""

NS_PER_S: Final = 1_000_000_000


class Standstill:
    """Follows the faster axle; one object, changed by `update` alone.

    Args:
        deceleration_mps2_full: Of the full brake on a dry road.
        deceleration_mps2_min: On the worst road.
    """

    def __init__(self, deceleration_mps2_full: float, deceleration_mps2_min: float) -> None:
        self._rolling_mps2 = GRIP_MARGIN * deceleration_mps2_full
        self._sliding_mps2 = deceleration_mps2_min
        self._standing = Debounce(STANDSTILL_NS)
        self._now_ns = 0
        self._is_locked = False
        self.possible_mps = 0.0
        """The car cannot be faster than this."""

    def update(self, speed_mps: float, now_ns: int) -> bool:
        """Whether the car stands.

        Args:
            speed_mps: Of the faster axle; NaN when not known, and then the car does not stand.
            now_ns: Never goes back.
        """
        dt_s = (now_ns - self._now_ns) / NS_PER_S
        self._now_ns = now_ns
        if not math.isnan(speed_mps):
            loss = (self._sliding_mps2 if self._is_locked else self._rolling_mps2) * dt_s
            self.possible_mps = max(speed_mps, self.possible_mps - loss)
            gap_mps = self.possible_mps - speed_mps
            self._is_locked = gap_mps > 0.0 if self._is_locked else gap_mps > LOCK_MPS
        is_slow = speed_mps <= STANDSTILL_MPS_MAX and self.possible_mps <= STANDSTILL_MPS_MAX
        return self._standing.update(is_slow, now_ns)
