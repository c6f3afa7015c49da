"""Histories made by hand: what is on the wire and what is true, cycle by cycle.

A history begins with a healthy world in MANUAL. Every 10 ms all nodes send what `says` holds and
the oracle looks at `truth`; a test changes the two, and lets time pass.
"""

from __future__ import annotations

from dataclasses import replace
from math import nan
from typing import Any

from canbus.frame import Frame, FrameKind
from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import (
    BrakeCommand,
    BrakeDriver,
    BrakeStatus,
    EmergencyBrake,
    ErrorCode,
    Heartbeat,
    HeartbeatState,
    Inhibit,
    Mode,
    ModeRequest,
    MonitorReason,
    NodeState,
    Reason,
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
from oracle.judge import Oracle
from oracle.property import Property
from oracle.sample import Sample
from oracle.settings import Settings
from oracle.words import HEARTBEATS
from vehicles import Vehicle, load_vehicle

TABBY = load_vehicle("tabby_evo")
NS_PER_MS = 1_000_000
CYCLE_MS = 10
HEARTBEAT_CYCLES = 5
COUNTERS = 15
NO_CODES = {f"er{n}": False for n in range(7)}
CALM: dict[str, Any] = {
    "driver_active": False, "node_state": NodeState.RELEASED, "present_codes": 0, **NO_CODES,
}
DRIVERS = ("STEER_DRIVER", "THROTTLE_DRIVER", "BRAKE_DRIVER")


def healthy() -> dict[str, Any]:
    """What all nodes say in MANUAL."""
    return {
        "SUPERVISOR_STATE": SupervisorState(
            mode=Mode.MANUAL, steering_authorised=False, throttle_authorised=False,
            brake_authorised=False, reset_epoch=0, decision_age_ms_max=85,
            inhibit=Inhibit.NONE, **NO_CODES,
        ),
        "STEER_STATUS": SteerStatus(
            steering_wheel_angle_rad=0.0, applied_steering_wheel_angle_rad=nan
        ),
        "THROTTLE_STATUS": ThrottleStatus(wheel_speed_radps=0.0, applied_wheel_speed_radps=nan),
        "BRAKE_STATUS": BrakeStatus(
            servo_position_ratio=0.0, applied_position_ratio=nan, rear_wheel_speed_radps=0.0
        ),
        "STEER_DRIVER": SteerDriver(torque_nm=0.0, **CALM),
        "THROTTLE_DRIVER": ThrottleDriver(pedal_ratio=0.0, **CALM),
        "BRAKE_DRIVER": BrakeDriver(pedal_ratio=0.0, **CALM),
        "SAFETY_VERDICT": SafetyVerdict(
            verdict=Verdict.PERMIT, reason=MonitorReason.NONE, identifier=0, value=0
        ),
        "STEER_COMMAND": SteerCommand(steering_wheel_angle_rad=0.0, decision_age_ms=0.0),
        "THROTTLE_COMMAND": ThrottleCommand(wheel_speed_radps=0.0, decision_age_ms=0.0),
        "BRAKE_COMMAND": BrakeCommand(position_ratio=0.0, decision_age_ms=0.0),
        **dict.fromkeys(HEARTBEATS, Heartbeat(state=HeartbeatState.OPERATIONAL)),
    }


class History:
    """One world that a test writes.

    Attributes:
        says: What is sent every cycle, by message; take one out, and it is silent.
        truth: The sample's fields that differ from a parked car's.
    """

    def __init__(
        self, kind: type[Property], vehicle: Vehicle = TABBY, **changes: Any
    ) -> None:
        self.kind = kind
        self.oracle = Oracle(vehicle, Settings.of(vehicle, **changes))
        self.says = healthy()
        self.truth: dict[str, Any] = {}
        self.now_ns = 0
        self._cycles = 0
        self._counters: dict[str, int] = {}

    # Time ------------------------------------------------------------------------------------

    def run(self, span_ms: float) -> History:
        """Cycles of 10 ms; the last one is at the end of the span."""
        for _ in range(round(span_ms / CYCLE_MS)):
            self.wait(CYCLE_MS)
            for name, message in self.says.items():
                if name not in HEARTBEATS or self._cycles % HEARTBEAT_CYCLES == 0:
                    self.send(name, message)
            self._cycles += 1
            self.look()
        return self

    def wait(self, span_ms: float) -> None:
        """Time passes, and nobody says anything."""
        self.now_ns += round(span_ms * NS_PER_MS)

    # What happens ----------------------------------------------------------------------------

    def change(self, name: str, **values: Any) -> History:
        """From the next cycle on the message says something else."""
        self.says[name] = replace(self.says[name], **values)
        return self

    def mode(self, mode: Mode, **values: Any) -> History:
        """The supervisor goes into a mode, and authorises what belongs to it."""
        drives = mode in (Mode.AUTOMATIC, Mode.STOPPING)
        brakes = mode is Mode.EMERGENCY
        given = {
            "steering_authorised": drives or brakes, "throttle_authorised": drives,
            "brake_authorised": drives or brakes,
        }
        return self.change("SUPERVISOR_STATE", mode=mode, **(given | values))

    def node_states(self, state: NodeState) -> History:
        """All three actuator nodes go into a state."""
        for name in DRIVERS:
            self.change(name, node_state=state)
        return self

    def send(self, name: str, message: Any, sender: str | None = None) -> None:
        """One frame now, its counter the next of its sender's."""
        self.hear(self.frame(name, message), sender or str(SPEC_OF_NAME[name].sender))

    def frame(self, name: str, message: Any) -> Frame:
        """The next frame of a message."""
        counter = self._counters.get(name, 0)
        self._counters[name] = (counter + 1) % COUNTERS
        return encode(SPEC_OF_NAME[name], message, counter)

    def hear(self, frame: Frame, sender: str) -> None:
        """Any frame now."""
        self.oracle.on_frame(self.now_ns, sender, frame)

    def boot_up(self, name: str) -> None:
        """A node's boot-up now."""
        self.send(name, Heartbeat(state=HeartbeatState.BOOT_UP))

    def look(self, **truth: Any) -> History:
        """The oracle looks at the truth, some of it changed from now on."""
        self.truth |= truth
        self.oracle.on_truth(Sample(true_ns=self.now_ns, **self.truth))
        return self

    def call_brake(self, sender: str = "STEER", code: ErrorCode = ErrorCode.ER1) -> None:
        """An EMERGENCY_BRAKE now."""
        message = EmergencyBrake(code=code, reason=Reason.NONE, cause_age_ms=0, reset_epoch=0)
        self.send(f"{sender}_EMERGENCY_BRAKE", message)

    def request(self, request: Request) -> None:
        """The planner asks for something now, and again: nobody believes a first frame."""
        message = ModeRequest(request=request, planner_period_ms=20, sequence=1)
        for _ in range(2):
            self.send("MODE_REQUEST", message)

    def fault(self, is_begin: bool = True, **how: Any) -> None:
        """Something breaks now, or is whole again."""
        self.oracle.on_fault(self.now_ns, "trouble", "part", is_begin, **how)

    # Scenes ----------------------------------------------------------------------------------

    def ready(self) -> History:
        """From MANUAL to READY by the button."""
        self.run(500)
        self.truth["button_pressed"] = True
        self.run(50)
        self.truth["button_pressed"] = False
        return self.mode(Mode.READY).run(100)

    def drive(self, speed_mps: float = 5.0) -> History:
        """From MANUAL to AUTOMATIC, and moving."""
        self.ready()
        self.request(Request.ENGAGE)
        self.truth |= {"relay_closed": True, "speed_mps": speed_mps}
        return self.mode(Mode.AUTOMATIC).node_states(NodeState.ACTIVE).run(500)

    def emergency(self) -> History:
        """A driving car whose emergency stop was pressed: called, and the brake is on its way."""
        self.look(emergency_stop_pressed=True)
        self.wait(9)
        self.call_brake("SUPERVISOR")
        self.mode(Mode.EMERGENCY).node_states(NodeState.EMERGENCY)
        self.truth |= {"servo_powered": True, "servo_target_ratio": 1.0}
        return self.run(20)

    def stand(self) -> History:
        """The brake is full, the car stands, the emergency stop is released."""
        self.run(270)
        self.truth["servo_position_ratio"] = 1.0
        self.run(500)
        self.truth |= {"speed_mps": 0.0, "emergency_stop_pressed": False}
        return self.run(1000)

    # Judgement -------------------------------------------------------------------------------

    def broken(self) -> list[str]:
        """How the property was broken, in words."""
        report = self.oracle.finish(self.now_ns)
        return [v.text for v in report.violations if v.property == self.kind.name]

    def others(self) -> list[str]:
        """What else was broken."""
        report = self.oracle.finish(self.now_ns)
        return [str(v) for v in report.violations if v.property != self.kind.name]


REMOTE = FrameKind.REMOTE
