"""Each node's share of the harness: its readings from frames, its commands to frames."""

from __future__ import annotations

from collections.abc import Sequence

from canbus.frame import Frame, ReceivedFrame
from dbc.harness import (
    BrakeActuatorWire,
    BrakeEncoderWire,
    BrakeSensorsWire,
    RelayCoil,
    SteeringActuatorWire,
    SteeringSensorsWire,
    SupervisorActuatorWire,
    SupervisorSensorsWire,
    ThrottleActuatorWire,
    ThrottleSensorsWire,
)
from dbc.spec import NAN
from ecus.brake_servo.ports import BrakeActuator, BrakeSensors
from ecus.steering.ports import SteeringActuator, SteeringSensors
from ecus.supervisor.ports import SupervisorActuator, SupervisorSensors
from ecus.throttle.ports import ThrottleActuator, ThrottleSensors
from runtime.harness import EDGE_AGE_S_MAX, Inbox, edge_age_s, harness_frame, is_stale
from safety_monitor.ports import MonitorSensors

COIL_OF_RELAY = {None: RelayCoil.LEAVE, False: RelayCoil.OPEN, True: RelayCoil.CLOSE}
"""Which pulse the coil of the manual/automatic relay gets."""


class _Inputs:
    """What all shares of the harness have in common: an inbox."""

    def __init__(self, *names: str) -> None:
        self._inbox = Inbox(*names)

    @property
    def acceptance(self) -> frozenset[int]:
        """Identifiers of the harness bus that this node reads."""
        return self._inbox.acceptance

    @property
    def bad_frames(self) -> int:
        """Harness frames that could not be used."""
        return self._inbox.bad_frames

    def take(self, received: Sequence[ReceivedFrame]) -> None:
        """Takes in frames of the harness bus."""
        self._inbox.take(received)


class SteeringWires(_Inputs):
    """Steering column: angle and torque sensor, motor driver."""

    def __init__(self) -> None:
        super().__init__("STEERING_SENSORS")

    def sensors(self, now_ns: int) -> SteeringSensors:
        """Readings now; NaN when the wires are silent."""
        reading = self._inbox.newest("STEERING_SENSORS")
        if reading is None or is_stale(reading, now_ns):
            return SteeringSensors(column_angle_rad=NAN, driver_torque_nm=NAN, motor_fault=False)
        wire: SteeringSensorsWire = reading.content
        return SteeringSensors(
            column_angle_rad=wire.column_angle_rad,
            driver_torque_nm=wire.driver_torque_nm,
            motor_fault=wire.motor_fault,
        )

    def frames(self, actuator: SteeringActuator) -> list[Frame]:
        """The motor driver's command."""
        wire = SteeringActuatorWire(
            motor_duty_ratio=actuator.motor_duty_ratio, motor_enabled=actuator.motor_enabled
        )
        return [harness_frame("STEERING_ACTUATOR", wire)]


class ThrottleWires(_Inputs):
    """Traction motor: encoder and DACs; throttle pedal."""

    def __init__(self) -> None:
        super().__init__("THROTTLE_SENSORS")

    def sensors(self, now_ns: int) -> ThrottleSensors:
        """Readings now; when the wires are silent the pedal is NaN and the encoder stands."""
        reading = self._inbox.newest("THROTTLE_SENSORS")
        if reading is None:
            return ThrottleSensors(
                encoder_count=0, encoder_edge_age_s=EDGE_AGE_S_MAX, pedal_ratio=NAN
            )
        wire: ThrottleSensorsWire = reading.content
        return ThrottleSensors(
            encoder_count=wire.encoder_count,
            encoder_edge_age_s=edge_age_s(wire.encoder_edge_age_s, reading, now_ns),
            pedal_ratio=NAN if is_stale(reading, now_ns) else wire.pedal_ratio,
        )

    def frames(self, actuator: ThrottleActuator) -> list[Frame]:
        """Both DACs."""
        wire = ThrottleActuatorWire(
            throttle_dac_code=actuator.throttle_dac_code,
            regen_dac_code=actuator.regen_dac_code,
            reverse_selected=actuator.reverse_selected,
        )
        return [harness_frame("THROTTLE_ACTUATOR", wire)]


