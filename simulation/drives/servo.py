"""A drive's own loops: the current that makes a motor follow a reference.

A position loop over a velocity loop with feed-forward, as an EPOS has them. Its gains come from
motor and inertia, as after its automatic tuning (assumption: the time constants below).
"""

from __future__ import annotations

from typing import Final

from simulation.drives.motor import COUNTS_PER_REV, MotorParams
from simulation.drives.profile import Reference

TAU: Final = 6.283185307179586
VELOCITY_GAIN_PER_S: Final = 150.0
INTEGRAL_GAIN_PER_S: Final = 25.0
POSITION_GAIN_PER_S: Final = 30.0
VELOCITY_FILTER_S: Final = 0.002
"""Of the measured velocity: one encoder unit in a millisecond is 15 rpm."""


class Servo:
    """Follows a `Reference`; all in encoder units and seconds, the answer in amperes."""

    __slots__ = ("_amperes_per_acceleration", "_counts", "_current_max_a", "_integral", "velocity")

    def __init__(self, params: MotorParams) -> None:
        inertia_kgm2 = params.inertia_kgm2 + params.carried_inertia_kgm2
        torque_per_acceleration = inertia_kgm2 * TAU / COUNTS_PER_REV
        self._amperes_per_acceleration = torque_per_acceleration / params.torque_constant_nm_per_a
        self._current_max_a = params.current_a_max
        self._counts: int | None = None
        self._integral = 0.0
        self.velocity = 0.0
        """Measured, filtered."""

    def start(self) -> None:
        """Forgets what the integrator has learned."""
        self._integral = 0.0

    def measure(self, counts: int, dt_s: float) -> None:
        """Takes the encoder in, every tick, whether the motor is controlled or not."""
        if self._counts is not None:
            share = dt_s / (dt_s + VELOCITY_FILTER_S)
            self.velocity += share * ((counts - self._counts) / dt_s - self.velocity)
        self._counts = counts

    def current_a(
        self, reference: Reference, position_error: float, dt_s: float, limit_a: float
    ) -> float:
        """The current for this tick, within plus or minus `limit_a`."""
        wanted = reference.velocity + POSITION_GAIN_PER_S * position_error
        error = wanted - self.velocity
        step = INTEGRAL_GAIN_PER_S * error * dt_s
        gain = self._amperes_per_acceleration
        feedback = VELOCITY_GAIN_PER_S * (error + self._integral + step)
        current = gain * (reference.acceleration + feedback)
        bound = min(limit_a, self._current_max_a)
        if abs(current) < bound or step * current < 0.0:  # no wind-up at the limit
            self._integral += step
        return min(max(current, -bound), bound)
