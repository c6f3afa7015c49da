"""What steer, throttle and brake ECU share: supervision, the node's state, its frames.

A subclass gives the sensors' meaning (`_sense`), the action in each state (`_act`) and its status
message; the order of a step is here, once.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Final, Generic, TypeVar

from canbus.frame import Frame, ReceivedFrame
from canbus.node import EventKind, StepOutput
from dbc.endpoint import FAILSAFE_ID, SPEC_OF_NAME, STOPPING_IDS, Message
from dbc.messages import (
    EmergencyBrake,
    ErrorCode,
    Mode,
    NodeState,
    Reason,
    SupervisorState,
)
from ecus.common.codes import Cause, code_bits, code_flags
from ecus.common.drive_output import DriveOutput
from ecus.common.driver_input import Debounce
from ecus.common.node_state import NODE_STATE_AFTER, SAFE_STATES, NodeEvent
from ecus.common.shell import Shell
from vehicles import Vehicle

DRIVING_MODES: Final = frozenset({Mode.AUTOMATIC, Mode.STOPPING})
"""Modes in which an authorised axis moves by command."""

NOT_BRAKING_CODES: Final = frozenset({ErrorCode.ER0, ErrorCode.ER3})
"""ER0: the frame is ignored. ER3: braking goes on while the car moves (design, error codes)."""

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
CAUSE_AGE_MS_MAX: Final = 65_535
COMMAND_COMING_NS: Final = 50_000_000
"""Younger command frames show that the gateway lives: one of 20 ms may be lost."""
NEVER_NS: Final = 1 << 62

CONTESTED_NS: Final = 100_000_000
"""A SUPERVISOR_STATE frame out of sequence may mean two senders of it. For this long no MANUAL
ends a safe state, and the supervisor's EMERGENCY_BRAKE is believed whatever the mode seems to be:
it always gets through, as it needs no sequence."""
SUPERVISOR_STATE_ID: Final = SPEC_OF_NAME["SUPERVISOR_STATE"].can_id
SUPERVISOR_BRAKE_ID: Final = SPEC_OF_NAME["SUPERVISOR_EMERGENCY_BRAKE"].can_id

SensorsT = TypeVar("SensorsT")
ActuatorT = TypeVar("ActuatorT")


class Told:
    """What the driver messages of all three nodes have in common."""

    __slots__ = ("driver_active", "er", "node_state", "present", "present_codes", "reported")

    def __init__(
        self,
        driver_active: bool,
        node_state: NodeState,
        reported: frozenset[ErrorCode],
        present: frozenset[ErrorCode],
    ) -> None:
        self.driver_active = driver_active
        self.node_state = node_state
        self.reported = reported
        self.present = present
        self.present_codes = code_bits(present)
        self.er = code_flags(reported)


class ActuatorEcu(ABC, Generic[SensorsT, ActuatorT]):
    """One actuator's node. Nothing starts in the constructor; `step` alone changes it.

    Args:
        prefix: the node's name in the DBC's messages: STEER, THROTTLE or BRAKE.
        authorisation: name of the SUPERVISOR_STATE signal that authorises this axis.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        node: str,
        eds: str,
        prefix: str,
        authorisation: str,
        also_subscribed: Sequence[str],
        parameters: Mapping[str, float],
    ) -> None:
        self.name = node
        self._prefix = prefix
        self._status_name = f"{prefix}_STATUS"
        self._driver_name = f"{prefix}_DRIVER"
        self._command_name = f"{prefix}_COMMAND"
        self._authorisation = authorisation
        emergency = [s.name for s in SPEC_OF_NAME.values() if s.can_id in STOPPING_IDS]
        own = f"{prefix}_EMERGENCY_BRAKE"
        subscribed = [name for name in emergency if name != own]
        subscribed += ["FAILSAFE", "SUPERVISOR_STATE", self._command_name, *also_subscribed]
        self.shell = Shell(node, vehicle, eds, subscribed, parameters)
        self.endpoint = self.shell.endpoint
        self.acceptance: frozenset[int] | None = self.shell.acceptance
        self.state = NodeState.STARTING
        self.is_driver_active = False
        self._debounce = Debounce(round(vehicle.times.driver_debounce_s * NS_PER_S))
        self._is_armed = False
        self._active_since_ns = 0
        self._epoch: int | None = None
        self._epoch_told: int | None = None
        self._epoch_ns = -NEVER_NS
        self._is_reset = False
        self._brake_wish: Cause | None = None
        self._supervisor: SupervisorState | None = None
        self._contested_until_ns = -NEVER_NS
        self._told: Told | None = None
        self._driver_due_ns = 0
        self._driver_cycle_ns = SPEC_OF_NAME[self._driver_name].cycle_ns
        self._drives: tuple[DriveOutput, ...] = ()

    def _use_drives(self, *drives: DriveOutput) -> None:
        """This node's motors hang on drives on the bus, not on its outputs."""
        self._drives = drives
        assert self.acceptance is not None
        self.acceptance = self.acceptance.union(*(drive.acceptance for drive in drives))

    # What the subclass gives -----------------------------------------------------------------

    @abstractmethod
    def _sense(self, now_ns: int, sensors: SensorsT) -> bool:
        """Takes the readings in, adds causes; answers whether the driver uses the control."""

    @abstractmethod
    def _act(self, now_ns: int) -> ActuatorT:
        """The actuator's command for the state in force."""

    @abstractmethod
    def _status(self) -> Any:
        """The status message: measured value and echo."""

    @abstractmethod
    def _driver(self, told: Told) -> Any:
        """The driver message: the driver's input, and the given common signals."""

    @abstractmethod
    def _apply_parameters(self, written: Mapping[str, float] | None) -> None:
        """Parameters written by SDO; None: back to those of the vehicle file."""

    @property
    @abstractmethod
    def _command_timeout_ns(self) -> int:
        """The node's own upper bound on a decision's age."""

    # The step --------------------------------------------------------------------------------

    def step(
        self, now_ns: int, received: Sequence[ReceivedFrame], sensors: SensorsT
    ) -> StepOutput[ActuatorT]:
        """One 10 ms cycle; see `canbus.node`. Readings that are NaN count as a broken sensor."""
        shell = self.shell
        messages = shell.begin(now_ns, received)
        self._take_parameters()
        self._hear_supervisor(now_ns)
        for drive in self._drives:
            is_needed = self.state is NodeState.ACTIVE
            self.shell.causes += drive.hear(now_ns, received, is_needed=is_needed)
        is_driver = self._sense(now_ns, sensors)
        self.is_driver_active = self._debounce.update(is_driver, now_ns)
        if self.state is NodeState.ACTIVE:
            self._check_peers(now_ns)
        self._change_state(now_ns, self._event(now_ns, messages))
        shell.report(latch=self.state in SAFE_STATES or self.state is NodeState.ACTIVE)
        actuator = self._act(now_ns)
        frames = shell.finish(self._frames(now_ns))
        for drive in self._drives:  # in every NMT state: a drive that is not told goes on
            frames += drive.frames()
        return StepOutput(frames=frames, actuator=actuator, events=shell.events)

    def _take_parameters(self) -> None:
        if self.shell.is_reset:
            self._apply_parameters(None)
        if self.shell.written:
            self._apply_parameters({event.name: event.value for event in self.shell.written})

    def _hear_supervisor(self, now_ns: int) -> None:
        bad_frames = self.endpoint.bad
        if bad_frames and any(bad.frame.can_id == SUPERVISOR_STATE_ID for bad in bad_frames):
            self._contested_until_ns = now_ns + CONTESTED_NS
        message = self.endpoint.newest("SUPERVISOR_STATE")
        if message is None:
            return
        state = message.content
        assert isinstance(state, SupervisorState)
        self._supervisor = state
        self.shell.apply_mode(state.mode)
        if state.mode not in DRIVING_MODES or not self.shell.is_operational:
            self._is_armed = self.shell.is_operational
        if message.arrival_ns != self._epoch_ns:
            self._hear_epoch(message.arrival_ns, state)

    def _hear_epoch(self, arrival_ns: int, state: SupervisorState) -> None:
        """A reset is what two states in a row tell: a corrupt one may fit its CRC-8 by chance."""
        epoch, before = state.reset_epoch, self._epoch_told
        self._epoch_ns, self._epoch_told = arrival_ns, epoch
        if self._epoch is None:
            self._epoch = epoch
        if epoch == self._epoch or epoch != before:
            return
        self._epoch = epoch
        # A reset leads to MANUAL; a supervisor that restarted counts anew, and resets nobody.
        if state.mode not in (Mode.INIT, Mode.EMERGENCY):
            self.shell.reset_codes()
            self._is_reset = True

    def _check_peers(self, now_ns: int) -> None:
        """While driving: the supervisor must be heard and the planner's decision be young."""
        if not self.endpoint.is_fresh("SUPERVISOR_STATE", now_ns):
            heard_ns = now_ns - (self.endpoint.age_ns("SUPERVISOR_STATE", now_ns) or 0)
            self.shell.add_cause(ErrorCode.ER2, Reason.SUPERVISOR_SILENT, heard_ns)
            return
        assert self._supervisor is not None
        if self._supervisor.mode is Mode.INIT:  # restarted: it knows nothing of this drive
            self.shell.add_cause(ErrorCode.ER2, Reason.SUPERVISOR_SILENT)
        if self._supervisor.mode is not Mode.AUTOMATIC:
            return  # a controlled stop needs no planner
        # An old decision from before this drive is not obeyed (`_valid_command`), nor held
        # against the planner: he has the limit's time to decide, counted from the beginning.
        age_ns = min(now_ns - self._active_since_ns, self._decision_age_ns(now_ns))
        if age_ns > self._decision_limit_ns():
            frame_age_ns = self.endpoint.age_ns(self._command_name, now_ns)
            is_coming = frame_age_ns is not None and frame_age_ns <= COMMAND_COMING_NS
            reason = Reason.PLANNER_SILENT if is_coming else Reason.COMMAND_MISSING
            self.shell.add_cause(ErrorCode.ER5, reason, now_ns - age_ns)

    def _decision_limit_ns(self) -> int:
        assert self._supervisor is not None
        limit_ms: float = self._supervisor.decision_age_ms_max
        return min(self._command_timeout_ns, round(limit_ms) * NS_PER_MS)

    def _decision_age_ns(self, now_ns: int) -> int:
        """Age of the planner's decision: as the frame told, and since the frame came."""
        message = self.endpoint.newest(self._command_name)
        if message is None or math.isnan(message.content.decision_age_ms):
            return NEVER_NS
        told_ms: float = message.content.decision_age_ms
        return round(told_ms) * NS_PER_MS + now_ns - message.arrival_ns

    def _valid_command(self, now_ns: int) -> Any:
        """The newest command if its decision is young enough to be obeyed, else None."""
        if self._decision_age_ns(now_ns) > self._decision_limit_ns():
            return None
        message = self.endpoint.newest(self._command_name)
        assert message is not None  # or its age would be NEVER_NS
        return message.content

    def _event(self, now_ns: int, messages: Sequence[Message]) -> NodeEvent:
        supervisor = self._supervisor
        if supervisor is None:
            return NodeEvent.NOTHING
        is_fresh = self.endpoint.is_fresh("SUPERVISOR_STATE", now_ns)
        # MANUAL may have passed unheard, on a bus that carried nothing: the epoch tells it.
        is_reset = supervisor.mode is Mode.READY and self._is_reset
        is_manual = (supervisor.mode is Mode.MANUAL or is_reset) and is_fresh
        is_contested = now_ns < self._contested_until_ns
        if is_manual and not is_contested:
            return NodeEvent.MANUAL
        if self._is_emergency(supervisor, messages, is_contested):
            return NodeEvent.EMERGENCY
        if is_manual and self.state not in SAFE_STATES:
            return NodeEvent.MANUAL
        causes = self.shell.causes
        if causes and any(cause.code not in NOT_BRAKING_CODES for cause in causes):
            return NodeEvent.OWN_CAUSE
        if not is_fresh:
            return NodeEvent.NOTHING
        if supervisor.mode is Mode.INIT:
            return NodeEvent.NOTHING  # it does not know yet who drives
        is_authorised = getattr(supervisor, self._authorisation)
        if supervisor.mode not in DRIVING_MODES or not is_authorised:
            return NodeEvent.UNAUTHORISED
        is_ready = self._is_armed and self.shell.is_operational
        is_ready = is_ready and all(drive.is_ready for drive in self._drives)
        return NodeEvent.AUTHORISED if is_ready else NodeEvent.NOTHING

    def _is_emergency(
        self, supervisor: SupervisorState, messages: Sequence[Message], is_contested: bool
    ) -> bool:
        if supervisor.mode is Mode.EMERGENCY:
            return True
        if self.state is not NodeState.ACTIVE:  # nothing of ours moves; the supervisor decides
            return is_contested and any(m.can_id == SUPERVISOR_BRAKE_ID for m in messages)
        ids = [message.can_id for message in messages]
        return FAILSAFE_ID in ids or not STOPPING_IDS.isdisjoint(ids)

    def _change_state(self, now_ns: int, event: NodeEvent) -> None:
        before, self.state = self.state, NODE_STATE_AFTER[self.state][event]
        if self.state is before:
            return
        self.shell.add_event(EventKind.STATE, f"{before.name} -> {self.state.name}")
        if self.state is NodeState.ACTIVE:
            self._active_since_ns = now_ns
        if self.state is NodeState.SAFE_ALONE:
            self._brake_wish = next(
                cause for cause in self.shell.causes if cause.code not in NOT_BRAKING_CODES
            )
        if self.state is NodeState.RELEASED:
            self._brake_wish = None
        if before not in SAFE_STATES:
            self._is_reset = False

    # What is sent ----------------------------------------------------------------------------

    def _frames(self, now_ns: int) -> list[Frame]:
        frames = []
        if self._brake_wish is not None:
            self._withdraw_when_heard()
        if self._brake_wish is not None:
            frames.append(self._emergency_frame(now_ns, self._brake_wish))
        if not self.shell.is_operational:
            return frames
        frames.append(self.endpoint.frame(self._status_name, self._status()))
        if self._is_driver_due(now_ns):
            assert self._told is not None
            frames.append(self.endpoint.frame(self._driver_name, self._driver(self._told)))
        return frames

    def _withdraw_when_heard(self) -> None:
        supervisor = self._supervisor
        assert supervisor is not None  # without one the node never became active
        if supervisor.mode is Mode.EMERGENCY:
            self._brake_wish = None

    def _emergency_frame(self, now_ns: int, cause: Cause) -> Frame:
        age_ms = min((now_ns - cause.seen_ns) // NS_PER_MS, CAUSE_AGE_MS_MAX)
        return self.endpoint.frame(
            f"{self._prefix}_EMERGENCY_BRAKE",
            EmergencyBrake(
                code=cause.code,
                reason=cause.reason,
                cause_age_ms=age_ms,
                reset_epoch=self._epoch or 0,
            ),
        )

    def _is_driver_due(self, now_ns: int) -> bool:
        """The driver message is due every cycle time, and at once when anything but the analogue
        value has changed; takes down what it is to tell then."""
        codes, told = self.shell.codes, self._told
        reported, present = codes.reported(now_ns), codes.present(now_ns)
        if (
            told is not None
            and now_ns < self._driver_due_ns
            and told.driver_active == self.is_driver_active
            and told.node_state is self.state
            and told.reported == reported
            and told.present == present
        ):
            return False
        self._told = Told(self.is_driver_active, self.state, reported, present)
        self._driver_due_ns = now_ns + self._driver_cycle_ns - NS_PER_MS
        return True
