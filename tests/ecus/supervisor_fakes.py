"""Five fake nodes and a panel around the supervisor, in virtual time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from canbus.canopen_protocol import NmtCommand
from canbus.frame import Frame, ReceivedFrame
from canbus.node import NODE_IDS, PERIOD_NS, EventKind, StepOutput
from dbc.database import configuration_hash, dbc_hash
from dbc.endpoint import Endpoint
from dbc.messages import (
    BrakeCommand,
    BrakeDriver,
    BrakeStatus,
    Heartbeat,
    HeartbeatState,
    Mode,
    ModeRequest,
    MonitorReason,
    NodeState,
    Request,
    SafetyVerdict,
    SteerCommand,
    SteerDriver,
    SteerStatus,
    SupervisorState,
    ThrottleCommand,
    ThrottleDriver,
    ThrottleStatus,
    Verdict,
)
from ecus.supervisor.ecu import SupervisorEcu
from ecus.supervisor.ports import SupervisorActuator, SupervisorSensors
from tests.ecus.ecus_fakes import (
    BRAKE_REASON_OTHER,
    EMERGENCY_SENDERS,
    MS,
    PREFIX,
    START_NS,
    named,
    tabby,
)
from vehicles import Vehicle

NODES = ("Steering", "Throttle", "BrakeServo", "SafetyMonitor", "Gateway")
HEARTBEAT = {
    "Steering": "STEER", "Throttle": "THROTTLE", "BrakeServo": "BRAKE",
    "SafetyMonitor": "SAFETY_MONITOR", "Gateway": "GATEWAY",
}
RADIUS_M = 0.287


@dataclass
class FakeNode:
    """One node as the bus shows it."""

    name: str
    endpoint: Endpoint
    nmt: HeartbeatState | None = None
    """None: not booted yet."""
    state: NodeState = NodeState.RELEASED
    is_obedient: bool = True
    """Follows the supervisor's mode, as a healthy actuator node does."""
    is_silent: bool = False
    answers_sdo: bool = True
    hashes: dict[int, int] = field(default_factory=dict)
    codes: set[int] = field(default_factory=set)
    present: int = 0
    is_driver_active: bool = False
    answers: list[Frame] = field(default_factory=list)


