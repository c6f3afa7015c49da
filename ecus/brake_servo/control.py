"""The servo's on-time (ER3) and the position it is sent to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ecus.common.limits import clamp, towards

ROLLING_MPS_MIN: Final = 0.2
"""A car that rolls faster than this is braked again, ER3 or not (design, ER3)."""

STANDSTILL_MPS_MAX: Final = 0.05
STANDSTILL_NS: Final = 500_000_000
"""The car stands when it has been slower than that for this long."""

NS_PER_S: Final = 1_000_000_000


@dataclass(slots=True, init=False, unsafe_hash=True)
class RestInputs:
    """What decides over resting: servo load, speed, and whether traction is known to be cut."""

    is_loaded: Final[bool]
    speed_mps: Final[float]
    is_traction_inhibited: Final[bool]

    def __init__(self, is_loaded: bool, speed_mps: float, is_traction_inhibited: bool) -> None:
        self.is_loaded = is_loaded
        self.speed_mps = speed_mps
        self.is_traction_inhibited = is_traction_inhibited


class ServoRest:
    """ER3: how long the servo has been on, and whether it may rest.

    Resting begins only at standstill with traction inhibited, and ends when the car rolls or the
    servo is no longer wanted. A rest as long as the on-time counts as cooled down.
    """

    __slots__ = ("_on_ns", "_standing_since_ns", "is_resting")

    def __init__(self) -> None:
        self._on_ns = 0
        self._standing_since_ns: int | None = None
        self.is_resting = False

    def update(self, now_ns: int, dt_ns: int, inputs: RestInputs, on_time_s_max: float) -> bool:
        """True when the on-time is exceeded (ER3 is present)."""
        if abs(inputs.speed_mps) > STANDSTILL_MPS_MAX:
            self._standing_since_ns = None
        elif self._standing_since_ns is None:
            self._standing_since_ns = now_ns
        limit_ns = round(on_time_s_max * NS_PER_S)
        heating = inputs.is_loaded and not self.is_resting
        self._on_ns = self._on_ns + dt_ns if heating else max(self._on_ns - dt_ns, 0)
        if self.is_resting:
            rolls = abs(inputs.speed_mps) > ROLLING_MPS_MIN
            if rolls or not inputs.is_traction_inhibited or not inputs.is_loaded:
                self.is_resting = False
            return True
        is_exceeded = self._on_ns > limit_ns
        is_standing = (
            self._standing_since_ns is not None
            and now_ns - self._standing_since_ns >= STANDSTILL_NS
        )
        self.is_resting = is_exceeded and is_standing and inputs.is_traction_inhibited
        return is_exceeded


def approach(position_ratio: float, wanted_ratio: float, rate_per_s: float, dt_s: float) -> float:
    """The setpoint moved towards what is wanted at the servo's rate; NaN wants nothing."""
    return towards(position_ratio, clamp(wanted_ratio, 0.0, 1.0), rate_per_s * dt_s)
