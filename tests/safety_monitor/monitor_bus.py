"""A scripted car around a real `SafetyMonitor`, in virtual time: every other node's frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame, ReceivedFrame
from canbus.node import Event
from dbc.codec import Decoded, decode
from dbc.endpoint import SPEC_OF_NAME, Endpoint
from dbc.messages import (
    BrakeCommand,
    BrakeDriver,
    BrakeStatus,
    EmergencyBrake,
    Inhibit,
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
from safety_monitor.monitor import SafetyMonitor
from safety_monitor.ports import MonitorSensors
from vehicles import load_vehicle
from vehicles.vehicle import Vehicle

MS = 1_000_000
NAN = float("nan")
TABBY = load_vehicle("tabby_evo")
PERMIT, DENY, BRAKE = Verdict.PERMIT, Verdict.DENY, Verdict.BRAKE

# Written by hand, not read from the DBC: what the monitor must hear, how often, and from whom.
CYCLE_MS = {
    "SUPERVISOR_STATE": 10,
    "STEER_STATUS": 10,
    "THROTTLE_STATUS": 10,
    "BRAKE_STATUS": 10,
    "STEER_COMMAND": 20,
    "THROTTLE_COMMAND": 20,
    "BRAKE_COMMAND": 20,
    "STEER_DRIVER": 20,
    "THROTTLE_DRIVER": 20,
    "BRAKE_DRIVER": 20,
}
TIMEOUT_MS = {name: 60 if cycle_ms == 10 else 100 for name, cycle_ms in CYCLE_MS.items()}
CAN_ID = {
    "SUPERVISOR_STATE": 0x181,
    "STEER_STATUS": 0x182,
    "THROTTLE_STATUS": 0x183,
    "BRAKE_STATUS": 0x184,
    "STEER_COMMAND": 0x202,
    "THROTTLE_COMMAND": 0x203,
    "BRAKE_COMMAND": 0x204,
    "STEER_DRIVER": 0x282,
    "THROTTLE_DRIVER": 0x283,
    "BRAKE_DRIVER": 0x284,
}
SENDERS = ("Supervisor", "Steering", "Throttle", "BrakeServo", "Gateway")
NO_CODES = {f"er{n}": False for n in range(7)}
RADIUS_M = 0.287
LIMIT_MS = 85.0
"""Decision-age limit of a planner of 20 ms."""

# Steering, throttle, brake: what an honest supervisor authorises.
AUTHORISED = {
    Mode.INIT: (False, False, False),
    Mode.MANUAL: (False, False, False),
    Mode.READY: (False, False, False),
    Mode.AUTOMATIC: (True, True, True),
    Mode.STOPPING: (True, True, True),
    Mode.EMERGENCY: (True, False, True),
}


def first_contents() -> dict[str, Any]:
    """A car that stands in MANUAL, everything healthy, a planner that decides to stand."""
    quiet: dict[str, Any] = {
        "driver_active": False, "node_state": NodeState.RELEASED, "present_codes": 0, **NO_CODES
    }
    return {
        "SUPERVISOR_STATE": SupervisorState(
            mode=Mode.MANUAL,
            steering_authorised=False,
            throttle_authorised=False,
            brake_authorised=False,
            **NO_CODES,
            reset_epoch=3,
            decision_age_ms_max=LIMIT_MS,
            inhibit=Inhibit.PRESS_BUTTON,
        ),
        "STEER_STATUS": SteerStatus(
            steering_wheel_angle_rad=0.0, applied_steering_wheel_angle_rad=NAN
        ),
        "THROTTLE_STATUS": ThrottleStatus(wheel_speed_radps=0.0, applied_wheel_speed_radps=NAN),
        "BRAKE_STATUS": BrakeStatus(
            servo_position_ratio=0.0, applied_position_ratio=NAN, rear_wheel_speed_radps=0.0
        ),
        "STEER_COMMAND": SteerCommand(steering_wheel_angle_rad=0.0, decision_age_ms=0.0),
        "THROTTLE_COMMAND": ThrottleCommand(wheel_speed_radps=0.0, decision_age_ms=0.0),
        "BRAKE_COMMAND": BrakeCommand(position_ratio=0.0, decision_age_ms=0.0),
        "STEER_DRIVER": SteerDriver(torque_nm=0.0, **quiet),
        "THROTTLE_DRIVER": ThrottleDriver(pedal_ratio=0.0, **quiet),
        "BRAKE_DRIVER": BrakeDriver(pedal_ratio=0.0, **quiet),
    }


@dataclass(frozen=True)
class Answer:
    """What the monitor sent in one step."""

    frames: list[Frame]
    events: list[Event]
    verdict: SafetyVerdict | None
    emergency: EmergencyBrake | None

    @property
    def told(self) -> tuple[Verdict, MonitorReason, int]:
        """Verdict, reason and identifier on the wire."""
        assert self.verdict is not None
        return self.verdict.verdict, self.verdict.reason, self.verdict.identifier

    @property
    def ids(self) -> set[int]:
        """Identifiers of all frames sent."""
        return {frame.can_id for frame in self.frames}


class MonitorBus:
    """Sends what every other node sends, 10 ms after 10 ms, and keeps the monitor's answers.

    Frames arrive at the instant at which the monitor steps. `muted` names say nothing; `lose` eats
    the next frames of a name although their counters go on.
    """

    def __init__(self, vehicle: Vehicle = TABBY, *, is_started: bool = True) -> None:
        self.monitor = SafetyMonitor(vehicle)
        self.now_ns = 1_000 * MS
        self.cycle = 0
        self.contents = first_contents()
        self.endpoints = {node: Endpoint(node, ()) for node in SENDERS}
        self.muted: set[str] = set()
        self.lost: dict[str, int] = {}
        self.extra: list[Frame] = []
        self.is_emergency_stop_pressed = False
        self.answers: list[Answer] = []
        if is_started:
            self.extra.append(nmt_frame(NmtCommand.START, 5))

    # What the other nodes say ----------------------------------------------------------------

    def say(self, name: str, **values: Any) -> None:
        """Changes signals of one message from now on."""
        self.contents[name] = replace(self.contents[name], **values)

    def frame(self, name: str, content: Any = None) -> Frame:
        """The next frame of a message of its own sender, counter advanced."""
        sender = SPEC_OF_NAME[name].sender
        assert sender is not None
        return self.endpoints[sender].frame(name, content or self.contents[name])

    def lose(self, name: str, count: int = 1) -> None:
        """The next frames of this message never arrive."""
        self.lost[name] = count

    def say_mode(self, mode: Mode, **values: Any) -> None:
        """An honest SUPERVISOR_STATE of this mode."""
        steering, throttle, brake = AUTHORISED[mode]
        authorised = {
            "steering_authorised": steering,
            "throttle_authorised": throttle,
            "brake_authorised": brake,
        }
        self.say("SUPERVISOR_STATE", mode=mode, **{**authorised, **values})

    def say_speed(self, speed_mps: float) -> None:
        """Both axles roll at this speed, straight on."""
        self.say("THROTTLE_STATUS", wheel_speed_radps=speed_mps / RADIUS_M)
        self.say("BRAKE_STATUS", rear_wheel_speed_radps=speed_mps / RADIUS_M)

    def request(self, request: Request) -> None:
        """Two frames of a mode request: the first tells only where the counter stands."""
        content = ModeRequest(request=request, planner_period_ms=20, sequence=1)
        self.extra += [self.frame("MODE_REQUEST", content) for _ in range(2)]

    # Time ------------------------------------------------------------------------------------

    def tick(self, cycles: int = 1) -> Answer:
        """Lets the others live through some cycles; the monitor steps at the end of the last."""
        received: list[ReceivedFrame] = []
        for _ in range(cycles):
            self.now_ns += 10 * MS
            self.cycle += 1
            received += [ReceivedFrame(self.now_ns, frame) for frame in self.due()]
        received += [ReceivedFrame(self.now_ns, frame) for frame in self.extra]
        self.extra = []
        return self.step(received)

    def due(self) -> list[Frame]:
        """What the others send in this cycle."""
        frames = []
        for name, cycle_ms in CYCLE_MS.items():
            if self.cycle * 10 % cycle_ms or name in self.muted:
                continue
            frame = self.frame(name)
            if self.lost.get(name, 0):
                self.lost[name] -= 1
            else:
                frames.append(frame)
        return frames

    def step(self, received: list[ReceivedFrame]) -> Answer:
        """One step of the monitor with exactly these frames."""
        sensors = MonitorSensors(emergency_stop_pressed=self.is_emergency_stop_pressed)
        output = self.monitor.step(self.now_ns, received, sensors)
        verdict = emergency = None
        for frame in output.frames:
            decoded = decode(frame)
            assert isinstance(decoded, Decoded), "the monitor sends only what the DBC knows"
            if isinstance(decoded.message, SafetyVerdict):
                verdict = decoded.message
            elif isinstance(decoded.message, EmergencyBrake):
                emergency = decoded.message
        answer = Answer(list(output.frames), list(output.events), verdict, emergency)
        self.answers.append(answer)
        return answer

    def run(self, span_ms: int) -> Answer:
        """Some cycles; the last answer."""
        assert span_ms % 10 == 0 and span_ms > 0
        for _ in range(span_ms // 10):
            answer = self.tick()
        return answer

    # Where a test begins ---------------------------------------------------------------------

    def permitted(self) -> MonitorBus:
        """MANUAL, everything healthy for long enough."""
        assert self.run(600).told == (PERMIT, MonitorReason.NONE, 0)
        return self

    def driving(self, speed_mps: float = 0.0) -> MonitorBus:
        """AUTOMATIC, reached as it should be, with all echoes there."""
        self.permitted()
        self.say_mode(Mode.READY)
        self.run(20)
        self.request(Request.ENGAGE)
        self.tick()
        self.begin_drive(speed_mps)
        assert self.answers[-1].told == (PERMIT, MonitorReason.NONE, 0)
        return self

    def begin_drive(self, speed_mps: float = 0.0) -> None:
        """SUPERVISOR_STATE AUTOMATIC, and nodes that follow it."""
        self.say_mode(Mode.AUTOMATIC)
        self.say("STEER_STATUS", applied_steering_wheel_angle_rad=0.0)
        self.say("THROTTLE_STATUS", applied_wheel_speed_radps=speed_mps / RADIUS_M)
        self.say("THROTTLE_COMMAND", wheel_speed_radps=speed_mps / RADIUS_M)
        self.say("BRAKE_STATUS", applied_position_ratio=0.0)
        self.say_speed(speed_mps)
        self.run(200)

    def told_ever(self) -> set[Verdict]:
        """Every verdict given since `forget`."""
        return {answer.told[0] for answer in self.answers}

    def forget(self) -> None:
        """Drops the answers so far."""
        self.answers = []
