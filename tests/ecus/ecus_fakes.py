"""The rest of the bus, for one ECU at a time: peers that send protected frames in virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame, FrameKind, ReceivedFrame
from canbus.node import NODE_IDS, PERIOD_NS, EventKind, StepOutput
from dbc.codec import Decoded, decode
from dbc.endpoint import ERROR_BUS_OFF, SPEC_OF_NAME, Endpoint
from dbc.messages import (
    BrakeCommand,
    BrakeStatus,
    EmergencyBrake,
    ErrorCode,
    Inhibit,
    Mode,
    NodeState,
    Reason,
    SteerCommand,
    SupervisorState,
    ThrottleCommand,
    ThrottleStatus,
)
from ecus.brake_servo.ecu import BrakeServoEcu
from ecus.brake_servo.ports import BrakeSensors
from ecus.steering.ecu import SteeringEcu
from ecus.steering.ports import SteeringSensors
from ecus.throttle.ecu import ThrottleEcu
from ecus.throttle.ports import ThrottleSensors
from vehicles import Vehicle, load_vehicle

MS = 1_000_000
START_NS = 7_300_000_000
"""Clocks of nodes do not begin at zero."""
AGE_LIMIT_MS = 85
PREFIX = {"Steering": "STEER", "Throttle": "THROTTLE", "BrakeServo": "BRAKE"}
EMERGENCY_SENDERS = {
    "Supervisor": "SUPERVISOR_EMERGENCY_BRAKE",
    "Steering": "STEER_EMERGENCY_BRAKE",
    "Throttle": "THROTTLE_EMERGENCY_BRAKE",
    "BrakeServo": "BRAKE_EMERGENCY_BRAKE",
    "SafetyMonitor": "SAFETY_MONITOR_EMERGENCY_BRAKE",
    "Gateway": "GATEWAY_EMERGENCY_BRAKE",
}
IDLE_SENSORS: dict[str, Any] = {
    "Steering": SteeringSensors(column_angle_rad=0.0, driver_torque_nm=0.0, motor_fault=False),
    "Throttle": ThrottleSensors(encoder_count=0, encoder_edge_age_s=1.0, pedal_ratio=0.0),
    "BrakeServo": BrakeSensors(
        servo_position_ratio=0.0, pedal_ratio=0.0, wheel_count=0, wheel_edge_age_s=1.0,
        slope_rad=0.0,
    ),
}
ECUS: dict[str, Callable[[Vehicle], Any]] = {
    "Steering": SteeringEcu,
    "Throttle": ThrottleEcu,
    "BrakeServo": BrakeServoEcu,
}
BRAKE_REASON_OTHER = EmergencyBrake(
    code=ErrorCode.ER1, reason=Reason.REQUESTED, cause_age_ms=0, reset_epoch=0
)
BUS_OFF = Frame(ERROR_BUS_OFF, bytes(8), FrameKind.ERROR)


@cache
def tabby() -> Vehicle:
    """The vehicle of most tests."""
    return load_vehicle("tabby_evo")


def content(frame: Frame) -> Any:
    """The message in a frame that must be good."""
    decoded = decode(frame)
    assert isinstance(decoded, Decoded), (str(frame), decoded)
    return decoded.message


def named(frames: Iterable[Frame], name: str) -> list[Any]:
    """Contents of all frames of one message."""
    return [content(frame) for frame in frames if frame.can_id == SPEC_OF_NAME[name].can_id]


def sdo_write(node: str, subindex: int, raw: int) -> Frame:
    """An expedited write of a 32-bit parameter (object 0x2100)."""
    data = bytes([0x23, 0x00, 0x21, subindex]) + raw.to_bytes(4, "little")
    return Frame(0x600 + NODE_IDS[node], data)


class EncoderFake:
    """An ideal incremental encoder: whole edges, and the time since the latest, to 1 us."""

    def __init__(self, pulses_per_rev: float) -> None:
        self._rad_per_edge = 2.0 * math.pi / pulses_per_rev
        self._angle_rad = 0.5 * self._rad_per_edge
        self._count = 0
        self._edge_age_s = 1.0

    def advance(self, speed_radps: float, dt_s: float) -> tuple[int, float]:
        """Count and edge age after turning at constant speed for `dt_s`."""
        self._angle_rad += speed_radps * dt_s
        edge = self._rad_per_edge
        count = math.floor(self._angle_rad / edge)
        if count != self._count:
            boundary = count if speed_radps > 0.0 else count + 1
            self._edge_age_s = (self._angle_rad - boundary * edge) / speed_radps
            self._count = count
        else:
            self._edge_age_s = min(self._edge_age_s + dt_s, 1.0)
        return count, round(self._edge_age_s, 6)


class Rig:
    """One actuator ECU, its sensors, and everybody else on the bus, stepped every 10 ms.

    By default the supervisor says MANUAL and the node has been started. `commands` None: the
    gateway is silent. Frames arrive `lag_ns` before the step that takes them in.
    """

    def __init__(self, name: str, vehicle: Vehicle | None = None, *, started: bool = True) -> None:
        self.name = name
        self.prefix = PREFIX[name]
        self.vehicle = vehicle or tabby()
        self.node = ECUS[name](self.vehicle)
        self.sensors = IDLE_SENSORS[name]
        self.now_ns = START_NS
        self.lag_ns = 1 * MS
        self.peers = {peer: Endpoint(peer, ()) for peer in NODE_IDS if peer != name}
        self.mode: Mode | None = Mode.MANUAL
        self.is_authorised = False
        self.reset_epoch = 0
        self.age_limit_ms: float = AGE_LIMIT_MS
        self.setpoint = 0.0
        self.age_ms: float | None = 0.0
        """Age of the decision in the command frames; None: the gateway is silent."""
        self.wheel_speed_radps: float | None = 0.0
        """What THROTTLE_STATUS says; None: silent."""
        self.servo: float | None = 0.0
        self.rear_wheel_speed_radps = 0.0
        """What BRAKE_STATUS says; None: silent."""
        self.servo_applied = math.nan
        self.speed_mps = 0.0
        self.driver_pedal = 0.0
        """The driver's foot on the brake."""
        self.is_servo_sound = True
        """The servo goes where it is sent, and its sensor tells so."""
        self._encoder = EncoderFake(
            self.vehicle.traction.encoder_pulses_per_rev
            if name == "Throttle"
            else self.vehicle.brake.wheel_encoder_pulses_per_rev
        )
        self.extra: list[Frame] = []
        self.cycle = 0
        self.sent: list[Frame] = []
        self.sent_ns: list[int] = []
        self.events: list[tuple[EventKind, str]] = []
        self.output: StepOutput[Any]
        if started:
            self.steps(2)
            self.extra.append(nmt_frame(NmtCommand.START, NODE_IDS[name]))
            self.steps(2)

    # The peers -------------------------------------------------------------------------------

    def supervisor_frame(self, **changes: Any) -> Frame:
        """The next SUPERVISOR_STATE."""
        assert self.mode is not None
        values: dict[str, Any] = {
            "mode": self.mode,
            "steering_authorised": self.is_authorised,
            "throttle_authorised": self.is_authorised and self.mode is not Mode.EMERGENCY,
            "brake_authorised": self.is_authorised,
            **{f"er{n}": False for n in range(7)},
            "reset_epoch": self.reset_epoch,
            "decision_age_ms_max": self.age_limit_ms,
            "inhibit": Inhibit.NONE,
        }
        state = SupervisorState(**(values | changes))
        return self.peers["Supervisor"].frame("SUPERVISOR_STATE", state)

    def command_frame(self, setpoint: float, age_ms: float) -> Frame:
        """The next command for this node."""
        message: Any
        if self.name == "Steering":
            message = SteerCommand(steering_wheel_angle_rad=setpoint, decision_age_ms=age_ms)
        elif self.name == "Throttle":
            message = ThrottleCommand(wheel_speed_radps=setpoint, decision_age_ms=age_ms)
        else:
            message = BrakeCommand(position_ratio=setpoint, decision_age_ms=age_ms)
        return self.peers["Gateway"].frame(f"{self.prefix}_COMMAND", message)

    def emergency_frame(self, peer: str) -> Frame:
        """An EMERGENCY_BRAKE of another node."""
        return self.peers[peer].frame(EMERGENCY_SENDERS[peer], BRAKE_REASON_OTHER)

    def _peer_frames(self) -> list[Frame]:
        frames = []
        if self.mode is not None:
            frames.append(self.supervisor_frame())
        if self.age_ms is not None and self.cycle % 2 == 0:
            frames.append(self.command_frame(self.setpoint, self.age_ms))
        if self.name != "Throttle" and self.wheel_speed_radps is not None:
            status = ThrottleStatus(
                wheel_speed_radps=self.wheel_speed_radps, applied_wheel_speed_radps=math.nan
            )
            frames.append(self.peers["Throttle"].frame("THROTTLE_STATUS", status))
        if self.name != "BrakeServo" and self.servo is not None:
            brake = BrakeStatus(
                servo_position_ratio=self.servo,
                applied_position_ratio=self.servo_applied,
                rear_wheel_speed_radps=self.rear_wheel_speed_radps,
            )
            frames.append(self.peers["BrakeServo"].frame("BRAKE_STATUS", brake))
        return frames

    # Time ------------------------------------------------------------------------------------

    def step(self, *, span_ns: int = PERIOD_NS, frames: list[Frame] | None = None) -> Any:
        """One step `span_ns` after the last; answers the actuator's command."""
        self.now_ns += span_ns
        self.cycle += 1
        heard = self._peer_frames() if frames is None else frames
        heard += self.extra
        self.extra = []
        arrival_ns = self.now_ns - self.lag_ns
        received = [ReceivedFrame(arrival_ns, f) for f in heard if self._is_accepted(f)]
        self._turn_wheel(span_ns * 1e-9)
        self._move_servo(span_ns * 1e-9)
        self.output = self.node.step(self.now_ns, received, self.sensors)
        for frame in self.output.frames:
            self.sent.append(frame)
            self.sent_ns.append(self.now_ns)
        self.events += [(event.kind, event.text) for event in self.output.events]
        return self.output.actuator

    def _is_accepted(self, frame: Frame) -> bool:
        return frame.kind is FrameKind.ERROR or frame.can_id in self.node.acceptance

    def _turn_wheel(self, dt_s: float) -> None:
        if self.name == "Steering":
            return
        wheel_radps = self.speed_mps / self.vehicle.geometry.wheel_radius_m
        if self.name == "Throttle":
            motor_radps = wheel_radps * self.vehicle.traction.gear_ratio
            count, age_s = self._encoder.advance(motor_radps, dt_s)
            self.sense(encoder_count=count, encoder_edge_age_s=age_s)
        else:
            count, age_s = self._encoder.advance(wheel_radps, dt_s)
            self.sense(wheel_count=count, wheel_edge_age_s=age_s)

    def _move_servo(self, dt_s: float) -> None:
        if self.name != "BrakeServo" or not hasattr(self, "output"):
            return
        position = self.sensors.servo_position_ratio
        if self.is_servo_sound:
            step = dt_s / self.vehicle.brake.full_travel_s
            command = self.output.actuator  # None: without power, as the relay is open
            wanted = 0.0 if command is None else command.servo_position_ratio
            position += min(max(wanted - position, -step), step)
        pedal = self.driver_pedal if math.isnan(self.driver_pedal) else max(
            self.driver_pedal, position if position == position else 0.0
        )
        self.sensors = replace(self.sensors, servo_position_ratio=position, pedal_ratio=pedal)

    def steps(self, count: int) -> Any:
        """Several steps; the last actuator command."""
        for _ in range(count):
            self.step()
        return self.output.actuator

    def sense(self, **values: Any) -> None:
        """Other readings from now on; the brake pedal is a foot, a servo position sticks."""
        if self.name == "BrakeServo":
            self.driver_pedal = values.get("pedal_ratio", self.driver_pedal)
            self.is_servo_sound &= "servo_position_ratio" not in values
        self.sensors = replace(self.sensors, **values)

    def heal(self) -> None:
        """All sensors sound, nobody at the controls."""
        self.sensors = IDLE_SENSORS[self.name]
        self.driver_pedal, self.is_servo_sound = 0.0, True

    # Scenes ----------------------------------------------------------------------------------

    def drive(self, setpoint: float = 0.0) -> Rig:
        """Armed in READY, then AUTOMATIC until the node is ACTIVE and follows."""
        self.setpoint = setpoint
        self.mode, self.is_authorised = Mode.READY, False
        self.steps(2)
        self.mode, self.is_authorised = Mode.AUTOMATIC, True
        self.steps(4)
        assert self.state is NodeState.ACTIVE
        self.forget()
        return self

    def emergency(self) -> Rig:
        """The supervisor in EMERGENCY."""
        self.mode, self.is_authorised = Mode.EMERGENCY, True
        return self

    def forget(self) -> None:
        """Drops what was recorded."""
        self.sent.clear()
        self.sent_ns.clear()
        self.events.clear()

    # What is seen ----------------------------------------------------------------------------

    @property
    def state(self) -> NodeState:
        """The node's state."""
        state: NodeState = self.node.state
        return state

    def all_sent(self, name: str) -> list[Any]:
        """Contents of all recorded frames of one message; `*_STATUS` without prefix is ours."""
        full = name if name in SPEC_OF_NAME else f"{self.prefix}_{name}"
        return named(self.sent, full)

    def now_sent(self, name: str) -> list[Any]:
        """The same, of the last step alone."""
        full = name if name in SPEC_OF_NAME else f"{self.prefix}_{name}"
        return named(self.output.frames, full)

    def logged(self, kind: EventKind) -> list[str]:
        """Texts of recorded events of one kind."""
        return [text for event, text in self.events if event is kind]

    @property
    def is_idle(self) -> bool:
        """Whether the actuator is left to the driver."""
        return is_released(self.name, self.output.actuator)


def is_released(name: str, actuator: Any) -> bool:
    """Whether an actuator command leaves the control to the driver, as no command does."""
    if actuator is None:
        return name == "BrakeServo"
    if name == "Steering":
        return not actuator.motor_enabled and actuator.motor_duty_ratio == 0.0
    if name == "Throttle":
        return (actuator.throttle_dac_code, actuator.regen_dac_code) == (410, 410)
    return not actuator.servo_powered and actuator.servo_position_ratio == 0.0


def flags(driver: Any) -> set[int]:
    """Numbers n of the codes ERn that a driver frame reports."""
    return {n for n in range(7) if getattr(driver, f"er{n}")}


def changed(vehicle: Vehicle, **sections: Mapping[str, Any]) -> Vehicle:
    """A vehicle with some numbers of its sections replaced."""
    return replace(
        vehicle,
        **{
            section: replace(getattr(vehicle, section), **values)
            for section, values in sections.items()
        },
    )
