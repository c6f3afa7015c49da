"""What the steering sensor reads straight ahead, from logs of a car that rolled along a line.

The field's way: a driver follows a straight line with his own hands. He may correct on the way;
what counts is that the car points the same way at the end as at the start. The path's curvature,
`tan((angle - zero) / ratio) / wheelbase`, then adds up to no turn over the way, and that gives the
zero. How well he kept the direction is the driver's word, and the better part of the uncertainty.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from telemetry.decode.tables import Decoded, Table, intact
from telemetry.logs.frames import NS_PER_S
from vehicles import Vehicle

FloatArray = NDArray[np.float64]

ANGLE: Final = ("STEER_STATUS", "steering_wheel_angle_rad")
SPEED: Final = ("THROTTLE_STATUS", "wheel_speed_radps")

COVERAGE: Final = 2.0
"""Uncertainties told are twice the standard ones: about 95 % (GUM 6.2.1)."""
ROAD_WHEEL_RAD_MAX: Final = math.radians(0.1)
"""A zero that is known no better is of no use: UAH's loop holds 0.1 deg of road wheel."""
ZERO_SHARE_MAX: Final = 0.1
"""Of the steering's range: further off, it was no straight line, or the sensor sits askew."""
SILENCE_S_MAX: Final = 0.1
"""Ten frames: without them nobody knows where the car went."""


