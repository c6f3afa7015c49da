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


SLOPE_RAD_MIN: Final = 0.025
"""A road as steep as this is a hill (1.4 deg): above an inclinometer's zero and noise."""
SLOPE_FILTER_S: Final = 0.1
SLOPE_NS: Final = 300_000_000
"""So long the car must have stood: before, what is felt is its stopping."""

HOLD_NS: Final = 450_000_000
"""A released brake stays on for so long on a hill: the drive needs half of it to notice, and the
rest to build the first quarter of its torque."""
EASE_NS: Final = 500_000_000
"""Then it is let go over this time, slower than the drive's torque comes."""


class HillHold:
    """Lets the brake go late and slowly where a standing car would roll.

    The drive builds its torque against the brake meanwhile (`ecus/throttle/hill_start.py`): what
    brake and drive hold together is never less than what the brake held alone.
    """

    __slots__ = ("_held_ratio", "_since_ns", "_slope_rad", "_standing_since_ns")

    def __init__(self) -> None:
        self._slope_rad = 0.0
        self._standing_since_ns: int | None = None
        self._held_ratio = 0.0
        self._since_ns: int | None = None

    def sense(self, now_ns: int, dt_s: float, speed_mps: float, slope_rad: float) -> None:
        """Takes the inclinometer's reading in while the car stands; NaN stays: it may be steep."""
        if abs(speed_mps) > STANDSTILL_MPS_MAX:
            self._standing_since_ns = None
            self._slope_rad = slope_rad
        elif self._standing_since_ns is None:
            self._standing_since_ns = now_ns
            self._slope_rad = slope_rad
        else:
            share = dt_s / (dt_s + SLOPE_FILTER_S)
            self._slope_rad += share * (slope_rad - self._slope_rad)

    def update(self, now_ns: int, wanted_ratio: float, applied_ratio: float) -> float:
        """Where the servo is to go when the command wants it at `wanted_ratio`."""
        if self._since_ns is None:
            if wanted_ratio >= applied_ratio or not self._is_on_a_hill(now_ns):
                return wanted_ratio
            self._since_ns, self._held_ratio = now_ns, applied_ratio
        eased_ns = now_ns - self._since_ns - HOLD_NS
        if wanted_ratio >= self._held_ratio or eased_ns >= EASE_NS:
            self._since_ns = None
            return wanted_ratio
        share = 1.0 - max(eased_ns, 0) / EASE_NS
        return max(wanted_ratio, share * self._held_ratio)

    def forget(self) -> None:
        """Nothing is being held: the command does not decide."""
        self._since_ns = None

    def _is_on_a_hill(self, now_ns: int) -> bool:
        since_ns = self._standing_since_ns
        is_standing = since_ns is not None and now_ns - since_ns >= SLOPE_NS
        return is_standing and not abs(self._slope_rad) < SLOPE_RAD_MIN


def approach(position_ratio: float, wanted_ratio: float, rate_per_s: float, dt_s: float) -> float:
    """The setpoint moved towards what is wanted at the servo's rate; NaN wants nothing."""
    return towards(position_ratio, clamp(wanted_ratio, 0.0, 1.0), rate_per_s * dt_s)
