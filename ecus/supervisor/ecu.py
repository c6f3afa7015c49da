"""The supervisor: owns the driving mode, the codes and the judgement of who is alive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from canbus.frame import Frame, ReceivedFrame
from canbus.node import EventKind, StepOutput
from dbc.database import configuration_hash, dbc_hash
from dbc.endpoint import FAILSAFE_ID, SPEC_OF_NAME, STOPPING_IDS, Message
from dbc.messages import (
    SPECS,
    BrakeStatus,
    EmergencyBrake,
    ErrorCode,
    Inhibit,
    Mode,
    NodeState,
    Reason,
    Request,
    SafetyVerdict,
    SupervisorState,
    ThrottleStatus,
)
from dbc.timing import decision_age_limit_ms
from ecus.common.codes import Cause, code_flags
from ecus.common.driver_input import Debounce
from ecus.common.node_state import SAFE_STATES
from ecus.common.shell import Shell
from ecus.supervisor.control import (
    Situation,
    engage_inhibit,
    inhibit,
    reset_inhibit,
)
from ecus.supervisor.drives import DriveStarts
from ecus.supervisor.faults import driving_faults
from ecus.supervisor.mode import AUTHORISED, DRIVING_MODES, MODE_AFTER, RELAY_CLOSED, ModeEvent
from ecus.supervisor.nodes import (
    ACTUATORS,
    HEARTBEATS,
    LIVENESS,
    RESET_BLOCKING,
    Nodes,
)
from ecus.supervisor.panel import Button, Requests
from ecus.supervisor.params import EXPOSED, SupervisorParams
from ecus.supervisor.ports import SupervisorActuator, SupervisorSensors
from ecus.supervisor.standstill import Standstill
from vehicles import Vehicle

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
FOREIGN_NS: Final = 1_000_000_000
"""A frame of nobody's, or a FAILSAFE, denies engagement and reset for this long."""

OBEYED_NS: Final = 30_000_000
"""By then a node has heard the emergency brake and has told its new state."""

RESET_NS: Final = 15_000_000
"""A reset is asked for this long; by then the gateway has objected to one that is not its own."""
OBJECTION_NS: Final = 100_000_000
"""An EMERGENCY_BRAKE of another node speaks against a reset for this long."""

SILENCES: Final = frozenset({Reason.NODE_SILENT, Reason.VERDICT_MISSING})
"""Reasons that only the supervisor finds: it sends their EMCY."""

RESET_EPOCHS: Final = 16
DEFAULT_PLANNER_PERIOD_MS: Final = 20


