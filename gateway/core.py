"""The gateway as a node without I/O: decisions in, command frames out, with the decision's age.

The gateway never refreshes a decision. It repeats the last one with a growing age, and the
actuators notice. On leaving AUTOMATIC the decision is forgotten: nothing drives on it later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Final

from canbus.canopen_node import CanopenNode
from canbus.canopen_protocol import CanopenEvent, CanopenEventKind, NmtCommand, NmtState
from canbus.frame import Frame, FrameKind, ReceivedFrame
from canbus.node import NODE_IDS, Event, EventKind, StepOutput
from dbc.database import configuration_hash, dbc_hash
from dbc.endpoint import SPEC_OF_NAME, Endpoint, Message, is_forged, sent_by
from dbc.messages import (
    BrakeStatus,
    EmergencyBrake,
    ErrorCode,
    HeartbeatState,
    Mode,
    Reason,
    Request,
    SteerStatus,
    SupervisorState,
)
from dbc.strangers import StrangerLog
from gateway.command_sender import CommandSender
from gateway.commands import NS_PER_S, Decision, checked_period_ns, promised_period_ms
from gateway.kinematics import Kinematics
from gateway.odometry import Odometry
from gateway.poses import GivenPose
from gateway.report import CodeReport
from gateway.requests import (
    DRIVING_MODES,
    OBJECTION_MODES,
    BrakeSender,
    RequestSender,
    SupervisorView,
    brake_code,
)
from gateway.state import (
    EMERGENCY_SENDER,
    SUBSCRIBED,
    CarState,
    EmergencyReason,
    OwnSide,
    car_state,
    message_name,
)
from vehicles.vehicle import Vehicle

FOREIGN_NS: Final = 1_000_000_000
"""A stranger is remembered for this long after his last frame."""

FOLLOWING_REASONS: Final = frozenset(
    {Reason.NODE_EMERGENCY, Reason.FAILSAFE_FRAME, Reason.ADOPTED, Reason.BRAKING_IN_PROGRESS}
)
"""Reasons that only repeat somebody else's; they do not replace a first-hand one."""


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class PlannerInputs:
    """What the planner did since the last step."""

    decision: Final[Decision | None]
    """A new decision."""
    decided_ns: Final[int]
    """When it was made, on the gateway's clock."""
    request: Final[Request | None]
    """A new request; NONE withdraws the pending one."""
    pose: Final[GivenPose | None]
    """Where the car is, for the odometry to go on from."""

    def __init__(
        self,
        *,
        decision: Decision | None = None,
        decided_ns: int = 0,
        request: Request | None = None,
        pose: GivenPose | None = None,
    ) -> None:
        self.decision = decision
        self.decided_ns = decided_ns
        self.request = request
        self.pose = pose


NO_INPUTS: Final = PlannerInputs()