class BrakeWires(_Inputs):
    """Brake servo and pedal, rear-wheel encoder, inclinometer."""

    def __init__(self) -> None:
        super().__init__("BRAKE_SENSORS", "BRAKE_ENCODER")

    def sensors(self, now_ns: int) -> BrakeSensors:
        """Readings now; when the wires are silent NaN, and the encoder stands."""
        wheel_count, wheel_edge_age_s = 0, EDGE_AGE_S_MAX
        reading = self._inbox.newest("BRAKE_ENCODER")
        if reading is not None:
            encoder: BrakeEncoderWire = reading.content
            wheel_count = encoder.wheel_count
            wheel_edge_age_s = edge_age_s(encoder.wheel_edge_age_s, reading, now_ns)
        servo_ratio, pedal_ratio, slope_rad = NAN, NAN, NAN
        reading = self._inbox.newest("BRAKE_SENSORS")
        if reading is not None and not is_stale(reading, now_ns):
            wire: BrakeSensorsWire = reading.content
            servo_ratio, pedal_ratio = wire.servo_position_ratio, wire.pedal_ratio
            slope_rad = wire.slope_rad
        return BrakeSensors(
            servo_position_ratio=servo_ratio,
            pedal_ratio=pedal_ratio,
            wheel_count=wheel_count,
            wheel_edge_age_s=wheel_edge_age_s,
            slope_rad=slope_rad,
        )

    def frames(self, actuator: BrakeActuator) -> list[Frame]:
        """The servo's command."""
        wire = BrakeActuatorWire(
            servo_position_ratio=actuator.servo_position_ratio,
            servo_powered=actuator.servo_powered,
        )
        return [harness_frame("BRAKE_ACTUATOR", wire)]


class _PanelInputs(_Inputs):
    """Panel and emergency-stop line."""

    def __init__(self) -> None:
        super().__init__("SUPERVISOR_SENSORS")

    def _panel(self, now_ns: int) -> SupervisorSensors:
        """The panel; a line heard before and silent now reads as an emergency stop."""
        reading = self._inbox.newest("SUPERVISOR_SENSORS")
        if reading is None or is_stale(reading, now_ns):
            return SupervisorSensors(
                button_pressed=False,
                emergency_stop_pressed=reading is not None,
                automatic_relay_closed=None,
            )
        wire: SupervisorSensorsWire = reading.content
        return SupervisorSensors(
            button_pressed=wire.button_pressed,
            emergency_stop_pressed=wire.emergency_stop_pressed,
            automatic_relay_closed=wire.automatic_relay_closed,
        )


class SupervisorWires(_PanelInputs):
    """Panel, emergency-stop line, coil of the manual/automatic relay."""

    def sensors(self, now_ns: int) -> SupervisorSensors:
        """The panel now; a line cut after it was heard reads as pressed."""
        return self._panel(now_ns)

    def frames(self, actuator: SupervisorActuator) -> list[Frame]:
        """The relay's coil."""
        coil = COIL_OF_RELAY[actuator.automatic_relay_closed]
        return [harness_frame("SUPERVISOR_ACTUATOR", SupervisorActuatorWire(relay_coil=coil))]


class MonitorWires(_PanelInputs):
    """The safety monitor reads the emergency-stop line and moves nothing."""

    def sensors(self, now_ns: int) -> MonitorSensors:
        """The line now; cut after it was heard it reads as pressed."""
        return MonitorSensors(emergency_stop_pressed=self._panel(now_ns).emergency_stop_pressed)

    def frames(self, actuator: None) -> list[Frame]:
        """Nothing to send."""
        return []


class NoWires(_Inputs):
    """For a node without hardware."""

    def sensors(self, now_ns: int) -> None:
        """Nothing to read."""
        return None

    def frames(self, actuator: None) -> list[Frame]:
        """Nothing to send."""
        return []