class SupervisorEcu:
    """Node 1. Nothing starts in the constructor; `step` alone changes it."""

    name = "Supervisor"

    def __init__(self, vehicle: Vehicle) -> None:
        self.params = SupervisorParams.of(vehicle)
        emergency = [
            spec.name
            for spec in SPECS.values()
            if spec.can_id in STOPPING_IDS and spec.sender != self.name
        ]
        subscribed = [
            *emergency,
            "FAILSAFE",
            "MODE_REQUEST",
            *HEARTBEATS.values(),
            *(message for messages in LIVENESS.values() for message in messages),
        ]
        parameters = {name: getattr(self.params, name) for name in EXPOSED}
        self.shell = Shell(
            self.name, vehicle, "supervisor", subscribed, parameters, is_nmt_master=True
        )
        self.endpoint = self.shell.endpoint
        hashes = {1: dbc_hash(), 2: configuration_hash(vehicle.text)}
        self.nodes = Nodes(self.endpoint, hashes)
        self._drives = DriveStarts(vehicle.drive_node_ids)
        self.acceptance: frozenset[int] | None = None  # everything: strangers are reported
        self.mode = Mode.INIT
        self.reset_epoch = 0
        self.inhibit = Inhibit.STARTING
        self._mode_since_ns = 0
        self._button = Button()
        self._requests = Requests()
        self._standstill = Standstill(
            self.params.deceleration_mps2_full, self.params.deceleration_mps2_min
        )
        self._age_limit_ms = decision_age_limit_ms(DEFAULT_PLANNER_PERIOD_MS)
        self._is_period_allowed = True
        self._codes: set[ErrorCode] = set()
        self._foreign_until_ns = 0
        self._failsafe_until_ns = 0
        self._brake_cause: Cause | None = None
        self._reset_asked = Debounce(RESET_NS)
        self._objected_until_ns = 0
        self._told: tuple[object, ...] = ()
        self._state: SupervisorState | None = None

    def step(
        self, now_ns: int, received: Sequence[ReceivedFrame], sensors: SupervisorSensors
    ) -> StepOutput[SupervisorActuator]:
        """One 10 ms cycle; see `canbus.node`."""
        shell = self.shell
        messages = shell.begin(now_ns, received)
        self._take_parameters()
        self.nodes.take(now_ns, messages)
        self._drives.take(received)
        frames = self.nodes.check_configuration(now_ns, received)
        self._watch_strangers(now_ns, messages)
        self._take_request(messages)
        faults = self._faults(now_ns, messages)
        situation = self._situation(now_ns, sensors)
        event = self._event(now_ns, sensors, situation, faults)
        self._change_mode(now_ns, event, faults)
        frames += self._brake_frames(now_ns)
        shell.report(latch=self.mode in DRIVING_MODES or self.mode is Mode.EMERGENCY)
        if self.mode is not situation.mode:
            situation = replace(situation, mode=self.mode)
        self.inhibit = inhibit(situation)
        shell.apply_mode(self.mode)
        frames.append(self._state_frame(now_ns))
        frames += self._starts(now_ns)
        actuator = SupervisorActuator(automatic_relay_closed=RELAY_CLOSED[self.mode])
        return StepOutput(frames=shell.finish(frames), actuator=actuator, events=shell.events)

    # What is seen ----------------------------------------------------------------------------

    def _take_parameters(self) -> None:
        if self.shell.written:
            written: dict[str, Any] = {event.name: event.value for event in self.shell.written}
            self.params = replace(self.params, **written)

    def _watch_strangers(self, now_ns: int, messages: Sequence[Message]) -> None:
        for item in self.endpoint.foreign:
            frame = item.frame
            is_known = frame.can_id in SPECS
            is_tolerated = self.params.foreign_id_min <= frame.can_id <= self.params.foreign_id_max
            if not (is_tolerated and frame.kind == 0) or is_known:
                self._foreign_until_ns = now_ns + FOREIGN_NS
        for message in messages:
            if message.can_id == FAILSAFE_ID:
                self._failsafe_until_ns = now_ns + FOREIGN_NS
            elif message.can_id in STOPPING_IDS:
                self._objected_until_ns = now_ns + OBJECTION_NS

    def _take_request(self, messages: Sequence[Message]) -> None:
        newest = self._requests.take(messages)
        if newest is None or self.mode in DRIVING_MODES:
            return  # the limit is frozen while driving
        limit_ms = decision_age_limit_ms(newest.planner_period_ms)
        self._is_period_allowed = 0 < limit_ms <= self.params.command_timeout_s * 1e3
        if self._is_period_allowed:
            self._age_limit_ms = limit_ms

    def _faults(self, now_ns: int, messages: Sequence[Message]) -> list[Cause]:
        """What calls for the emergency brake while driving."""
        if self.mode not in DRIVING_MODES:
            for watch in self.nodes.watches.values():
                watch.take_boot()
            return []
        since_ns = now_ns - self._mode_since_ns
        faults = driving_faults(now_ns, since_ns, messages, self.nodes, self.endpoint, self.params)
        own = [cause for cause in self.shell.causes if cause.code is not ErrorCode.ER0]
        if self._requests.pending(now_ns) is Request.EMERGENCY_STOP:
            own.append(Cause(code=ErrorCode.ER1, reason=Reason.REQUESTED, seen_ns=now_ns))
        return own + faults

    def _speed_mps(self, now_ns: int) -> float:
        """The faster of driven and rear wheels; NaN when one of them is not known."""
        throttle = self.endpoint.get("THROTTLE_STATUS", ThrottleStatus)
        brake = self.endpoint.get("BRAKE_STATUS", BrakeStatus)
        is_fresh = self.endpoint.are_fresh(("THROTTLE_STATUS", "BRAKE_STATUS"), now_ns)
        if not is_fresh or throttle is None or brake is None:
            return math.nan
        front, rear = abs(throttle.wheel_speed_radps), abs(brake.rear_wheel_speed_radps)
        if math.isnan(front) or math.isnan(rear):
            return math.nan
        return max(front, rear) * self.params.wheel_radius_m

    def _situation(self, now_ns: int, sensors: SupervisorSensors) -> Situation:
        nodes = self.nodes
        speed_mps = self._speed_mps(now_ns)
        verdict = self.endpoint.get("SAFETY_VERDICT", SafetyVerdict)
        is_verdict_fresh = self.endpoint.is_fresh("SAFETY_VERDICT", now_ns)
        is_failsafe = now_ns < self._failsafe_until_ns
        return Situation(
            mode=self.mode,
            alive=nodes.alive,
            heard={name: nodes.is_heard(name, now_ns) for name in nodes.watches},
            operational={name: watch.is_operational for name, watch in nodes.watches.items()},
            configuration_equal={
                name: watch.is_configuration_equal for name, watch in nodes.watches.items()
            },
            node_states=nodes.states,
            codes=self._reported(now_ns),
            blocking_codes=(nodes.present_codes | self._own_codes()) & RESET_BLOCKING,
            verdict=verdict.verdict if verdict is not None and is_verdict_fresh else None,
            is_driver_active=nodes.is_driver_active,
            is_emergency_stop_pressed=sensors.emergency_stop_pressed or is_failsafe,
            has_foreign_frames=now_ns < self._foreign_until_ns,
            is_planner_period_allowed=self._is_period_allowed,
            speed_mps=speed_mps,
            is_standing=self._standstill.update(speed_mps, now_ns),
            engage_speed_mps_max=self.params.engage_speed_mps_max,
        )

    def _own_codes(self) -> frozenset[ErrorCode]:
        """Codes whose cause the supervisor itself has seen in this step."""
        return frozenset(cause.code for cause in self.shell.causes)

    def _reported(self, now_ns: int) -> frozenset[ErrorCode]:
        own = self.shell.codes.reported(now_ns)
        return own | self._codes | self.nodes.reported_codes

    # What follows from it --------------------------------------------------------------------

    def _event(
        self,
        now_ns: int,
        sensors: SupervisorSensors,
        situation: Situation,
        faults: list[Cause],
    ) -> ModeEvent:
        """The readings as one event, highest priority first."""
        pending = self._requests.pending(now_ns)
        is_pushed = self._button.pushed(sensors.button_pressed, now_ns)
        may_reset = self.mode in (Mode.MANUAL, Mode.READY, Mode.EMERGENCY)
        is_asked = pending is Request.RESET
        if self.mode is Mode.EMERGENCY:
            is_sure = self._reset_asked.update(is_asked, now_ns)
            is_asked = is_sure and now_ns >= self._objected_until_ns
        is_reset = is_asked or (is_pushed and self.mode is Mode.EMERGENCY)
        heeds_driver = self.mode is Mode.READY or self.mode in DRIVING_MODES
        ready_ns = round(self.params.ready_timeout_s * NS_PER_S)
        states = set(situation.node_states.values())
        all_seen = all(situation.alive[name] for name in situation.node_states) and (
            len(situation.node_states) == len(ACTUATORS) and NodeState.ACTIVE not in states
        )
        has_driven = states & SAFE_STATES or sensors.automatic_relay_closed
        rules = (
            (has_driven and self.mode is Mode.INIT, ModeEvent.ADOPT),
            (situation.is_emergency_stop_pressed, ModeEvent.EMERGENCY_STOP),
            (faults, ModeEvent.FAULT),
            (situation.is_driver_active and heeds_driver, ModeEvent.DRIVER),
            (
                is_reset and may_reset and reset_inhibit(situation) is Inhibit.NONE,
                ModeEvent.RESET,
            ),
            (is_pushed, ModeEvent.BUTTON),
            (pending is Request.DISENGAGE, ModeEvent.DISENGAGE),
            (situation.is_standing and self.mode is Mode.STOPPING, ModeEvent.STANDSTILL),
            (
                pending is Request.ENGAGE
                and engage_inhibit(situation) is Inhibit.NOT_REQUESTED,
                ModeEvent.ENGAGE,
            ),
            (
                self.mode is Mode.READY and now_ns - self._mode_since_ns > ready_ns,
                ModeEvent.TIMEOUT,
            ),
            (all_seen and sensors.automatic_relay_closed is False, ModeEvent.NODES_SEEN),
        )
        if situation.is_emergency_stop_pressed:
            reason = Reason.EMERGENCY_STOP_INPUT
            if not sensors.emergency_stop_pressed:
                reason = Reason.FAILSAFE_FRAME
            self.shell.add_cause(ErrorCode.ER1, reason)
        for holds, event in rules:
            if holds:
                return event
        return ModeEvent.NOTHING

    def _change_mode(self, now_ns: int, event: ModeEvent, faults: list[Cause]) -> None:
        before, self.mode = self.mode, MODE_AFTER[self.mode][event]
        if event is ModeEvent.RESET:
            self._reset()
        if event in (ModeEvent.RESET, ModeEvent.ENGAGE, ModeEvent.DISENGAGE):
            self._requests.done()
        if self.mode is Mode.EMERGENCY:
            self._codes.update(cause.code for cause in faults)
        if self.mode is before:
            return
        self._mode_since_ns = now_ns
        self.shell.add_event(EventKind.MODE, f"{before.name} -> {self.mode.name}: {event.name}")
        self._brake_cause = None
        if self.mode is not Mode.EMERGENCY:
            return
        if self._requests.pending(now_ns) is Request.EMERGENCY_STOP:
            self._requests.done()
        self._enter_emergency(event, faults)

    def _reset(self) -> None:
        self.reset_epoch = (self.reset_epoch + 1) % RESET_EPOCHS
        self._codes.clear()
        self.shell.reset_codes()

    def _enter_emergency(self, event: ModeEvent, faults: list[Cause]) -> None:
        """Latches the codes and keeps what came first."""
        if event is ModeEvent.ADOPT:
            self.shell.add_cause(ErrorCode.ER1, Reason.ADOPTED)
        causes = faults + self.shell.causes
        # A stranger's EMERGENCY_BRAKE may tell any code; it brakes all the same.
        self._brake_cause = min(causes, key=lambda cause: cause.code is ErrorCode.ER0)
        for cause in faults:
            text = f"emergency brake: {cause.code.name} {cause.reason.name}"
            self.shell.add_event(EventKind.CODE, text)
            if cause.reason in SILENCES:  # the others tell of theirs themselves
                self.shell.causes.append(cause)
        if not any(cause.code is ErrorCode.ER1 for cause in self.shell.causes):
            self.shell.add_cause(ErrorCode.ER1, Reason.BRAKING_IN_PROGRESS)

    # What is sent ----------------------------------------------------------------------------

    def _brake_frames(self, now_ns: int) -> list[Frame]:
        """EMERGENCY_BRAKE: at once, and again while an actuator node that is heard disobeys."""
        cause = self._brake_cause
        if cause is None:
            return []
        since_ns = now_ns - self._mode_since_ns
        states = [state for name, state in self.nodes.states.items() if self.nodes.alive[name]]
        obeys = since_ns <= OBEYED_NS or all(state in SAFE_STATES for state in states)
        if since_ns > 0 and obeys:
            return []
        message = EmergencyBrake(
            code=cause.code,
            reason=cause.reason,
            cause_age_ms=min((now_ns - cause.seen_ns) // NS_PER_MS, 65_535),
            reset_epoch=self.reset_epoch,
        )
        return [self.endpoint.frame("SUPERVISOR_EMERGENCY_BRAKE", message)]

    def _state_frame(self, now_ns: int) -> Frame:
        codes = self._reported(now_ns)
        content = (self.mode, self.reset_epoch, self._age_limit_ms, self.inhibit, codes)
        if content != self._told:
            self._told, self._state = content, self._state_message(codes)
        return self.endpoint.frame("SUPERVISOR_STATE", self._state)

    def _state_message(self, codes: frozenset[ErrorCode]) -> SupervisorState:
        authorised = AUTHORISED[self.mode]
        er0, er1, er2, er3, er4, er5, er6 = code_flags(codes)
        return SupervisorState(
            mode=self.mode,
            steering_authorised="steering" in authorised,
            throttle_authorised="throttle" in authorised,
            brake_authorised="brake" in authorised,
            er0=er0,
            er1=er1,
            er2=er2,
            er3=er3,
            er4=er4,
            er5=er5,
            er6=er6,
            reset_epoch=self.reset_epoch,
            decision_age_ms_max=self._age_limit_ms,
            inhibit=self.inhibit,
        )

    def _starts(self, now_ns: int) -> list[Frame]:
        """NMT starts; not while driving: who stopped then must stay stopped."""
        if self.mode in DRIVING_MODES:
            return []
        starts = [watch.start_frame(now_ns) for watch in self.nodes.watches.values()]
        return [frame for frame in starts if frame is not None] + self._drives.starts(now_ns)


assert SPEC_OF_NAME["SUPERVISOR_STATE"].cycle_ns == 10_000_000