class CalibrationError(ValueError):
    """Data that give no zero; the text says what is wanted."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Roll:
    """One roll along a line, N readings; arrays of shape (N,).

    Attributes:
        angle_rad: Of the steering wheel, as STEER_STATUS told it.
        way_m: Rolled until the next reading, negative backwards.
        fingerprint: Eight digits that tell this roll from every other.
    """

    angle_rad: FloatArray
    way_m: FloatArray
    fingerprint: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Zero:
    """A steering zero, radians of the steering wheel.

    Attributes:
        zero_rad: What the sensor reads straight ahead.
        uncertainty_rad: Of it, with a coverage of 95 %.
        way_m: Rolled for it.
    """

    zero_rad: float
    uncertainty_rad: float
    way_m: float


def roll_of(decoded: Decoded, vehicle: Vehicle) -> Roll:
    """The roll that a log's frames tell; those with a wrong CRC are left out.

    Raises:
        CalibrationError: Frames are missing, or tell no value.
    """
    steer_ns, angle_rad = _readings(decoded, *ANGLE)
    speed_ns, wheel_radps = _readings(decoded, *SPEED)
    newest = np.searchsorted(speed_ns, steer_ns, side="right") - 1
    # a car that has just been switched on knows no speed yet
    is_known = newest >= int(np.argmax(~np.isnan(wheel_radps)))
    steer_ns, angle_rad, newest = steer_ns[is_known], angle_rad[is_known], newest[is_known]
    if len(steer_ns) < 2:
        raise CalibrationError("less than two readings of steering and speed beside each other")
    span_s = np.diff(steer_ns, append=steer_ns[-1]) / NS_PER_S
    speed_mps = wheel_radps[newest] * vehicle.geometry.wheel_radius_m
    way_m = np.where(span_s > 0.0, speed_mps * span_s, 0.0)
    is_rolling = way_m != 0.0  # NaN included
    age_s = (steer_ns - speed_ns[newest]) / NS_PER_S
    for name, silence_s in ((ANGLE[0], span_s), (SPEED[0], age_s)):
        longest_s = float(np.max(silence_s, where=is_rolling, initial=0.0))
        if longest_s > SILENCE_S_MAX:
            raise CalibrationError(f"no {name} for {longest_s:.2f} s while the car rolled")
    if np.isnan(angle_rad[is_rolling]).any() or np.isnan(way_m).any():
        raise CalibrationError("the angle or the speed was not available while the car rolled")
    angle_rad, way_m = angle_rad[is_rolling], way_m[is_rolling]
    digest = hashlib.sha256(angle_rad.tobytes() + way_m.tobytes()).hexdigest()
    return Roll(angle_rad=angle_rad, way_m=way_m, fingerprint=digest[:8])


def _readings(
    decoded: Decoded, message: str, signal: str
) -> tuple[NDArray[np.int64], FloatArray]:
    """Times and values of one signal, in order of time."""
    table: Table | None = decoded.tables.get(message)
    if table is None or not len(table.rows):
        raise CalibrationError(f"no frame of {message}: is it the vehicle bus?")
    kept = intact(table)
    order = np.argsort(kept.frames.time_ns, kind="stable")
    return kept.frames.time_ns[order], kept.values[signal].astype(np.float64)[order]


def zero_of(roll: Roll, vehicle: Vehicle, heading_rad: float) -> Zero:
    """The zero at which the roll's path does not turn.

    Args:
        roll: Whose angles are those that the nodes had with this vehicle file.
        vehicle: Wheelbase, steering ratio, and the zero in force.
        heading_rad: Standard uncertainty of the direction at the end against that at the start.

    Raises:
        CalibrationError: The car did not roll.
    """
    ratio, wheelbase_m = vehicle.steering.ratio, vehicle.geometry.wheelbase_m
    way_m = float(np.sum(roll.way_m))
    if abs(way_m) < wheelbase_m:
        raise CalibrationError(
            f"the car did not roll: {abs(way_m):.2f} m from start to end, at least its wheelbase of"
            f" {wheelbase_m:g} m is wanted"
        )
    offset_rad = float(np.sum(roll.angle_rad * roll.way_m)) / way_m
    for _ in range(3):  # Newton's steps: the tangent is nearly its argument
        tangent = np.tan((roll.angle_rad - offset_rad) / ratio)
        slope = float(np.sum((1.0 + tangent**2) * roll.way_m)) / ratio
        offset_rad += float(np.sum(tangent * roll.way_m)) / slope
    of_heading_rad = ratio * wheelbase_m * heading_rad / abs(way_m)
    noise_rad = float(np.std(np.diff(roll.angle_rad))) / math.sqrt(2.0 * len(roll.angle_rad))
    return Zero(
        zero_rad=vehicle.steering.zero_rad + offset_rad,
        uncertainty_rad=COVERAGE * math.hypot(of_heading_rad, noise_rad),
        way_m=abs(way_m),
    )


def combined(zeros: Sequence[Zero]) -> Zero:
    """Several rolls' zero, each with the weight of its certainty: there and back, the road's
    crossfall cancels.

    Raises:
        CalibrationError: They contradict each other.
    """
    weights = [1.0 / zero.uncertainty_rad**2 for zero in zeros]
    mean_rad = sum(w * z.zero_rad for w, z in zip(weights, zeros, strict=True)) / sum(weights)
    for zero in zeros:
        if abs(zero.zero_rad - mean_rad) > COVERAGE * zero.uncertainty_rad:
            raise CalibrationError(
                f"the rolls contradict each other: {zero.zero_rad:.4f} rad against"
                f" {mean_rad:.4f} rad together, {zero.uncertainty_rad:.4f} rad uncertain"
            )
    return Zero(
        zero_rad=mean_rad,
        uncertainty_rad=1.0 / math.sqrt(sum(weights)),
        way_m=sum(zero.way_m for zero in zeros),
    )


def check_usable(zero: Zero, vehicle: Vehicle) -> None:
    """Refuses a zero that is not known well enough, or that cannot be one.

    Raises:
        CalibrationError: Saying which, and how far to roll.
    """
    limit_rad = ROAD_WHEEL_RAD_MAX * vehicle.steering.ratio
    if zero.uncertainty_rad > limit_rad:
        way_m = zero.way_m * (zero.uncertainty_rad / limit_rad)
        raise CalibrationError(
            f"known to {zero.uncertainty_rad:.4f} rad after {zero.way_m:.1f} m, wanted"
            f" {limit_rad:.4f} rad (0.1 deg of road wheel): roll {math.ceil(way_m)} m, or keep the"
            " direction better and say so"
        )
    limit_rad = ZERO_SHARE_MAX * vehicle.steering.wheel_angle_rad_max
    if abs(zero.zero_rad) > limit_rad:
        raise CalibrationError(
            f"{zero.zero_rad:.4f} rad is no zero: allowed {-limit_rad:.4f} to {limit_rad:.4f} rad;"
            " the car did not go straight, or the sensor sits askew"
        )
