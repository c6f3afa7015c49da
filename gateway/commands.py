"""What a planner may ask for: checked before anything is sent."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import Final

from canbus.node import PERIOD_NS
from dbc.endpoint import SPEC_OF_NAME
from dbc.timing import decision_age_limit_ms, planner_period_ms_max
from vehicles.vehicle import Vehicle

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000

PLANNER_PERIOD_NS_MIN: Final = PERIOD_NS
"""No node acts on decisions that come faster than its own cycle."""

COMMAND_PERIOD_NS: Final = SPEC_OF_NAME["STEER_COMMAND"].cycle_ns
assert COMMAND_PERIOD_NS == 2 * PERIOD_NS


class CommandError(ValueError):
    """A value out of its range; the text names field, value and allowed range with unit."""


def decision_age_ns_max(planner_period_ns: int) -> int:
    """Age at which a planner that promised this period counts as silent (design, time budget)."""
    return decision_age_limit_ms(planner_period_ns / NS_PER_MS) * NS_PER_MS


def planner_period_ns_max(vehicle: Vehicle) -> int:
    """Longest period, in whole ms, whose decision-age limit the vehicle's time-out allows."""
    return int(planner_period_ms_max(vehicle.times.command_timeout_s)) * NS_PER_MS


def checked_period_ns(vehicle: Vehicle, planner_period_s: object) -> int:
    """A planner's period in ns, checked against the vehicle.

    Raises:
        TypeError: Not a number.
        CommandError: Below 10 ms, or so long that the decision-age limit would exceed the
            vehicle's command time-out; names the largest period allowed.
    """
    low_s = PLANNER_PERIOD_NS_MIN / NS_PER_S
    high_s = planner_period_ns_max(vehicle) / NS_PER_S
    if high_s < low_s:
        raise CommandError(
            f"vehicle {vehicle.name}: times.command_timeout_s = {vehicle.times.command_timeout_s:g}"
            f" leaves no room for a planner: wanted at least"
            f" {decision_age_ns_max(PLANNER_PERIOD_NS_MIN) / NS_PER_S:g} s"
        )
    period_s = checked("planner_period_s", planner_period_s, low_s, high_s, "s")
    return round(period_s * NS_PER_S)


def promised_period_ms(period_ns: int) -> int:
    """The period as MODE_REQUEST carries it: whole ms, rounded up, so that it can be kept."""
    return -(-period_ns // NS_PER_MS)


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Decision:
    """One decision of the planner. Made by `decide`, which checks it."""

    speed_mps: Final[float]
    """Negative backwards."""
    curvature_per_m: Final[float]
    """Of the path; positive has the steering wheel to the left, whichever way the car goes."""

    def __init__(self, *, speed_mps: float, curvature_per_m: float) -> None:
        self.speed_mps = speed_mps
        self.curvature_per_m = curvature_per_m


def decide(vehicle: Vehicle, *, speed_mps: object, curvature_per_m: object) -> Decision:
    """A decision this vehicle can execute.

    Raises:
        TypeError: A value that is no number (bool counts as none).
        CommandError: NaN, infinite or out of range. Speed: `traction.speed_mps_max` forwards,
            `traction.reverse_speed_mps_max` backwards, negative; curvature: plus or minus what the
            steering reaches.
    """
    curvature_per_m_max = vehicle.curvature_per_m_max
    return Decision(
        speed_mps=checked_speed_mps(vehicle, speed_mps),
        curvature_per_m=checked(
            "curvature_per_m", curvature_per_m, -curvature_per_m_max, curvature_per_m_max, "1/m"
        ),
    )


def checked_speed_mps(vehicle: Vehicle, speed_mps: object) -> float:
    """A speed within the vehicle's limits, negative backwards; raises as `checked`."""
    traction = vehicle.traction
    low_mps = 0.0 - traction.reverse_speed_mps_max  # never minus zero
    return checked("speed_mps", speed_mps, low_mps, traction.speed_mps_max, "m/s")


def checked(field: str, value: object, low: float, high: float, unit: str) -> float:
    """The value as a float within [low, high].

    Raises:
        TypeError: Not a real number; bool counts as none.
        CommandError: NaN, infinite or out of range.
    """
    allowed = f"allowed {low:.6g} to {high:.6g} {unit}"
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{field} = {value!r}: a number is wanted, {allowed}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not low <= number <= high:  # NaN fails as well
        raise CommandError(f"{field} = {number!r}: {allowed}")
    return number
