"""Sensors: noise, quantisation, and encoders with the exact time of each edge."""

from math import floor, sqrt
from typing import Final

from numpy.random import Generator

from simulation.plant.params import NS_PER_S

NOISE_BLOCK: Final = 1024
# (begin_ns, begin_phase, begin_rate, end_rate, begin_count, end_count)
Segment = tuple[int, float, float, float, int, int]


class NoiseSource:
    """Standard normal numbers, drawn in blocks from a generator of its own."""

    __slots__ = ("_block", "_rng")

    def __init__(self, rng: Generator) -> None:
        self._rng = rng
        self._block: list[float] = []

    def draw(self) -> float:
        """The next number, mean 0, standard deviation 1."""
        if not self._block:
            self._block = self._rng.standard_normal(NOISE_BLOCK).tolist()
        return self._block.pop()


def quantise_ratio(ratio: float, steps: int) -> float:
    """A 0..1 quantity as an ADC of so many steps reads it; clipped to its range."""
    if ratio <= 0.0:
        return 0.0
    if ratio >= 1.0:
        return 1.0
    return floor(ratio * steps + 0.5) / steps


class Encoder:
    """Incremental encoder: signed edges and, at any instant, the age of the latest one.

    Within an integration step the wheel's speed changes linearly, so the time of an edge is the
    solution of a quadratic and not a multiple of the step. Only steps that hold an edge are
    kept, and only a reading solves for the time.
    """

    __slots__ = (
        "_age_ns_max",
        "_before_last",
        "_dead",
        "_dt_s",
        "_edges_per_m",
        "_held_count",
        "_held_edge_ns",
        "_last",
        "_lost_count",
        "_phase",
        "_rate",
        "_step_ns",
        "_timer_ns",
    )

    def __init__(
        self, edges_per_m: float, step_ns: int, timer_ns: int, age_ns_max: int, start_ns: int
    ) -> None:
        self._edges_per_m = edges_per_m
        self._step_ns = step_ns
        self._dt_s = step_ns / NS_PER_S
        self._timer_ns = timer_ns
        self._age_ns_max = age_ns_max
        self._phase = 0.5  # a car parks between two edges
        self._rate = 0.0
        still: Segment = (start_ns - age_ns_max, 0.5, 0.0, 0.0, 0, 0)
        self._last = still
        self._before_last = still
        self._dead = False
        self._held_count = 0
        self._held_edge_ns = 0
        self._lost_count = 0

    def step(self, begin_ns: int, wheel_speed_mps: float) -> None:
        """Turns the wheel for one step that begins at this time and ends at this speed."""
        rate = wheel_speed_mps * self._edges_per_m
        phase = self._phase
        new_phase = phase + 0.5 * self._dt_s * (self._rate + rate)
        count = floor(phase)
        new_count = floor(new_phase)
        if count != new_count:
            self._before_last = self._last
            self._last = (begin_ns, phase, self._rate, rate, count, new_count)
        self._phase = new_phase
        self._rate = rate

    def read(self, now_ns: int, dead: bool) -> tuple[int, float]:
        """What the capture timer of an ECU holds at this time.

        Args:
            now_ns: Virtual time, not after the end of the last step.
            dead: No edges arrive: the count stays and the age grows.

        Returns:
            Signed edges since power-on, and seconds since the latest one (saturating).
        """
        count, edge_ns = self._latest_edge(now_ns)
        if dead:
            if not self._dead:
                self._held_count = count - self._lost_count
                self._held_edge_ns = edge_ns
                self._dead = True
            count = self._held_count
            edge_ns = self._held_edge_ns
        else:
            if self._dead:
                self._lost_count = count - self._held_count
                self._dead = False
            count -= self._lost_count
        age_ns = min(now_ns - edge_ns, self._age_ns_max)
        return count, age_ns // self._timer_ns * self._timer_ns / NS_PER_S

    def _latest_edge(self, now_ns: int) -> tuple[int, int]:
        last = self._last
        begin_ns, phase, begin_rate, end_rate, begin_count, count = last
        elapsed_ns = now_ns - begin_ns
        if elapsed_ns < self._step_ns:
            elapsed_s = elapsed_ns / NS_PER_S
            slope = 0.5 * (end_rate - begin_rate) / self._dt_s
            count = floor(phase + (begin_rate + slope * elapsed_s) * elapsed_s)
            if count == begin_count:  # this step's first edge is still to come
                last = self._before_last
                count = last[5]
        return count, min(now_ns, self._edge_ns(last, count))

    def _edge_ns(self, segment: Segment, count: int) -> int:
        """When the count came to this value within a step."""
        begin_ns, phase, begin_rate, end_rate, begin_count, _ = segment
        acceleration = (end_rate - begin_rate) / self._dt_s
        if count > begin_count:
            way = count - phase
        elif count < begin_count:  # backwards: mirror it
            way = phase - (count + 1)
            begin_rate = -begin_rate
            acceleration = -acceleration
        else:
            return begin_ns
        root = sqrt(max(0.0, begin_rate * begin_rate + 2.0 * acceleration * way))
        pace = begin_rate + root
        after_s = 2.0 * way / pace if pace > 0.0 else 0.0
        return begin_ns + min(self._step_ns, round(after_s * NS_PER_S))
