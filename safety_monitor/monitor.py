"""The safety monitor: hears every frame, asks nobody, holds a veto.

Independent on purpose: it imports no ECU and no gateway, and takes its limits from the vehicle
file and the DBC alone. It starts in DENY.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.resources import files
from typing import Final

from canbus.canopen_node import CanopenNode
from canbus.canopen_protocol import NmtState
from canbus.cia402 import identifiers
from canbus.cycle import CycleFault, CycleWatch
from canbus.frame import Frame, FrameKind, ReceivedFrame
from canbus.node import NODE_IDS, Event, EventKind, StepOutput
from dbc.database import configuration_hash, dbc_hash
from dbc.endpoint import FAILSAFE_ID, SPEC_OF_NAME, Endpoint, Message, is_forged
from dbc.messages import (
    SPECS,
    BrakeCommand,
    BrakeStatus,
    EmergencyBrake,
    ErrorCode,
    Mode,
    ModeRequest,
    MonitorReason,
    Reason,
    Request,
    SafetyVerdict,
    SteerCommand,
    SteerStatus,
    SupervisorState,
    ThrottleCommand,
    ThrottleStatus,
    Verdict,
)
from dbc.strangers import StrangerLog
from safety_monitor.checks import (
    DRIVING,
    Finding,
    ModeRules,
    RateLimit,
    reports_code,
)
from safety_monitor.envelope import EXPOSED, Limits
from safety_monitor.following import NOTHING_TO_FOLLOW, Errors, FollowingChecks
from safety_monitor.motion import Motion, MotionChecks
from safety_monitor.ports import MonitorSensors
from safety_monitor.verdict import VERDICT_OF, Phase, Severity
from vehicles import Vehicle

NAME: Final = "SafetyMonitor"
NS_PER_MS: Final = 1_000_000
PROOF_NS: Final = 500_000_000
"""Everything must have been healthy this long without a gap."""
DOUBT_NS: Final = 1_000_000_000
"""A doubt denies this long after it was last seen."""
REQUEST_NS: Final = 500_000_000
"""An engage request this old still explains a beginning drive."""
DECISION_MARGIN_MS: Final = 30
"""The actuators act on a stale decision first; past this the monitor does."""
VALUE_MAX: Final = 4095
"""What SAFETY_VERDICT can carry, in thousandths of the limit."""

_DRIVERS: Final = ("STEER_DRIVER", "THROTTLE_DRIVER", "BRAKE_DRIVER")
_COMMANDS: Final = ("STEER_COMMAND", "THROTTLE_COMMAND", "BRAKE_COMMAND")
_DATA: Final = FrameKind.DATA
_STATE_ID: Final = SPEC_OF_NAME["SUPERVISOR_STATE"].can_id
_REQUEST_ID: Final = SPEC_OF_NAME["MODE_REQUEST"].can_id
_WATCHED: Final = tuple(
    spec for spec in SPECS.values() if spec.data_id is not None and spec.sender != NAME
)
_NOTHING: Final = Finding(reason=MonitorReason.NONE, severity=Severity.NONE)
_NOT_PROVEN_YET: Final = Finding(reason=MonitorReason.STARTING, severity=Severity.NONE)
_LATE_REASON: Final = {CycleFault.LATE: Reason.LATE, CycleFault.OVERRUNS: Reason.OVERRUNS}


class SafetyMonitor:
    """Node 5. Nothing starts in the constructor; `step` alone changes it."""

    name = NAME
    acceptance: frozenset[int] | None = None

    def __init__(self, vehicle: Vehicle) -> None:
        self._limits = Limits.of(vehicle)
        self._strangers = StrangerLog()
        eds = files("dbc").joinpath("eds", "safety_monitor.eds").read_text(encoding="utf-8")
        self._canopen = CanopenNode(
            NODE_IDS[NAME],
            eds,
            dbc_hash=dbc_hash(),
            vehicle_hash=configuration_hash(vehicle.text),
            parameters={name: getattr(self._limits, name) for name in EXPOSED},
        )
        self._endpoint = Endpoint(
            NAME,
            ["FAILSAFE", *(spec.name for spec in _WATCHED)],
            self._canopen.acceptance,
            identifiers(vehicle.drive_node_ids),
        )
        self._cyclic = [
            self._endpoint.subscription(spec.name) for spec in _WATCHED if spec.timeout_ns
        ]
        self._cycle = CycleWatch()
        self._rates = {
            spec.can_id: RateLimit(spec.min_interval_ns)
            for spec in SPECS.values()
            if spec.min_interval_ns
        }
        self._motion = MotionChecks(self._limits)
        self._following = FollowingChecks(self._limits)
        self._rules = ModeRules()
        self._events: list[Event] = []
        self._now_ns = 0
        self._healthy_since_ns: int | None = None
        self._doubt: tuple[int, Finding] | None = None
        self._requested_ns: int | None = None
        self._mode: Mode | None = None
        self._driving_since_ns: int | None = None
        self._veto: Finding | None = None
        self._veto_ns = 0
        self.verdict = Verdict.DENY
        self.finding = Finding(reason=MonitorReason.STARTING, severity=Severity.DOUBT)

    def step(
        self, now_ns: int, received: Sequence[ReceivedFrame], sensors: MonitorSensors
    ) -> StepOutput[None]:
        """One 10 ms cycle; see `canbus.node`."""
        self._now_ns = now_ns
        self._events = []
        findings: list[Finding] = []
        self._check_cycle(now_ns, findings)
        messages = self._endpoint.take(received)
        frames = self._canopen_frames(now_ns)
        self._check_traffic(received, findings)
        self._check_silence(now_ns, findings)
        self._check_supervisor(messages, findings)
        if sensors.emergency_stop_pressed:
            findings.append(_hazard(MonitorReason.EMERGENCY_STOP))
        self._check_codes(findings)
        motion = self._read_motion()
        findings += self._motion.judge(now_ns, motion)
        errors = NOTHING_TO_FOLLOW
        if self._mode is Mode.AUTOMATIC:  # a controlled stop needs no planner
            self._check_decisions(now_ns, findings)
            errors = self._read_errors(motion)
        findings += self._following.judge(now_ns, errors)
        self._decide(now_ns, findings)
        frames += self._frames(now_ns)
        return StepOutput(frames=frames, actuator=None, events=self._events)

    # Checks ----------------------------------------------------------------------------------

    def _check_cycle(self, now_ns: int, findings: list[Finding]) -> None:
        fault = self._cycle.check(now_ns)
        if fault is not None:
            findings.append(_hazard(MonitorReason.LATE))
            self._event(EventKind.OVERRUN, fault.value)
            self._canopen.emergency(
                now_ns, 0xFF02, 0x81, bytes([ErrorCode.ER2, _LATE_REASON[fault], 1 << 2, 0, 0])
            )

    def _check_traffic(
        self, received: Sequence[ReceivedFrame], findings: list[Finding]
    ) -> None:
        """Rates above the DBC's, frames of nobody's, frames ignored, our own identifier."""
        for item in received:
            frame = item.frame
            limit = self._rates.get(frame.can_id)
            if limit is None or frame.kind is not _DATA:
                continue  # an extended frame's number may be the same, its identifier is not
            share = limit.share(item.arrival_ns)
            if share > 1.0:
                findings.append(_hazard(MonitorReason.RATE_TOO_HIGH, frame.can_id, share))
        if self._endpoint.is_bus_off:  # what was said meanwhile is not known
            findings.append(_hazard(MonitorReason.FRAME_MISSING))
            self._event(EventKind.FRAME, "bus-off")
        for bad in self._endpoint.bad:
            self._event(EventKind.FRAME, f"ignored {bad.frame}: {bad.fault.name.lower()}")
            self._suspect(MonitorReason.BAD_FRAME, bad.frame.can_id)
        for line in self._strangers.lines(self._now_ns, self._endpoint.foreign):
            self._event(EventKind.FOREIGN, line)
        for item in self._endpoint.foreign:
            self._judge_foreign(item.frame, findings)

    def _judge_foreign(self, frame: Frame, findings: list[Finding]) -> None:
        if is_forged(frame):
            findings.append(_hazard(MonitorReason.FOREIGN_SENDER, frame.can_id))
            return
        is_tolerated = self._limits.foreign_id_min <= frame.can_id <= self._limits.foreign_id_max
        if not is_tolerated or frame.kind is not FrameKind.DATA:
            if frame.kind is FrameKind.EXTENDED:  # its identifier does not fit the verdict's
                self._suspect(MonitorReason.UNKNOWN_IDENTIFIER, 0)
                return
            is_own = frame.can_id in SPECS
            reason = MonitorReason.FOREIGN_SENDER if is_own else MonitorReason.UNKNOWN_IDENTIFIER
            self._suspect(reason, frame.can_id)

    def _suspect(self, reason: MonitorReason, identifier: int) -> None:
        doubt = Finding(reason=reason, severity=Severity.DOUBT, identifier=identifier)
        self._doubt = (self._now_ns, doubt)

    def _check_silence(self, now_ns: int, findings: list[Finding]) -> None:
        for wanted in self._cyclic:
            if wanted.newest is None:
                findings.append(_hazard(MonitorReason.FRAME_MISSING, wanted.can_id))
            elif not wanted.is_fresh(now_ns):
                share = (now_ns - wanted.newest.arrival_ns) / wanted.timeout_ns
                findings.append(_hazard(MonitorReason.FRAME_LATE, wanted.can_id, share))

    def _check_supervisor(self, messages: Sequence[Message], findings: list[Finding]) -> None:
        for message in messages:
            can_id = message.can_id
            if can_id == _STATE_ID:
                self._judge_state(message, message.content, findings)
            elif can_id == _REQUEST_ID:
                request: ModeRequest = message.content
                if request.request is Request.ENGAGE:
                    self._requested_ns = message.arrival_ns
            elif can_id == FAILSAFE_ID:  # obeyed by all, always
                findings.append(_hazard(MonitorReason.EMERGENCY_STOP, FAILSAFE_ID))

    def _judge_state(
        self, message: Message, state: SupervisorState, findings: list[Finding]
    ) -> None:
        requested_ns = self._requested_ns
        was_requested = (
            requested_ns is not None and message.arrival_ns - requested_ns <= REQUEST_NS
        )
        broken = self._rules.judge(
            state, was_permitted=self.verdict is Verdict.PERMIT, was_requested=was_requested
        )
        findings += [_hazard(reason, message.can_id) for reason in broken]
        self._mode = state.mode
        if state.mode not in DRIVING:
            self._driving_since_ns = None
        elif self._driving_since_ns is None:
            self._driving_since_ns = message.arrival_ns

    def _check_codes(self, findings: list[Finding]) -> None:
        """A code denies a drive; while driving the node that raised it acts itself."""
        if self._driving_since_ns is not None:
            return
        for name in _DRIVERS:
            message = self._endpoint.newest(name)
            if message is not None and reports_code(message.content):
                reason = MonitorReason.ERROR_REPORTED
                findings.append(
                    Finding(
                        reason=reason, severity=Severity.DOUBT, identifier=message.can_id
                    )
                )

    def _check_decisions(self, now_ns: int, findings: list[Finding]) -> None:
        """The planner's decision must be young, whatever the actuators make of it."""
        state = self._endpoint.get("SUPERVISOR_STATE", SupervisorState)
        assert state is not None and self._driving_since_ns is not None
        told_limit_ms = min(state.decision_age_ms_max, self._limits.command_timeout_s * 1e3)
        limit_ms = told_limit_ms + DECISION_MARGIN_MS
        driving_ms = (now_ns - self._driving_since_ns) / NS_PER_MS
        for name in _COMMANDS:
            message = self._endpoint.newest(name)
            told_ms = math.inf if message is None else message.content.decision_age_ms
            if math.isnan(told_ms):
                told_ms = math.inf
            since_ms = 0.0 if message is None else (now_ns - message.arrival_ns) / NS_PER_MS
            age_ms = min(told_ms + since_ms, driving_ms)
            if age_ms > limit_ms:
                can_id = SPEC_OF_NAME[name].can_id
                share = age_ms / limit_ms
                findings.append(_hazard(MonitorReason.COMMAND_STALE, can_id, share))

    def _read_motion(self) -> Motion:
        steer = self._endpoint.get("STEER_STATUS", SteerStatus)
        throttle = self._endpoint.get("THROTTLE_STATUS", ThrottleStatus)
        brake = self._endpoint.get("BRAKE_STATUS", BrakeStatus)
        command = self._endpoint.get("THROTTLE_COMMAND", ThrottleCommand)
        nan = math.nan
        return Motion(
            wheel_angle_rad=steer.steering_wheel_angle_rad if steer else nan,
            applied_wheel_angle_rad=steer.applied_steering_wheel_angle_rad if steer else nan,
            front_speed_radps=throttle.wheel_speed_radps if throttle else nan,
            applied_speed_radps=throttle.applied_wheel_speed_radps if throttle else nan,
            commanded_speed_radps=command.wheel_speed_radps if command else nan,
            rear_speed_radps=brake.rear_wheel_speed_radps if brake else nan,
            servo_ratio=brake.servo_position_ratio if brake else nan,
            applied_servo_ratio=brake.applied_position_ratio if brake else nan,
        )

    def _read_errors(self, motion: Motion) -> Errors:
        steer = self._endpoint.get("STEER_COMMAND", SteerCommand)
        throttle = self._endpoint.get("THROTTLE_COMMAND", ThrottleCommand)
        brake = self._endpoint.get("BRAKE_COMMAND", BrakeCommand)
        if steer is None or throttle is None or brake is None:
            return NOTHING_TO_FOLLOW
        speed_error_radps = throttle.wheel_speed_radps - motion.front_speed_radps
        return Errors(
            wheel_angle_rad=steer.steering_wheel_angle_rad - motion.wheel_angle_rad,
            speed_mps=speed_error_radps * self._limits.wheel_radius_m,
            brake_ratio=brake.position_ratio - motion.servo_ratio,
        )

    # Verdict ---------------------------------------------------------------------------------

    def _decide(self, now_ns: int, findings: list[Finding]) -> None:
        if self._doubt is not None and now_ns - self._doubt[0] <= DOUBT_NS:
            findings.append(self._doubt[1])
        worst = max(findings, key=lambda finding: finding.severity) if findings else None
        severity = Severity.NONE if worst is None else worst.severity
        if severity is not Severity.NONE:
            self._healthy_since_ns = None
        elif self._healthy_since_ns is None:
            self._healthy_since_ns = now_ns
        phase = self._phase(now_ns)
        if phase is Phase.DRIVING and severity is Severity.HAZARD:
            assert worst is not None
            self._veto, self._veto_ns = worst, now_ns
        verdict = VERDICT_OF[phase][severity]
        self.finding = self._told(verdict, worst)
        if verdict is not self.verdict:
            self._event(EventKind.VERDICT, f"{verdict.name}: {self.finding.reason.name}")
        self.verdict = verdict

    def _phase(self, now_ns: int) -> Phase:
        if self._driving_since_ns is not None:
            if self._veto is not None:
                return Phase.VETOED
            return Phase.DRIVING
        self._veto = None
        since_ns = self._healthy_since_ns
        is_proven = since_ns is not None and now_ns - since_ns >= PROOF_NS
        return Phase.PROVEN if is_proven else Phase.UNPROVEN

    def _told(self, verdict: Verdict, worst: Finding | None) -> Finding:
        """The finding that explains the verdict."""
        if verdict is Verdict.BRAKE and self._veto is not None:
            return self._veto
        if worst is not None:
            return worst
        return _NOTHING if verdict is Verdict.PERMIT else _NOT_PROVEN_YET

    # What is sent ----------------------------------------------------------------------------

    def _canopen_frames(self, now_ns: int) -> list[Frame]:
        frames = self._canopen.step(now_ns, self._endpoint.handed_on)
        for event in self._canopen.poll_events():
            assert event.command is not None  # nothing is writable here: NMT commands alone
            self._event(EventKind.NMT, f"obeyed {event.command.name}")
        return frames

    def _frames(self, now_ns: int) -> list[Frame]:
        frames = []
        if self._canopen.state is NmtState.OPERATIONAL:
            frames.append(self._verdict_frame())
        if self._veto is not None:  # until SUPERVISOR_STATE tells that the drive has ended
            frames.append(self._emergency_frame(now_ns))
        return frames

    def _verdict_frame(self) -> Frame:
        value = min(round(self.finding.share * 1000.0), VALUE_MAX)
        message = SafetyVerdict(
            verdict=self.verdict,
            reason=self.finding.reason,
            identifier=self.finding.identifier,
            value=value,
        )
        return self._endpoint.frame("SAFETY_VERDICT", message)

    def _emergency_frame(self, now_ns: int) -> Frame:
        state = self._endpoint.get("SUPERVISOR_STATE", SupervisorState)
        assert state is not None  # without one nothing has driven
        message = EmergencyBrake(
            code=ErrorCode.ER1,
            reason=Reason.VERDICT_BRAKE,
            cause_age_ms=min((now_ns - self._veto_ns) // NS_PER_MS, 65_535),
            reset_epoch=state.reset_epoch,
        )
        return self._endpoint.frame("SAFETY_MONITOR_EMERGENCY_BRAKE", message)

    def _event(self, kind: EventKind, text: str) -> None:
        self._events.append(Event(time_ns=self._now_ns, node=NAME, kind=kind, text=text))


def _hazard(reason: MonitorReason, identifier: int = 0, share: float = 0.0) -> Finding:
    return Finding(
        reason=reason, severity=Severity.HAZARD, identifier=identifier, share=share
    )