class Street:
    """The supervisor under test (`ecu`), five nodes, the panel, and the car's speed."""

    def __init__(self, vehicle: Vehicle | None = None, *, booted: bool = True) -> None:
        self.vehicle = vehicle or tabby()
        self.ecu = SupervisorEcu(self.vehicle)
        hashes = {1: dbc_hash(), 2: configuration_hash(self.vehicle.text)}
        self.nodes = {n: FakeNode(n, Endpoint(n, ()), hashes=dict(hashes)) for n in NODES}
        self.now_ns = START_NS
        self.cycle = 0
        self.speed_mps = 0.0
        self.rear_speed_mps: float | None = None
        self.verdict = Verdict.PERMIT
        self.is_button_down = False
        self.is_stop_pressed = False
        self.relay: bool | None = False
        """What the relay's contact reads."""
        self.request = Request.NONE
        self.sequence = 0
        self.planner_period_ms = 20
        self.torque_nm = 0.0
        self.wheel_angle_rad = 0.0
        self.applied_angle_rad = math.nan
        self.applied_brake = math.nan
        self.extra: list[Frame] = []
        self.events: list[tuple[EventKind, str]] = []
        self.modes: list[Mode] = []
        self.sent: list[Frame] = []
        self.output: StepOutput[SupervisorActuator]
        if booted:
            self.boot()

    # The nodes -------------------------------------------------------------------------------

    def _frames(self) -> list[Frame]:
        frames: list[Frame] = []
        for node in self.nodes.values():
            frames += node.answers
            node.answers = []
            if node.is_silent:
                continue
            if node.nmt is None:
                node.nmt = HeartbeatState.PRE_OPERATIONAL
                frames.append(self._heartbeat(node, HeartbeatState.BOOT_UP))
            elif self.cycle % 5 == 0:
                frames.append(self._heartbeat(node, node.nmt))
            if node.nmt is HeartbeatState.OPERATIONAL:
                frames += self._process_data(node)
        if self.request is not Request.NONE and self.cycle % 2 == 0:
            frames.append(self.request_frame())
        return frames

    def request_frame(self) -> Frame:
        """The next MODE_REQUEST."""
        message = ModeRequest(
            request=self.request,
            planner_period_ms=self.planner_period_ms,
            sequence=self.sequence,
        )
        return self.nodes["Gateway"].endpoint.frame("MODE_REQUEST", message)

    @staticmethod
    def _heartbeat(node: FakeNode, state: HeartbeatState) -> Frame:
        return node.endpoint.frame(f"{HEARTBEAT[node.name]}_HEARTBEAT", Heartbeat(state=state))

    def _process_data(self, node: FakeNode) -> list[Frame]:
        if node.name == "SafetyMonitor":
            verdict = SafetyVerdict(
                verdict=self.verdict, reason=MonitorReason.NONE, identifier=0, value=0
            )
            return [node.endpoint.frame("SAFETY_VERDICT", verdict)]
        if node.name == "Gateway":
            return self._commands(node) if self.cycle % 2 == 0 else []
        frames = [node.endpoint.frame(f"{PREFIX[node.name]}_STATUS", self._status(node.name))]
        if self.cycle % 2 == 0:
            frames.append(self.driver_frame(node.name))
        return frames

    @staticmethod
    def _commands(node: FakeNode) -> list[Frame]:
        frame = node.endpoint.frame
        return [
            frame("STEER_COMMAND", SteerCommand(steering_wheel_angle_rad=0.0, decision_age_ms=0)),
            frame("THROTTLE_COMMAND", ThrottleCommand(wheel_speed_radps=0.0, decision_age_ms=0)),
            frame("BRAKE_COMMAND", BrakeCommand(position_ratio=0.0, decision_age_ms=0)),
        ]

    def _status(self, name: str) -> Any:
        if name == "Steering":
            return SteerStatus(
                steering_wheel_angle_rad=self.wheel_angle_rad,
                applied_steering_wheel_angle_rad=self.applied_angle_rad,
            )
        if name == "Throttle":
            return ThrottleStatus(
                wheel_speed_radps=self.speed_mps / RADIUS_M, applied_wheel_speed_radps=math.nan
            )
        rear = self.speed_mps if self.rear_speed_mps is None else self.rear_speed_mps
        return BrakeStatus(
            servo_position_ratio=0.0,
            applied_position_ratio=self.applied_brake,
            rear_wheel_speed_radps=rear / RADIUS_M,
        )

    def driver_frame(self, name: str) -> Frame:
        """The next driver frame of an actuator node."""
        node = self.nodes[name]
        values: dict[str, Any] = {
            "driver_active": node.is_driver_active,
            "node_state": node.state,
            "present_codes": node.present,
            **{f"er{n}": n in node.codes for n in range(7)},
        }
        message: Any
        if name == "Steering":
            message = SteerDriver(torque_nm=self.torque_nm, **values)
        elif name == "Throttle":
            message = ThrottleDriver(pedal_ratio=0.0, **values)
        else:
            message = BrakeDriver(pedal_ratio=0.0, **values)
        return node.endpoint.frame(f"{PREFIX[name]}_DRIVER", message)

    def emergency_brake(self, name: str, message: Any = BRAKE_REASON_OTHER) -> None:
        """An EMERGENCY_BRAKE of a node, heard in the next step."""
        self.extra.append(self.nodes[name].endpoint.frame(EMERGENCY_SENDERS[name], message))

    def _hear(self, frames: Any) -> None:
        """What the nodes do with the supervisor's frames."""
        for frame in frames:
            if frame.can_id == 0x000:
                command, node_id = frame.data
                for node in self.nodes.values():
                    if NODE_IDS[node.name] == node_id and command == NmtCommand.START:
                        node.nmt = HeartbeatState.OPERATIONAL
            for node in self.nodes.values():
                if frame.can_id == 0x600 + NODE_IDS[node.name] and node.answers_sdo:
                    head, sub = frame.data[1:4], frame.data[3]
                    data = b"\x43" + head + node.hashes[sub].to_bytes(4, "little")
                    node.answers.append(Frame(0x580 + NODE_IDS[node.name], data))
        for name in PREFIX:
            node = self.nodes[name]
            if node.is_obedient:
                node.state = {
                    Mode.AUTOMATIC: NodeState.ACTIVE,
                    Mode.STOPPING: NodeState.ACTIVE,
                    Mode.EMERGENCY: NodeState.EMERGENCY,
                    Mode.INIT: node.state,
                }.get(self.mode, NodeState.RELEASED)

    # Time ------------------------------------------------------------------------------------

    def step(self, *, span_ns: int = PERIOD_NS) -> SupervisorState:
        """One step; what SUPERVISOR_STATE says afterwards."""
        self.now_ns += span_ns
        self.cycle += 1
        frames = self._frames() + self.extra
        self.extra = []
        received = [ReceivedFrame(self.now_ns - MS, frame) for frame in frames]
        sensors = SupervisorSensors(
            button_pressed=self.is_button_down,
            emergency_stop_pressed=self.is_stop_pressed,
            automatic_relay_closed=self.relay,
        )
        self.output = self.ecu.step(self.now_ns, received, sensors)
        coil = self.output.actuator.automatic_relay_closed
        self.relay = self.relay if coil is None else coil
        self.events += [(event.kind, event.text) for event in self.output.events]
        self.sent += self.output.frames
        self._hear(self.output.frames)
        self.modes.append(self.mode)
        return self.shown

    def steps(self, count: int) -> SupervisorState:
        """Several steps."""
        for _ in range(count):
            self.step()
        return self.shown

    def until(self, mode: Mode, count: int = 30) -> int:
        """Steps until a mode is reached, at most `count`; how many it took."""
        for number in range(1, count + 1):
            if self.step().mode is mode:
                return number
        raise AssertionError(f"{self.mode.name}, {self.shown.inhibit.name}; wanted {mode.name}")

    # Scenes ----------------------------------------------------------------------------------

    def boot(self) -> Street:
        """Everybody started and known; a human drives."""
        self.until(Mode.MANUAL, 60)
        self.steps(30)
        return self.forget()

    def push(self) -> Street:
        """A push of the button."""
        self.is_button_down = True
        self.steps(4)
        self.is_button_down = False
        self.steps(2)
        return self

    def ready(self) -> Street:
        """READY."""
        self.push()
        assert self.mode is Mode.READY
        return self.forget()

    def ask(self, request: Request) -> Street:
        """A new request of the gateway, pending from now on."""
        self.request = request
        self.sequence = (self.sequence + 1) % 256
        return self

    def automatic(self) -> Street:
        """AUTOMATIC, all nodes ACTIVE."""
        self.ready().ask(Request.ENGAGE).until(Mode.AUTOMATIC)
        self.request = Request.NONE
        self.applied_brake = self.applied_angle_rad = 0.0
        self.steps(20)
        assert self.mode is Mode.AUTOMATIC
        return self.forget()

    def emergency(self) -> Street:
        """EMERGENCY, by the stop button, released again."""
        self.automatic()
        self.is_stop_pressed = True
        self.until(Mode.EMERGENCY, 1)
        self.is_stop_pressed = False
        self.steps(5)
        return self.forget()

    def forget(self) -> Street:
        """Drops what was recorded."""
        self.events.clear()
        self.modes.clear()
        self.sent.clear()
        return self

    # What is seen ----------------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        """The mode that the last SUPERVISOR_STATE tells."""
        return self.shown.mode

    @property
    def shown(self) -> SupervisorState:
        """The last SUPERVISOR_STATE."""
        (state,) = named(self.output.frames, "SUPERVISOR_STATE")
        assert isinstance(state, SupervisorState)
        return state

    @property
    def codes(self) -> set[int]:
        """Numbers n of the codes ERn that SUPERVISOR_STATE tells."""
        return {n for n in range(7) if getattr(self.shown, f"er{n}")}

    def brakes(self) -> list[Any]:
        """EMERGENCY_BRAKE frames of the supervisor since `forget`."""
        return named(self.sent, "SUPERVISOR_EMERGENCY_BRAKE")

    def logged(self, kind: EventKind) -> list[str]:
        """Texts of events since `forget`."""
        return [text for event, text in self.events if event is kind]
