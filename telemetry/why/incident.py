"""What is told of one incident: plain data, times in ns on the clock of the frames."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from dbc.messages import SPECS, ErrorCode, Inhibit, Mode, MonitorReason, Reason
from dbc.spec import MessageSpec
from telemetry.why.window import Heard, Silence


class Kind(StrEnum):
    """What happened."""

    EMERGENCY_BRAKE = "emergency_brake"
    DISENGAGEMENT = "disengagement"
    """The drive ended by wish: a driver's touch, the button, the planner's request."""
    REFUSED_ENGAGEMENT = "refused_engagement"


class CauseKind(StrEnum):
    """What a log can tell of a cause. What it is of is the cause's `subject`."""

    NODE_SILENT = "node_silent"
    """Nothing of a node came any more: dead, hanging, cut off, bus-off look alike."""
    NODE_RESTARTED = "node_restarted"
    NODE_DEAF = "node_deaf"
    """It missed what was on the bus all the time."""
    NODE_LATE = "node_late"
    NODE_BUS_OFF = "node_bus_off"
    MESSAGE_MISSING = "message_missing"
    """One message stayed away while its sender went on."""
    MESSAGE_UNUSABLE = "message_unusable"
    """It came, and its receivers had to ignore it."""
    MESSAGE_REPEATED = "message_repeated"
    """More often than the DBC allows."""
    FOREIGN_SENDER = "foreign_sender"
    """Somebody else sent a node's message."""
    BUS_SILENT = "bus_silent"
    BUS_FLOODED = "bus_flooded"
    POWER_LOST = "power_lost"
    """All fell silent at once, and started anew."""
    PLANNER_SILENT = "planner_silent"
    PLANNER_REQUEST = "planner_request"
    EMERGENCY_STOP = "emergency_stop"
    FAILSAFE = "failsafe"
    NMT_COMMAND = "nmt_command"
    SENSOR = "sensor"
    """A reading that is missing, out of bounds, or that no car can follow."""
    NOT_FOLLOWING = "not_following"
    """An actuator, or the sensor that tells of it, is not where it was sent."""
    ENVELOPE = "envelope"
    MODE_RULE = "mode_rule"
    MOTOR_FAULT = "motor_fault"
    BRAKE_SERVO = "brake_servo"
    DRIVER = "driver"
    BUTTON = "button"
    INHIBITED = "inhibited"
    """What stood against engaging."""
    UNKNOWN = "unknown"
    """The frames do not tell."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """Why.

    Attributes:
        kind: Of cause.
        subject: The node, message, `MESSAGE.signal`, or control; empty: the bus, the planner.
        since_ns: When it began, as far as the bus shows; None: not shown.
        trigger: The frame that shows it, or the absence that does; None: neither.
        text: In words, a whole clause without its time.
    """

    kind: CauseKind
    subject: str
    since_ns: int | None
    trigger: Heard | Silence | None
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A node that wanted the brake.

    Attributes:
        heard: The frame by which it said so.
        node: Who.
        code: Error code; NONE with a mode or a verdict.
        reason: Of an EMERGENCY_BRAKE or EMCY.
        finding: Of a verdict.
        identifier: What the finding is about; 0: nothing in particular.
        since_ns: When its cause began, by its own word.
        is_call: Told to all as a wish to brake; else only a report.
    """

    heard: Heard
    node: str
    code: ErrorCode
    reason: Reason
    finding: MonitorReason
    identifier: int
    since_ns: int
    is_call: bool

    @property
    def time_ns(self) -> int:
        """When it was said."""
        return self.heard.time_ns

    @property
    def about(self) -> MessageSpec | None:
        """The message that a finding is about; None: it names none of ours."""
        return SPECS.get(self.identifier) if self.identifier else None


class Deed(StrEnum):
    """What a node did."""

    CALLED = "called_emergency_brake"
    VERDICT = "gave_verdict_brake"
    MODE = "changed_mode"
    STATE = "changed_state"
    HELD_STEERING = "held_steering"
    COASTED = "let_steering_coast"
    CUT_TORQUE = "cut_torque"
    SET_BRAKE = "set_full_brake"
    BRAKE_FULL = "brake_full"
    STOOD = "stood_still"
    SILENT = "silent"


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """What a node did, and when; `detail` with the number or the name that belongs to it."""

    time_ns: int
    node: str
    deed: Deed
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """A time against what is allowed. `took_ns` None: it has not come within the window."""

    name: str
    took_ns: int | None
    limit_ns: int

    @property
    def is_kept(self) -> bool:
        """Whether it came in time."""
        return self.took_ns is not None and self.took_ns <= self.limit_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """What stood against engaging, since when, in the gateway's own words."""

    time_ns: int
    inhibit: Inhibit
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Incident:
    """One disengagement, emergency brake or refused engagement.

    Attributes:
        kind: Which of them.
        time_ns: Of the first frame that shows it.
        mode_before: None: the log does not show it.
        mode_after: The first other mode; None: none was told within the window.
        mode_heard: The frame that told it.
        causes: The first is the cause; the others came at the same time.
        claims: All that was said, in order; the first call is who said so first.
        actions: What was done, in order.
        budgets: Times against what is allowed.
        refusals: Of a refused engagement, in order.
        codes: Error codes that the supervisor latched.
        remarks: What to know about the evidence: a gap, a log that begins or ends in the middle.
        begin_ns, end_ns: Of the frames that it was judged by.
    """

    kind: Kind
    time_ns: int
    mode_before: Mode | None
    mode_after: Mode | None
    mode_heard: Heard | None
    causes: tuple[Cause, ...]
    claims: tuple[Claim, ...]
    actions: tuple[Action, ...]
    budgets: tuple[Budget, ...]
    refusals: tuple[Refusal, ...]
    codes: tuple[ErrorCode, ...]
    remarks: tuple[str, ...]
    begin_ns: int
    end_ns: int

    @property
    def cause(self) -> Cause:
        """The first one."""
        return self.causes[0]

    @property
    def first_said(self) -> Claim | None:
        """Who called for the brake first; None: nobody."""
        return next((claim for claim in self.claims if claim.is_call), None)
