"""The planner's requests on their way to the supervisor: which one is pending, when it ends.

Rules:
  One request is pending at a time; a new one takes its place, with a new sequence number.
  An emergency stop yields to nothing, and is not withdrawn.
  ENGAGE ends with AUTOMATIC, after 2 s, or withdrawn: nobody is engaged by a forgotten request.
  Withdrawing is told as well (request NONE, a new sequence number), in case it is being granted.
  DISENGAGE ends when the supervisor no longer drives, as it says after having had time to hear it.
  RESET ends with a new reset epoch, or after 1 s.
  EMERGENCY_STOP ends with EMERGENCY; under a driver, who needs none, after 1 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from canbus.frame import Frame
from canbus.node import PERIOD_NS
from dbc.endpoint import FAILSAFE_ID, SPEC_OF_NAME, Endpoint
from dbc.messages import EmergencyBrake, ErrorCode, Mode, ModeRequest, Reason, Request

NS_PER_MS: Final = 1_000_000

REQUEST_PERIOD_NS: Final = 20_000_000
"""MODE_REQUEST is repeated this often while pending (design, identifiers)."""

ENGAGE_PENDING_NS_MAX: Final = 2_000_000_000
OTHER_PENDING_NS_MAX: Final = 1_000_000_000

CONFIRM_NS: Final = 2 * PERIOD_NS
"""The supervisor hears a request in its next cycle: only states later than this are its answer."""

WITHDRAWALS: Final = 3
"""Frames that tell of a withdrawal; two may be lost."""

BRAKE_NS_MAX: Final = 200_000_000
"""An emergency brake nobody acknowledges is repeated for so long: all other nodes have heard it
many times, and brake by themselves when the supervisor is dead."""

SEQUENCE_MODULO: Final = 256
REQUEST_INTERVAL_NS_MIN: Final = SPEC_OF_NAME["MODE_REQUEST"].min_interval_ns
BRAKE_INTERVAL_NS_MIN: Final = SPEC_OF_NAME["GATEWAY_EMERGENCY_BRAKE"].min_interval_ns

DRIVING_MODES: Final = frozenset({Mode.AUTOMATIC, Mode.STOPPING})
"""The modes in which the planner's decisions move the car."""

OBJECTION_MODES: Final = DRIVING_MODES | {Mode.EMERGENCY}
"""The modes in which a stranger's frame is answered by EMERGENCY_BRAKE; in EMERGENCY one frame
speaks against a reset that the planner did not ask for."""

DRIVER_MODES: Final = frozenset({Mode.INIT, Mode.MANUAL})
"""The modes in which a human drives: nothing may brake for him."""

assert REQUEST_INTERVAL_NS_MIN < PERIOD_NS < REQUEST_PERIOD_NS
assert BRAKE_INTERVAL_NS_MIN < PERIOD_NS
assert CONFIRM_NS < OTHER_PENDING_NS_MAX < ENGAGE_PENDING_NS_MAX
assert BRAKE_NS_MAX >= 10 * PERIOD_NS


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class SupervisorView:
    """The newest SUPERVISOR_STATE, however old; None before the first."""

    mode: Final[Mode | None]
    reset_epoch: Final[int | None]
    arrival_ns: Final[int]

    def __init__(self, *, mode: Mode | None, reset_epoch: int | None, arrival_ns: int) -> None:
        self.mode = mode
        self.reset_epoch = reset_epoch
        self.arrival_ns = arrival_ns


