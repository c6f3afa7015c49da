"""Limiting of setpoints: pure functions."""

from __future__ import annotations


def clamp(value: float, low: float, high: float) -> float:
    """`value` within [low, high]; NaN gives `low`."""
    if value > low:
        return value if value < high else high
    return low


def towards(value: float, target: float, step_max: float) -> float:
    """`value` moved towards `target` by at most `step_max`."""
    return clamp(target, value - step_max, value + step_max)
