"""From the steering's shaft to the road wheels: transmission, play, dead zone (UNICAMP 4.1)."""

from __future__ import annotations

from math import copysign

from simulation.plant.params import LinkageParams


class Linkage:
    """A worn linkage; it remembers from which side it was last moved."""

    __slots__ = ("_params", "_played_rad")

    def __init__(self, params: LinkageParams) -> None:
        self._params = params
        self._played_rad = 0.0

    def follow(self, driven_rad: float) -> float:
        """The road wheels' angle (of the imagined middle one) for what a tight linkage gives."""
        params = self._params
        low_rad, high_rad = driven_rad - params.play_rad, driven_rad + params.play_rad
        self._played_rad = played_rad = min(max(self._played_rad, low_rad), high_rad)
        beyond_rad = max(0.0, abs(played_rad) - params.dead_zone_rad)
        return copysign(params.transmission_ratio * beyond_rad, played_rad)
