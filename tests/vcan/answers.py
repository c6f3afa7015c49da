"""What has to follow on the bus from a cause, and how soon."""

from __future__ import annotations

from canbus.node import NODE_IDS
from dbc.endpoint import ID_OF_NAME
from dbc.messages import (
    Emcy,
    EmergencyBrake,
    ErrorCode,
    Mode,
    MonitorReason,
    Reason,
    Verdict,
)
from tests.vcan.bus_log import Line
from tests.vcan.latency import SILENT_S, within
from tests.vcan.stack import Stack

VERDICT_ID = ID_OF_NAME["SAFETY_VERDICT"]
BRAKE, EMCY = "EMERGENCY_BRAKE", "EMCY"


def emcy(
    stack: Stack, since_s: float, node: str, code: ErrorCode, limit_s: float = 2.0
) -> Line:
    """The node's EMCY frame with this code."""

    def is_it(line: Line) -> bool:
        message = line.content if line.can_id == 0x080 + NODE_IDS[node] else None
        return isinstance(message, Emcy) and message.er_code is code

    return stack.first(since_s, is_it, limit_s)


def latches(
    stack: Stack, cause: str, since_s: float, node: str, code: ErrorCode, budget_s: float
) -> None:
    """The node's EMCY comes in time with this code."""
    within(cause, EMCY, since_s, emcy(stack, since_s, node, code), budget_s)


def brakes_for(
    stack: Stack, cause: str, since_s: float, code: ErrorCode, budget_s: float
) -> EmergencyBrake:
    """EMERGENCY_BRAKE comes in time with this code, and the car brakes to a stand.

    Where several nodes see the cause, whose cycle is next is the chance of their phases. The safety
    monitor has its verdict alone to give; whose code it is, an EMCY tells (`latches`).
    """
    line = stack.first_brake(since_s)
    message = line.content
    assert isinstance(message, EmergencyBrake)
    assert message.code is code or message.reason is Reason.VERDICT_BRAKE, message
    within(cause, BRAKE, since_s, line, budget_s)
    stack.brakes()
    assert stack.mode is Mode.EMERGENCY
    return message


def is_missed(stack: Stack, cause: str, since_s: float, line: Line) -> None:
    """The first EMERGENCY_BRAKE after a node fell silent comes in time and says so."""
    message = line.content
    assert isinstance(message, EmergencyBrake)
    if message.reason is Reason.VERDICT_BRAKE:  # the monitor was faster: it says what is missing
        verdicts = [line.content for line in stack.log(since_s) if line.can_id == VERDICT_ID]
        reason = next(verdict.reason for verdict in verdicts if verdict.verdict is Verdict.BRAKE)
        assert reason is MonitorReason.FRAME_LATE
    else:
        assert message.code is ErrorCode.ER2, message
    within(cause, BRAKE, since_s, line, SILENT_S)
