"""A scripted rest of the car around a real `GatewayCore`, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame, ReceivedFrame
from canbus.node import Event
from dbc.codec import Decoded, decode
from dbc.endpoint import Endpoint
from dbc.messages import (
    BrakeDriver,
    BrakeStatus,
    Heartbeat,
    HeartbeatState,
    Inhibit,
    Mode,
    ModeRequest,
    MonitorReason,
    NodeState,
    Request,
    SafetyVerdict,
    SteerDriver,
    SteerStatus,
    SupervisorState,
    ThrottleDriver,
    ThrottleStatus,
    Verdict,
)
from gateway.core import NO_INPUTS, GatewayCore, PlannerInputs
from gateway.state import CarState
from vehicles import Vehicle, load_vehicle

MS = 1_000_000
TABBY = load_vehicle("tabby_evo")
NO_CODES = {f"er{n}": False for n in range(7)}
QUIET_NODE: dict[str, Any] = {
    "driver_active": False,
    "node_state": NodeState.RELEASED,
    "present_codes": 0,
    **NO_CODES,
}
SENDER = {
    "SUPERVISOR_STATE": "Supervisor",
    "SUPERVISOR_HEARTBEAT": "Supervisor",
    "STEER_STATUS": "Steering",
    "STEER_DRIVER": "Steering",
    "STEER_HEARTBEAT": "Steering",
    "THROTTLE_STATUS": "Throttle",
    "THROTTLE_DRIVER": "Throttle",
    "THROTTLE_HEARTBEAT": "Throttle",
    "BRAKE_STATUS": "BrakeServo",
    "BRAKE_DRIVER": "BrakeServo",
    "BRAKE_HEARTBEAT": "BrakeServo",
    "SAFETY_VERDICT": "SafetyMonitor",
    "SAFETY_MONITOR_HEARTBEAT": "SafetyMonitor",
}


@dataclass(frozen=True)
class Sent:
    """A frame the gateway sent."""

    time_ns: int
    name: str
    content: Any
    frame: Frame


class Rig:
    """Sends every other node's frames each 10 ms and keeps what the gateway answers."""

    def __init__(
        self, *, period_ms: int = 20, vehicle: Vehicle = TABBY, start_ms: int = 1000
    ) -> None:
        self.core = GatewayCore(vehicle, period_ms * MS)
        self.now_ns = start_ms * MS
        self.sent: list[Sent] = []
        self.events: list[Event] = []
        self.muted: set[str] = set()
        self.extra: list[Frame] = []
        self.react: Callable[[Rig, Sent], None] = lambda rig, sent: None
        self.endpoints = {node: Endpoint(node, ()) for node in set(SENDER.values())}
        heartbeat = Heartbeat(state=HeartbeatState.OPERATIONAL)
        self.content: dict[str, Any] = {
            "SUPERVISOR_STATE": SupervisorState(
                mode=Mode.READY,
                steering_authorised=False,
                throttle_authorised=False,
                brake_authorised=False,
                **NO_CODES,
                reset_epoch=3,
                decision_age_ms_max=85,
                inhibit=Inhibit.NOT_REQUESTED,
            ),
            "STEER_STATUS": SteerStatus(
                steering_wheel_angle_rad=0.0, applied_steering_wheel_angle_rad=float("nan")
            ),
            "THROTTLE_STATUS": ThrottleStatus(
                wheel_speed_radps=0.0, applied_wheel_speed_radps=float("nan")
            ),
            "BRAKE_STATUS": BrakeStatus(
                servo_position_ratio=0.0,
                applied_position_ratio=float("nan"),
                rear_wheel_speed_radps=0.0,
            ),
            "SAFETY_VERDICT": SafetyVerdict(
                verdict=Verdict.PERMIT, reason=MonitorReason.NONE, identifier=0, value=0
            ),
            "STEER_DRIVER": SteerDriver(torque_nm=0.0, **QUIET_NODE),
            "THROTTLE_DRIVER": ThrottleDriver(pedal_ratio=0.0, **QUIET_NODE),
            "BRAKE_DRIVER": BrakeDriver(pedal_ratio=0.0, **QUIET_NODE),
            **{name: heartbeat for name in SENDER if name.endswith("HEARTBEAT")},
        }

    def set(self, message: str, **values: Any) -> None:
        """Changes what a node says."""
        self.content[message] = replace(self.content[message], **values)

    def mode(self, mode: Mode, **values: Any) -> None:
        """Changes the supervisor's mode."""
        self.set("SUPERVISOR_STATE", mode=mode, **values)

    def frame(self, name: str, message: Any) -> Frame:
        """The next frame of another node."""
        node = SENDER.get(name) or next(
            n for n, e in self.endpoints.items() if n.upper().startswith(name.split("_")[0])
        )
        return self.endpoints[node].frame(name, message)

    def start(self) -> Rig:
        """NMT start, and two cycles, so that the gateway believes everybody."""
        self.step()
        self.extra.append(nmt_frame(NmtCommand.START, 0))
        self.step()
        self.sent.clear()
        self.events.clear()
        return self

    def step(self, inputs: PlannerInputs = NO_INPUTS, *, after_ns: int = 10 * MS) -> list[Sent]:
        """One cycle: everybody's frames, and then the gateway's."""
        self.now_ns += after_ns
        arrival_ns = self.now_ns - min(after_ns, MS)
        frames = [
            self.endpoints[SENDER[name]].frame(name, content)
            for name, content in self.content.items()
            if name not in self.muted and SENDER[name] not in self.muted
        ]
        frames += self.extra
        self.extra = []
        return self._take([ReceivedFrame(arrival_ns, frame) for frame in frames], inputs)

    def poke(self, inputs: PlannerInputs) -> list[Sent]:
        """A step out of turn, without frames."""
        return self._take([], inputs)

    def _take(self, received: list[ReceivedFrame], inputs: PlannerInputs) -> list[Sent]:
        output = self.core.step(self.now_ns, received, inputs)
        self.events += output.events
        sent = [self._sent(frame) for frame in output.frames]
        self.sent += sent
        for item in sent:
            self.react(self, item)
        return sent

    def _sent(self, frame: Frame) -> Sent:
        decoded = decode(frame)
        assert isinstance(decoded, Decoded)
        return Sent(self.now_ns, decoded.spec.name, decoded.message, frame)

    def run(self, duration_ms: int) -> list[Sent]:
        """Cycles without inputs; answers what was sent meanwhile."""
        first = len(self.sent)
        for _ in range(duration_ms // 10):
            self.step()
        return self.sent[first:]

    def state(self) -> CarState:
        """The gateway's view now."""
        return self.core.state(self.now_ns)


def named(sent: list[Sent], name: str) -> list[Sent]:
    """Those of one message."""
    return [item for item in sent if item.name == name]


def obedient_supervisor(rig: Rig, sent: Sent) -> None:
    """Grants every request at once, as a supervisor with nothing against it."""
    if not isinstance(sent.content, ModeRequest):
        return
    mode = rig.content["SUPERVISOR_STATE"].mode
    if sent.content.request is Request.ENGAGE and mode is Mode.READY:
        rig.mode(Mode.AUTOMATIC, inhibit=Inhibit.NONE)
    if sent.content.request is Request.DISENGAGE and mode is Mode.AUTOMATIC:
        rig.mode(Mode.STOPPING)
    if sent.content.request is Request.EMERGENCY_STOP and mode is Mode.AUTOMATIC:
        rig.mode(Mode.EMERGENCY, inhibit=Inhibit.CODE_LATCHED, er1=True)
    if sent.content.request is Request.RESET and mode is Mode.EMERGENCY:
        rig.mode(Mode.MANUAL, inhibit=Inhibit.PRESS_BUTTON, er1=False, reset_epoch=4)


class RigLink:
    """A `Link` that steps the rig instead of waiting."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.failure: Exception | None = None
        self.calls: list[str] = []
        self.on_cycle: Callable[[], None] = lambda: None

    @property
    def vehicle(self) -> Vehicle:
        return self.rig.core.vehicle

    @property
    def planner_period_ns(self) -> int:
        return self.rig.core.planner_period_ns

    def open(self) -> None:
        self.calls.append("open")
        self.rig.start()

    def close(self) -> None:
        self.calls.append("close")

    def now_ns(self) -> int:
        return self.rig.now_ns

    def submit(self, inputs: PlannerInputs) -> None:
        self._check()
        self.rig.poke(inputs)

    def state(self) -> CarState:
        self._check()
        return self.rig.state()

    def _check(self) -> None:
        if self.failure is not None:
            raise self.failure

    def wait_until(self, time_ns: int) -> None:
        while self.rig.now_ns < time_ns:
            self.rig.step(after_ns=min(10 * MS, time_ns - self.rig.now_ns))
            self.on_cycle()

    async def wait_async(self, time_ns: int) -> None:
        while self.rig.now_ns < time_ns:
            self.wait_until(min(self.rig.now_ns + 10 * MS, time_ns))
            await asyncio.sleep(0)
