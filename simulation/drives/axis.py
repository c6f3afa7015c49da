"""What the modes of a drive share: its objects' numbers, reference, loops and encoder."""

from __future__ import annotations

from typing import Final

from canbus import cia402
from simulation.drives.motor import COUNTS_PER_REV, Motor
from simulation.drives.profile import Reference
from simulation.drives.servo import Servo

COUNTS_PER_S_PER_RPM: Final = COUNTS_PER_REV / 60.0

TICK_S: Final = 0.001
"""Cycle of an EPOS2's position loop."""

_REPORT_FILTER_S: Final = 0.01
"""Of the velocity that is told (assumption; an EPOS2 offers an averaged one too)."""


class Axis:
    """One motor under control.

    Attributes:
        values: the objects' numbers, shared with the CANopen side.
        zero_counts: encoder reading at position 0; homing sets it.
        velocity_rpm: measured, as it is told.
    """

    def __init__(self, motor: Motor, values: dict[int, int]) -> None:
        self.motor = motor
        self.values = values
        self.reference = Reference()
        self.servo = Servo(motor.params)
        self.zero_counts = 0
        self.velocity_rpm = 0.0

    @property
    def position(self) -> int:
        """In encoder units from the zero."""
        return self.motor.counts - self.zero_counts

    @property
    def following_error(self) -> float:
        """Reference minus measured position."""
        return self.reference.position - self.position

    @property
    def reference_rpm(self) -> float:
        """Velocity of the reference."""
        return self.reference.velocity / COUNTS_PER_S_PER_RPM

    @property
    def is_standing(self) -> bool:
        """Slower than the velocity threshold (606F)."""
        return abs(self.velocity_rpm) < max(1, self.values[cia402.VELOCITY_THRESHOLD])

    def measure(self) -> None:
        """Takes the encoder in."""
        self.servo.measure(self.motor.counts, TICK_S)
        share = TICK_S / (TICK_S + _REPORT_FILTER_S)
        measured_rpm = self.servo.velocity / COUNTS_PER_S_PER_RPM
        self.velocity_rpm += share * (measured_rpm - self.velocity_rpm)

    def start(self) -> None:
        """Puts the reference where the motor is, at the speed that it has."""
        self.reference.start(self.position, self.servo.velocity)
        self.servo.start()

    def rate(self, key: int) -> float:
        """An object in rpm or rpm/s as encoder units per second or per second squared."""
        return self.values[key] * COUNTS_PER_S_PER_RPM

    def ramp(self, target_rpm: float) -> None:
        """Moves the reference towards a velocity with the profile's ramps."""
        self.reference.ramp(
            target_rpm * COUNTS_PER_S_PER_RPM,
            self.rate(cia402.PROFILE_ACCELERATION),
            self.rate(cia402.PROFILE_DECELERATION),
            TICK_S,
        )

    def stop(self, option: int) -> None:
        """Moves the reference towards standstill; option codes 2 and 6 take the faster ramp."""
        quick = (cia402.StopOption.QUICK_STOP, cia402.StopOption.QUICK_STOP_AND_STAY)
        key = cia402.QUICK_STOP_DECELERATION if option in quick else cia402.PROFILE_DECELERATION
        self.reference.ramp(0.0, self.rate(key), self.rate(key), TICK_S)

    def drive(self, *, holds_position: bool, limit_a: float) -> None:
        """One tick of the loops and of the motor."""
        error = self.following_error if holds_position else 0.0
        bound = min(limit_a, self._current_a_max)
        self.motor.step(self.servo.current_a(self.reference, error, TICK_S, bound), TICK_S)

    def coast(self) -> None:
        """One tick without current."""
        self.motor.step(0.0, TICK_S)

    @property
    def _current_a_max(self) -> float:
        rated_ma = self.values[cia402.CURRENT_RATED]
        return self.values[cia402.CURRENT_MAX] * rated_ma * 1e-6


class Dwell:
    """Tells when something has been true for long enough."""

    def __init__(self) -> None:
        self._since_s = 0.0

    def lasts(self, is_true: bool, time_ms: int) -> bool:
        """Ask once a tick. Whether it has been true for `time_ms`."""
        self._since_s = self._since_s + TICK_S if is_true else 0.0
        return is_true and self._since_s * 1000.0 >= time_ms