class RequestSender:
    """Sends MODE_REQUEST while something is pending."""

    def __init__(self, endpoint: Endpoint, planner_period_ms: int) -> None:
        self._endpoint = endpoint
        self._planner_period_ms = planner_period_ms
        self.pending = Request.NONE
        self._sequence = 0
        self._since_ns = 0
        self._first_sent_ns: int | None = None
        self._sent_ns: int | None = None
        self._epoch: int | None = None
        self._withdrawals_left = 0

    def submit(self, request: Request, now_ns: int, view: SupervisorView) -> bool:
        """Takes a new request, NONE to withdraw; False if an emergency stop goes before it."""
        if self.pending is Request.EMERGENCY_STOP:
            return request is Request.EMERGENCY_STOP
        if request is Request.NONE and self.pending is Request.NONE:
            return True
        self._withdrawals_left = WITHDRAWALS if request is Request.NONE else 0
        self.pending = request
        self._since_ns = now_ns
        self._first_sent_ns = None
        self._epoch = view.reset_epoch
        self._sequence = (self._sequence + 1) % SEQUENCE_MODULO
        return True

    def clear(self) -> None:
        """Forgets what is pending (NMT reset)."""
        self.pending = Request.NONE
        self._withdrawals_left = 0

    def step(self, now_ns: int, view: SupervisorView, *, may_move: bool) -> list[Frame]:
        """The MODE_REQUEST due now, if any. What may lead to motion waits for `may_move`."""
        if self.pending is Request.NONE and not self._withdrawals_left:
            return []
        if self._is_done(now_ns, view):
            self.pending = Request.NONE
            return []
        if not may_move and self.pending in (Request.ENGAGE, Request.RESET):
            return []
        is_first = self._first_sent_ns is None
        interval_ns = REQUEST_INTERVAL_NS_MIN if is_first else REQUEST_PERIOD_NS - PERIOD_NS // 2
        if self._sent_ns is not None and now_ns - self._sent_ns < interval_ns:
            return []
        self._sent_ns = now_ns
        self._withdrawals_left = max(0, self._withdrawals_left - 1)
        if is_first:
            self._first_sent_ns = now_ns
        message = ModeRequest(
            request=self.pending,
            planner_period_ms=self._planner_period_ms,
            sequence=self._sequence,
        )
        return [self._endpoint.frame("MODE_REQUEST", message)]

    def _is_done(self, now_ns: int, view: SupervisorView) -> bool:
        if self.pending is Request.NONE:
            return False
        pending_ns = now_ns - self._since_ns
        if self.pending is Request.ENGAGE and pending_ns >= ENGAGE_PENDING_NS_MAX:
            return True
        if self.pending is Request.RESET and pending_ns >= OTHER_PENDING_NS_MAX:
            return True
        if self._first_sent_ns is None or view.arrival_ns <= self._first_sent_ns:
            return False  # an older state is no answer
        if self.pending is Request.ENGAGE:
            return view.mode is Mode.AUTOMATIC
        if self.pending is Request.DISENGAGE:
            has_heard = view.arrival_ns - self._first_sent_ns >= CONFIRM_NS
            return has_heard and view.mode not in DRIVING_MODES
        if self.pending is Request.RESET:
            return self._epoch is not None and view.reset_epoch != self._epoch
        if view.mode in DRIVER_MODES:
            return pending_ns >= OTHER_PENDING_NS_MAX
        return view.mode is Mode.EMERGENCY


def brake_code(reason: Reason) -> ErrorCode:
    """The code of the gateway's own EMERGENCY_BRAKE."""
    return ErrorCode.ER2 if reason is Reason.SUPERVISOR_SILENT else ErrorCode.ER1


class BrakeSender:
    """Sends FAILSAFE and the gateway's own EMERGENCY_BRAKE."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._reason = Reason.NONE
        self._since_ns: int | None = None
        self._sent_ns: int | None = None
        self._is_failsafe_due = False

    def start(self, reason: Reason, now_ns: int, view: SupervisorView) -> bool:
        """Begins an emergency brake unless a human drives or one is in force already.

        With the reason REQUESTED the global fail-safe command goes out as well. The newest mode
        counts however old it is; before the first one nobody is known to drive, so it brakes.
        """
        is_objection = reason is Reason.FOREIGN_SENDER
        is_in_force = view.mode is Mode.EMERGENCY and not is_objection
        if view.mode in DRIVER_MODES or is_in_force or self._since_ns is not None:
            return False
        self._reason, self._since_ns = reason, now_ns
        self._is_failsafe_due = reason is Reason.REQUESTED
        return True

    def step(self, now_ns: int, view: SupervisorView) -> list[Frame]:
        """The frames due now."""
        if self._since_ns is None:
            return []
        age_ns = now_ns - self._since_ns
        if age_ns > BRAKE_NS_MAX or (view.mode is Mode.EMERGENCY and age_ns > 0):
            self._since_ns = None
            return []
        frames = []
        if self._is_failsafe_due:
            self._is_failsafe_due = False
            frames.append(Frame(FAILSAFE_ID))
        if self._sent_ns is None or now_ns - self._sent_ns >= BRAKE_INTERVAL_NS_MIN:
            self._sent_ns = now_ns
            brake = EmergencyBrake(
                code=brake_code(self._reason),
                reason=self._reason,
                cause_age_ms=age_ns // NS_PER_MS,
                reset_epoch=view.reset_epoch or 0,
            )
            frames.append(self._endpoint.frame("GATEWAY_EMERGENCY_BRAKE", brake))
        return frames
