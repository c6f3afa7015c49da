"""Speed from an incremental encoder by edge timing.

Counting 64 pulses a turn over 10 ms would give steps of 0.1 m/s; the time between edges gives the
speed to the timer's microsecond (the method of periods and pulses, often called M/T).
"""

from __future__ import annotations

import math
from typing import Final

STANDSTILL_S: Final = 0.25
"""Without an edge for this long the wheel stands (TABBY: below 0.02 m/s on the motor's encoder)."""

WINDOW_NS: Final = 20_000_000
"""Edges are compared over at least this span, which averages the encoder's pitch error."""


READING_AGE_S_MAX: Final = 0.02
"""A reading that comes over a bus may be two cycles old: edges since then are not known yet, and
their absence says nothing about the speed."""


class EncoderSpeed:
    """Turns counts and edge ages into rad/s of the encoder's shaft."""

    __slots__ = ("_count", "_edge_ns", "_rad_per_edge", "speed_radps")

    def __init__(self, pulses_per_rev: float) -> None:
        self._rad_per_edge = 2.0 * math.pi / pulses_per_rev
        self._count: int | None = None
        self._edge_ns = 0
        self.speed_radps = 0.0

    def update(self, now_ns: int, count: int, edge_age_s: float) -> float:
        """Speed after this reading, rad/s, signed; slower than one edge a period it fades to 0."""
        edge_ns = now_ns - round(edge_age_s * 1e9)
        if self._count is None:
            self._count, self._edge_ns = count, edge_ns
            return self.speed_radps
        edges = count - self._count
        span_ns = edge_ns - self._edge_ns
        if span_ns >= WINDOW_NS:  # no net edge in it: trembling on the spot
            self.speed_radps = edges * self._rad_per_edge * 1e9 / span_ns
            self._count, self._edge_ns = count, edge_ns
        elif edge_age_s >= STANDSTILL_S:
            self.speed_radps = 0.0
            self._count, self._edge_ns = count, edge_ns
        elif edge_age_s > READING_AGE_S_MAX:
            # With no edge for this long, the shaft cannot be faster than one edge in that time.
            bound = self._rad_per_edge / (edge_age_s - READING_AGE_S_MAX)
            self.speed_radps = max(-bound, min(bound, self.speed_radps))
        return self.speed_radps
