"""Circuits between ECUs and actuators that work with every ECU's software stopped.

Each actuator has a watchdog: an ECU that has not refreshed its command for 50 ms loses it, until
its next refresh. The manual/automatic relay is the multiplexer of UAH 4.3; it latches, so a dead
supervisor changes nothing.

| relay | watchdog | traction drive | steering motor | brake servo |
|---|---|---|---|---|
| open (manual) | any | driver's pedal, no regeneration | outputs open | unpowered |
| closed (automatic) | fed | ECU's DACs, contact | ECU's duty and enable | ECU's setpoint, power |
| closed (automatic) | starved | 0.5 V on both, forwards | outputs open | powered, full |
"""

from math import isfinite
from typing import Final

from ecus.brake_servo.ports import BrakeActuator
from ecus.steering.ports import SteeringActuator
from ecus.supervisor.ports import SupervisorActuator
from ecus.throttle.ports import ThrottleActuator
from simulation.plant.params import PlantParams
from simulation.plant.traction import DriveInput

NEVER_NS: Final = 1 << 62


class Hardware:
    """Watchdogs and relay; `resolve` says what reaches the actuators now."""

    __slots__ = (
        "_brake_fed_until_ns",
        "_brake_power_asked",
        "_brake_ratio_asked",
        "_drive_asked",
        "_drive_input",
        "_duty_asked",
        "_motor_asked",
        "_regen_asked",
        "_reverse_asked",
        "_steering_fed_until_ns",
        "_throttle_fed_until_ns",
        "_watchdog_ns",
        "changes_at_ns",
        "drive_ratio",
        "duty_ratio",
        "motor_powered",
        "regen_ratio",
        "relay_closed",
        "reverse_selected",
        "servo_powered",
        "servo_target_ratio",
    )

    def __init__(self, params: PlantParams, start_ns: int) -> None:
        self._drive_input = DriveInput(params.traction)
        self._watchdog_ns = params.hardware.watchdog_ns
        # nobody has refreshed anything before power-on: all watchdogs start starved
        self._steering_fed_until_ns = start_ns
        self._throttle_fed_until_ns = start_ns
        self._brake_fed_until_ns = start_ns
        self._duty_asked = 0.0
        self._motor_asked = False
        self._drive_asked = 0.0
        self._regen_asked = 0.0
        self._reverse_asked = False
        self._brake_ratio_asked = 0.0
        self._brake_power_asked = False
        self.relay_closed = False
        self.duty_ratio = 0.0
        self.motor_powered = False
        self.drive_ratio = 0.0
        self.regen_ratio = 0.0
        self.reverse_selected = False
        self.servo_target_ratio = 0.0
        self.servo_powered = False
        self.changes_at_ns = start_ns

    def refresh_steering(self, now_ns: int, command: SteeringActuator) -> None:
        """Takes a command and feeds the steering watchdog."""
        duty = command.motor_duty_ratio
        assert isfinite(duty) and -1.0 <= duty <= 1.0, f"motor_duty_ratio {duty}"
        self._duty_asked = duty
        self._motor_asked = command.motor_enabled
        self._steering_fed_until_ns = now_ns + self._watchdog_ns
        self.changes_at_ns = now_ns

    def refresh_throttle(self, now_ns: int, command: ThrottleActuator) -> None:
        """Takes both DAC codes and the reverse contact, and feeds the throttle watchdog."""
        self._drive_asked = self._drive_input.ratio_of_code(command.throttle_dac_code)
        self._regen_asked = self._drive_input.ratio_of_code(command.regen_dac_code)
        self._reverse_asked = command.reverse_selected
        self._throttle_fed_until_ns = now_ns + self._watchdog_ns
        self.changes_at_ns = now_ns

    def refresh_brake(self, now_ns: int, command: BrakeActuator) -> None:
        """Takes a command and feeds the brake watchdog."""
        ratio = command.servo_position_ratio
        assert isfinite(ratio) and 0.0 <= ratio <= 1.0, f"servo_position_ratio {ratio}"
        self._brake_ratio_asked = ratio
        self._brake_power_asked = command.servo_powered
        self._brake_fed_until_ns = now_ns + self._watchdog_ns
        self.changes_at_ns = now_ns

    def switch_relay(self, now_ns: int, command: SupervisorActuator, stuck: bool) -> None:
        """Moves the latching relay, unless it is told to stay or cannot move."""
        if command.automatic_relay_closed is not None and not stuck:
            self.relay_closed = command.automatic_relay_closed
            self.changes_at_ns = now_ns

    def resolve(self, now_ns: int, driver_throttle_ratio: float) -> None:
        """Works out what reaches each actuator from now on until `changes_at_ns`.

        Args:
            now_ns: Virtual time.
            driver_throttle_ratio: The driver's throttle pedal, used while the relay is open.
        """
        if not self.relay_closed:
            self.drive_ratio = self._drive_input.ratio_of_pedal(driver_throttle_ratio)
            self.regen_ratio = 0.0
            self.reverse_selected = False
            self.motor_powered = False
            self.duty_ratio = 0.0
            self.servo_powered = False
            self.servo_target_ratio = 0.0
            self.changes_at_ns = NEVER_NS
            return
        changes_at_ns = NEVER_NS
        if now_ns < self._steering_fed_until_ns:
            self.motor_powered = self._motor_asked
            self.duty_ratio = self._duty_asked
            changes_at_ns = self._steering_fed_until_ns
        else:
            self.motor_powered = False
            self.duty_ratio = 0.0
        if now_ns < self._throttle_fed_until_ns:
            self.drive_ratio = self._drive_asked
            self.regen_ratio = self._regen_asked
            self.reverse_selected = self._reverse_asked
            changes_at_ns = min(changes_at_ns, self._throttle_fed_until_ns)
        else:
            self.drive_ratio = 0.0
            self.regen_ratio = 0.0
            self.reverse_selected = False
        if now_ns < self._brake_fed_until_ns:
            self.servo_powered = self._brake_power_asked
            self.servo_target_ratio = self._brake_ratio_asked
            changes_at_ns = min(changes_at_ns, self._brake_fed_until_ns)
        else:
            self.servo_powered = True
            self.servo_target_ratio = 1.0
        self.changes_at_ns = changes_at_ns