class GatewayCore:
    """Node 6. May be stepped more often than every 10 ms: at once after a decision, say.

    Raises:
        CommandError: The planner's period is outside what the vehicle allows.
        VehicleError: The vehicle can do more than the DBC's signals can carry.
    """

    def __init__(self, vehicle: Vehicle, planner_period_ns: int) -> None:
        checked_period_ns(vehicle, planner_period_ns / NS_PER_S)
        self.name = "Gateway"
        self.vehicle = vehicle
        self.planner_period_ns = planner_period_ns
        self._kinematics = Kinematics.of(vehicle.geometry, vehicle.steering)
        self._odometry = Odometry(vehicle)
        self._strangers = StrangerLog()
        self._canopen = CanopenNode(
            NODE_IDS[self.name],
            files("dbc").joinpath("eds", "gateway.eds").read_text(encoding="utf-8"),
            dbc_hash=dbc_hash(),
            vehicle_hash=configuration_hash(vehicle.text),
            parameters={"command_timeout_s": vehicle.times.command_timeout_s},
        )
        self._endpoint = Endpoint(self.name, SUBSCRIBED, self._canopen.acceptance)
        self.acceptance: frozenset[int] | None = (
            self._endpoint.acceptance | self._canopen.acceptance
        )
        self._requests = RequestSender(self._endpoint, promised_period_ms(planner_period_ns))
        self._commands = CommandSender(
            vehicle, self._kinematics, self._endpoint, planner_period_ns
        )
        self._brake = BrakeSender(self._endpoint)
        self._report = CodeReport(self._canopen)
        self._view = SupervisorView(mode=None, reset_epoch=None, arrival_ns=0)
        self._emergency_reason: EmergencyReason | None = None
        self._foreign: tuple[int, int] | None = None
        self._events: list[Event] = []
        self._now_ns = 0

    # The step --------------------------------------------------------------------------------

    def step(
        self, now_ns: int, received: Sequence[ReceivedFrame], sensors: PlannerInputs = NO_INPUTS
    ) -> StepOutput[None]:
        """Takes in frames and the planner's inputs; answers the frames to send.

        Args:
            now_ns: Never goes back.
            received: Frames since the last step, in order of arrival.
            sensors: The planner's inputs; a node's usual place for what is not on the bus.
        """
        assert now_ns >= self._now_ns, "time went back"
        self._now_ns = now_ns
        self._events = []
        messages = self._endpoint.take(received)
        frames = self._step_canopen()
        self._judge_traffic()
        for message in messages:
            if message.can_id in _FOLLOWED:
                self._follow(message)
        self._check_supervisor()
        self._take_inputs(sensors)
        is_operational = self._canopen.state is NmtState.OPERATIONAL
        may_move = is_operational and not self._foreign_name()
        frames += self._brake.step(now_ns, self._view)
        frames += self._requests.step(now_ns, self._view, may_move=may_move)
        if is_operational:
            frames += self._commands.step(now_ns)
        self._report.expire(now_ns)
        frames += self._canopen.step(now_ns, ())
        return StepOutput(frames=frames, actuator=None, events=self._events)

    def state(self, now_ns: int) -> CarState:
        """The car as known at `now_ns`."""
        own = OwnSide(
            heartbeat=HeartbeatState(self._canopen.state),
            decision_age_s=self._commands.decision_age_s(now_ns),
            pending_request=self._requests.pending,
            emergency_reason=self._emergency_reason,
            foreign_name=self._foreign_name(),
        )
        odometry = self._odometry.pose(now_ns)
        return car_state(self._endpoint, self._kinematics, odometry, now_ns, own)

    # What comes in ---------------------------------------------------------------------------

    def _step_canopen(self) -> list[Frame]:
        frames = self._canopen.step(self._now_ns, self._endpoint.handed_on)
        for event in self._canopen.poll_events():
            self._obey(event)
        return frames

    def _obey(self, event: CanopenEvent) -> None:
        # The EDS has no writable parameter, so only NMT commands come here.
        assert event.command is not None
        self._log(EventKind.NMT, f"obeyed {event.command.name}")
        if event.command is not NmtCommand.START:
            self._add_cause(ErrorCode.ER2, Reason.NMT_COMMAND)
        if event.kind is CanopenEventKind.RESET_NODE:
            self._commands.forget()
            self._requests.clear()

    def _judge_traffic(self) -> None:
        """Bad frames and strangers: reported; a stranger who commands the driving car stops it."""
        for bad in self._endpoint.bad:
            self._log(EventKind.FRAME, f"ignored {bad.frame}: {bad.fault.name.lower()}")
            self._add_cause(ErrorCode.ER0, Reason.BAD_FRAME)
        for line in self._strangers.lines(self._now_ns, self._endpoint.foreign):
            self._log(EventKind.FOREIGN, line)
        for item in self._endpoint.foreign:
            if item.frame.can_id not in _OWN_IDS or item.frame.kind is FrameKind.EXTENDED:
                continue
            self._foreign = (item.frame.can_id, self._now_ns)
            self._add_cause(ErrorCode.ER1, Reason.FOREIGN_SENDER)
            if is_forged(item.frame) and self._view.mode in OBJECTION_MODES:
                self._start_brake(Reason.FOREIGN_SENDER)
        if self._endpoint.is_bus_off:
            self._add_cause(ErrorCode.ER2, Reason.BUS_OFF)

    def _follow(self, message: Message) -> None:
        """The car's motion, the supervisor's mode, and why others brake."""
        if message.can_id == _STEER_ID:
            steer: SteerStatus = message.content
            self._odometry.steered(message.arrival_ns, steer.steering_wheel_angle_rad)
            return
        if message.can_id == _BRAKE_ID:
            status: BrakeStatus = message.content
            self._odometry.rolled(message.arrival_ns, status.rear_wheel_speed_radps)
            return
        node = EMERGENCY_SENDER.get(message.can_id)
        if node is not None:
            brake: EmergencyBrake = message.content
            self._note_emergency(EmergencyReason(node=node, code=brake.code, reason=brake.reason))
            return
        state: SupervisorState = message.content
        before = self._view
        self._view = SupervisorView(
            mode=state.mode, reset_epoch=state.reset_epoch, arrival_ns=message.arrival_ns
        )
        if state.mode is not before.mode:
            self._log(EventKind.MODE, f"supervisor: {state.mode.name}")
            if before.mode in DRIVING_MODES and state.mode not in DRIVING_MODES:
                self._commands.forget()
            if state.mode is Mode.AUTOMATIC:
                self._emergency_reason = None
                if self._foreign_name():  # while a stranger is heard, nothing of ours asks for it
                    self._start_brake(Reason.FOREIGN_SENDER)
        if before.reset_epoch is not None and state.reset_epoch != before.reset_epoch:
            self._emergency_reason = None

    def _check_supervisor(self) -> None:
        """A planner that cannot know what the car does must not drive it."""
        view = self._view
        if view.mode not in DRIVING_MODES:
            return
        if self._endpoint.is_fresh("SUPERVISOR_STATE", self._now_ns):
            return
        self._add_cause(ErrorCode.ER2, Reason.SUPERVISOR_SILENT)
        self._start_brake(Reason.SUPERVISOR_SILENT)
        self._commands.forget()
        self._view = replace(view, mode=None)

    def _note_emergency(self, reason: EmergencyReason) -> None:
        if self._emergency_reason is None or reason.reason not in FOLLOWING_REASONS:
            self._emergency_reason = reason

    def _take_inputs(self, inputs: PlannerInputs) -> None:
        if inputs.decision is not None:
            assert inputs.decided_ns <= self._now_ns, "a decision from the future"
            self._commands.submit(inputs.decision, inputs.decided_ns)
        if inputs.pose is not None:
            self._odometry.give(inputs.pose)
        if inputs.request is None:
            return
        if not self._requests.submit(inputs.request, self._now_ns, self._view):
            text = f"{inputs.request.name} dropped: an emergency stop is pending"
            self._log(EventKind.MODE, text)
        if inputs.request is Request.EMERGENCY_STOP:
            self._start_brake(Reason.REQUESTED)

    # What is reported ------------------------------------------------------------------------

    def _start_brake(self, reason: Reason) -> None:
        if self._brake.start(reason, self._now_ns, self._view):
            code = brake_code(reason)
            self._note_emergency(EmergencyReason(node=self.name, code=code, reason=reason))

    def _foreign_name(self) -> str:
        if self._foreign is None or self._now_ns - self._foreign[1] > FOREIGN_NS:
            return ""
        return message_name(self._foreign[0])

    def _add_cause(self, code: ErrorCode, reason: Reason) -> None:
        if self._report.add(code, reason, self._now_ns):
            self._log(EventKind.CODE, f"{code.name} {reason.name}")

    def _log(self, kind: EventKind, text: str) -> None:
        self._events.append(Event(time_ns=self._now_ns, node=self.name, kind=kind, text=text))


_SUPERVISOR_ID: Final = SPEC_OF_NAME["SUPERVISOR_STATE"].can_id
_STEER_ID: Final = SPEC_OF_NAME["STEER_STATUS"].can_id
_BRAKE_ID: Final = SPEC_OF_NAME["BRAKE_STATUS"].can_id
_FOLLOWED: Final = frozenset({_SUPERVISOR_ID, _STEER_ID, _BRAKE_ID, *EMERGENCY_SENDER})
_OWN_IDS: Final = sent_by("Gateway")
