"""An attempt to engage: what stood against it, as the gateway told its planner."""

from __future__ import annotations

from typing import Final

from dbc.messages import HeartbeatState, Inhibit, Mode, Request, SafetyVerdict, SupervisorState
from gateway.requests import REQUEST_PERIOD_NS
from gateway.state import OwnSide, why_not_engaged
from telemetry.why.incident import Refusal

GIVEN_UP_NS: Final = 5 * REQUEST_PERIOD_NS
"""A request that was not repeated for so long is over."""
REFUSALS_MAX: Final = 50

NOBODY: Final = OwnSide(
    heartbeat=HeartbeatState.OPERATIONAL, decision_age_s=0.0, pending_request=Request.ENGAGE,
    emergency_reason=None, foreign_name="",
)
"""What only the gateway knows and a log does not."""


class Attempt:
    """One request to engage, from its first frame on.

    Attributes:
        begin_ns, last_ns: Times of its first and its newest frame.
        sequence: Its number, of MODE_REQUEST.
        mode: When it began.
        refusals: What stood against it, each once, in order.
    """

    def __init__(self, begin_ns: int, sequence: int, mode: Mode | None) -> None:
        self.begin_ns = self.last_ns = begin_ns
        self.sequence = sequence
        self.mode = mode
        self.refusals: list[Refusal] = []

    def is_over(self, now_ns: int) -> bool:
        """Whether the gateway has given it up."""
        return now_ns - self.last_ns > GIVEN_UP_NS

    def hear(
        self, time_ns: int, state: SupervisorState, verdict: SafetyVerdict | None
    ) -> None:
        """A state of the supervisor while the request is pending, and the newest verdict."""
        if state.inhibit in (Inhibit.NONE, Inhibit.NOT_REQUESTED) or state.mode is Mode.AUTOMATIC:
            return
        text = why_not_engaged(state, verdict, 0.0, NOBODY)
        known = {refusal.text for refusal in self.refusals}
        if text not in known and len(self.refusals) < REFUSALS_MAX:
            self.refusals.append(Refusal(time_ns=time_ns, inhibit=state.inhibit, text=text))
