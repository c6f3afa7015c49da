"""UWA's safety circuits (Section 6): logic that no ECU's software has a part in.

They see the brake pedal, the hand wheel's torque, the motor driver's voltage and the servo, and
stand between `Hardware` and the actuators. They work while the manual/automatic relay is closed:

- A foot on the brake pedal: no drive torque, at once and as long as it is there.
- Hands against the motor, or a foot while the servo does not brake, for as long as the filter
  takes: the emergency-brake line is raised.
- The emergency-stop button: the line is raised, at once.

The raised line cuts the steering motor's power and the drive until the relay opens, holds the servo
full for a while (then brake ECU and watchdog have it again: a servo that pulls for ever burns), and
is told to supervisor and safety monitor as their emergency-stop input.
"""

from typing import Final

from simulation.plant.hardware import Hardware
from simulation.plant.params import CircuitParams
from simulation.plant.state import DriverInputs

NEVER_NS: Final = -(1 << 62)


class SafetyCircuits:
    """The circuits of one car; `step` alone changes them."""

    __slots__ = ("_against_ns", "_is_against", "_is_cut", "_params", "_raised_ns")

    def __init__(self, params: CircuitParams) -> None:
        self._params = params
        self._is_against = False
        self._against_ns = 0
        self._is_cut = False
        self._raised_ns = NEVER_NS

    def is_raised(self, now_ns: int) -> bool:
        """Whether the nodes see the line raised."""
        return now_ns - self._raised_ns < self._params.line_ns

    def step(
        self, now_ns: int, hardware: Hardware, driver: DriverInputs, servo_ratio: float
    ) -> None:
        """Changes what reaches the actuators in this integration step.

        Args:
            now_ns: Virtual time.
            hardware: As relay and watchdogs have left it.
            driver: What the human does.
            servo_ratio: Where the brake servo is, 0..1.
        """
        if not hardware.relay_closed:
            self._is_against = self._is_cut = False
            return
        params = self._params
        is_foot = driver.brake_pedal_ratio > params.pedal_ratio
        if is_foot:
            hardware.drive_ratio = 0.0
        torque_nm, duty = driver.steering_torque_nm, hardware.duty_ratio
        is_against = (
            hardware.motor_powered
            and abs(torque_nm) > params.torque_nm
            and abs(duty) > params.duty_ratio
            and torque_nm * duty < 0.0
        ) or (is_foot and servo_ratio < params.braking_ratio)
        if is_against and not self._is_against:
            self._against_ns = now_ns
        self._is_against = is_against
        is_late = is_against and now_ns - self._against_ns >= params.delay_ns
        if driver.emergency_stop_pressed or is_late:
            self._is_cut = True
            self._raised_ns = now_ns
        if self._is_cut:
            hardware.motor_powered = False
            hardware.duty_ratio = 0.0
            hardware.drive_ratio = 0.0
            if now_ns - self._raised_ns < params.brake_ns:
                hardware.servo_powered = True
                hardware.servo_target_ratio = 1.0
