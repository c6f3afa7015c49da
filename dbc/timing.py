"""The planner's promise and the limit that follows from it; used on both sides of the bus."""

from __future__ import annotations

from typing import Final

from dbc.messages import SPECS

COMMAND_CYCLE_MS: Final = SPECS[0x202].cycle_ns // 1_000_000
DECISION_PERIODS: Final = 1.5
"""A decision may be half a period late (design, time budget)."""
COMMAND_CYCLES: Final = 2
"""One command frame may be lost."""
DECISION_MARGIN_MS: Final = 15
"""Wire, two 10 ms cycles out of phase, and the age's 5 ms resolution."""
AGE_RESOLUTION_MS: Final = 5

assert COMMAND_CYCLES * COMMAND_CYCLE_MS + DECISION_MARGIN_MS >= 2 * COMMAND_CYCLE_MS  # one loss


def decision_age_limit_ms(planner_period_ms: float) -> int:
    """Largest age of a decision that is obeyed: 85 ms for a planner of 20 ms.

    Rounded up to what the frame can tell (5 ms per bit).
    """
    limit_ms = (
        DECISION_PERIODS * planner_period_ms + COMMAND_CYCLES * COMMAND_CYCLE_MS
        + DECISION_MARGIN_MS
    )
    return -int(-limit_ms // AGE_RESOLUTION_MS) * AGE_RESOLUTION_MS


def planner_period_ms_max(command_timeout_s: float) -> float:
    """The slowest planner whose limit stays within a vehicle's command time-out."""
    timeout_ms = round(command_timeout_s * 1e3) // AGE_RESOLUTION_MS * AGE_RESOLUTION_MS
    spare_ms = timeout_ms - COMMAND_CYCLES * COMMAND_CYCLE_MS - DECISION_MARGIN_MS
    return spare_ms / DECISION_PERIODS
