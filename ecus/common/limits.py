"""Limiting of setpoints and readings: pure functions."""

from __future__ import annotations

from math import nan
from typing import Final

RATIO_MARGIN: Final = 0.04
"""A reading further outside of 0 to 1 than this is a broken wire, not noise."""


def clamp(value: float, low: float, high: float) -> float:
    """`value` within [low, high]; NaN gives `low`."""
    if value > low:
        return value if value < high else high
    return low


def towards(value: float, target: float, step_max: float) -> float:
    """`value` moved towards `target` by at most `step_max`."""
    return clamp(target, value - step_max, value + step_max)


def readable_ratio(reading: float) -> float:
    """A sensor's reading of 0 to 1; NaN, as from a broken one, if it is out of bounds."""
    return reading if -RATIO_MARGIN <= reading <= 1.0 + RATIO_MARGIN else nan
