"""A step response in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MOVED_SHARE = 0.02
"""Of the step: what counts as the end of the dead time."""
RISE_SHARE = 0.90
"""UAH 5.1: "when it reaches 90% of its Steady-State Response"."""
STEADY_SHARE = 0.25
"""The last part of a response, which is its steady state."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepFigures:
    """What UAH 5.1 tells of a step; times count from the step of the setpoint."""

    dead_time_s: float
    """Until the response has moved by 2 % of the step."""
    rise_s: float
    """Until it first reaches 90 % of its steady state."""
    settling_s: float
    """Until it stays in the band around its steady state; the response's length if it never does,
    which a reader sees, since the steady state is the last quarter."""
    overshoot_percent: float
    """Of its highest point over its steady state."""
    steady_error: float
    """Largest distance from the setpoint in the steady state, in the response's unit."""


def step_figures(
    time_s: FloatArray, value: FloatArray, setpoint: float, band_share: float
) -> StepFigures:
    """Figures of a response that begins at rest at zero.

    Args:
        time_s: Since the step of the setpoint, rising, shape (N,).
        value: Response, shape (N,).
        setpoint: After the step; not zero.
        band_share: Half the width of the settling band over the steady state.

    Raises:
        ValueError: The response never comes to 90 % of its own steady state, or to any.
    """
    tail = value[time_s >= time_s[0] + (1.0 - STEADY_SHARE) * (time_s[-1] - time_s[0])]
    steady = float(tail.mean())
    if steady * setpoint <= 0.0:
        raise ValueError(f"no step response: it ends at {steady:g}, the setpoint is {setpoint:g}")
    share = value / steady
    outside = np.flatnonzero(np.abs(share - 1.0) > band_share)
    return StepFigures(
        dead_time_s=first_crossing_s(time_s, value / setpoint, MOVED_SHARE),
        rise_s=first_crossing_s(time_s, share, RISE_SHARE),
        settling_s=_back_in_band_s(time_s, share, int(outside[-1]), band_share),
        overshoot_percent=100.0 * max(0.0, float(share.max()) - 1.0),
        steady_error=float(np.abs(tail - setpoint).max()),
    )


def first_crossing_s(time_s: FloatArray, share: FloatArray, level: float) -> float:
    """When a response first reaches a level, between its samples in proportion.

    Raises:
        ValueError: Never.
    """
    reached = np.flatnonzero(share >= level)
    if reached.size == 0:
        raise ValueError(f"the response never reaches {level:g}")
    index = int(reached[0])
    if index == 0:
        return float(time_s[0])
    return _between(time_s, share, index - 1, level)


def _back_in_band_s(time_s: FloatArray, share: FloatArray, last: int, band: float) -> float:
    """When the response comes back into the band after its last sample outside."""
    if last + 1 >= time_s.size:
        return float(time_s[-1])
    return _between(time_s, share, last, 1.0 - band if share[last] < 1.0 else 1.0 + band)


def _between(time_s: FloatArray, share: FloatArray, before: int, level: float) -> float:
    low, high = float(share[before]), float(share[before + 1])
    part = (level - low) / (high - low)
    return float(time_s[before] + part * (time_s[before + 1] - time_s[before]))
