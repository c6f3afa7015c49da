"""The satellite receiver a planner hears: RTK fixes, noisy and late."""

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

PERIOD_NS: Final = 100_000_000  # 10 Hz: the rate of UAH's corrections (section 3.4)
LATENCY_NS: Final = 100_000_000  # age at arrival: receiver, serial line and UAH's 100 ms sampling
SIGMA_M: Final = 0.02  # per axis: RTK near its own base


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class GnssFix:
    """One position, valid at `taken_ns`, usable from `taken_ns` plus the latency on.

    Attributes:
        taken_ns: When the vehicle was there.
        x_m: Rear-axle centre; the antenna is taken to stand above it.
        y_m: As x_m.
    """

    taken_ns: Final[int]
    x_m: Final[float]
    y_m: Final[float]

    def __init__(self, *, taken_ns: int, x_m: float, y_m: float) -> None:
        self.taken_ns = taken_ns
        self.x_m = x_m
        self.y_m = y_m


class GnssReceiver:
    """Sensor model: samples the true position every 100 ms and delivers it 100 ms later.

    UAH has a single antenna: a fix carries no heading. Noise is white and Gaussian per axis.
    """

    def __init__(
        self,
        generator: np.random.Generator,
        sigma_m: float = SIGMA_M,
        period_ns: int = PERIOD_NS,
        latency_ns: int = LATENCY_NS,
    ) -> None:
        """Take the seeded generator; its draws are this receiver's alone, two per fix."""
        assert sigma_m >= 0.0 and period_ns > 0 and latency_ns >= 0
        self._generator = generator
        self._sigma_m = sigma_m
        self._period_ns = period_ns
        self._latency_ns = latency_ns
        self._next_sample_ns: int | None = None
        self._under_way: deque[GnssFix] = deque()

    def step(self, now_ns: int, x_m: float, y_m: float) -> tuple[GnssFix, ...]:
        """Take a sample if one is due, and return the fixes that arrive now, oldest first.

        Args:
            now_ns: True time; call at least every 100 ms, sampling starts with the first call.
            x_m: True position of the rear-axle centre.
            y_m: As x_m.
        """
        if self._next_sample_ns is None:
            self._next_sample_ns = now_ns
        if now_ns >= self._next_sample_ns:
            noise_x_m, noise_y_m = (self._sigma_m * self._generator.standard_normal(2)).tolist()
            self._under_way.append(
                GnssFix(taken_ns=now_ns, x_m=x_m + noise_x_m, y_m=y_m + noise_y_m)
            )
            self._next_sample_ns += self._period_ns
        arrived: list[GnssFix] = []
        while self._under_way and self._under_way[0].taken_ns + self._latency_ns <= now_ns:
            arrived.append(self._under_way.popleft())
        return tuple(arrived)
