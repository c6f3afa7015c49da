"""The monitor's checks: small, each with a memory of its own, each told the time."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

from dbc.messages import (
    BrakeDriver,
    Mode,
    MonitorReason,
    SteerDriver,
    SupervisorState,
    ThrottleDriver,
)
from safety_monitor.verdict import Severity

NS_PER_S: Final = 1_000_000_000

RATE_BURST: Final = 8
"""Frames of one identifier that may arrive together: a receiver 50 ms late finds five or six."""

ANGLE_WINDOW_NS: Final = 50_000_000
"""Span over which the steering rate is measured: sensor noise of 2 mrad makes 0.06 rad/s."""

JERK_WINDOW_NS: Final = 500_000_000
"""ISO 11270 averages lateral jerk over half a second."""

ENVELOPE_HOLD_NS: Final = 30_000_000
"""A limit must be exceeded this long, four readings in a row: one bad one does not brake."""


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Finding:
    """Something a check does not like. `share` is the measured value over its limit."""

    reason: Final[MonitorReason]
    severity: Final[Severity]
    identifier: Final[int]
    share: Final[float]

    def __init__(
        self,
        *,
        reason: MonitorReason,
        severity: Severity,
        identifier: int = 0,
        share: float = 0.0,
    ) -> None:
        self.reason = reason
        self.severity = severity
        self.identifier = identifier
        self.share = share


class Persistence:
    """True once a condition has held for `hold_ns`."""

    __slots__ = ("_since_ns", "hold_ns")

    def __init__(self, hold_ns: int) -> None:
        self.hold_ns = hold_ns
        self._since_ns: int | None = None

    def holds(self, condition: bool, now_ns: int) -> bool:
        """Takes this step's condition in."""
        if not condition:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns >= self.hold_ns


class RateLimit:
    """Leaky bucket over the arrivals of one identifier: no more than one per `interval_ns`."""

    __slots__ = ("_level_ns", "_seen_ns", "capacity_ns", "interval_ns")

    def __init__(self, interval_ns: int) -> None:
        self.interval_ns = interval_ns
        self.capacity_ns = RATE_BURST * interval_ns
        self._level_ns = 0
        self._seen_ns = 0

    def share(self, arrival_ns: int) -> float:
        """Takes one arrival in (times do not go back); how full the bucket is, too full above 1."""
        level_ns = max(self._level_ns - (arrival_ns - self._seen_ns), 0) + self.interval_ns
        self._seen_ns = arrival_ns
        self._level_ns = min(level_ns, self.capacity_ns)  # a flood is over soon after it ends
        return level_ns / self.capacity_ns


class Slope:
    """Mean rate of change over a window of time."""

    __slots__ = ("_points", "window_ns")

    def __init__(self, window_ns: int) -> None:
        self.window_ns = window_ns
        self._points: deque[tuple[int, float]] = deque()

    def update(self, now_ns: int, value: float) -> float:
        """Units of `value` per second; 0 until the window is full, and across a gap (NaN)."""
        points = self._points
        if math.isnan(value):
            points.clear()
            return 0.0
        points.append((now_ns, value))
        while len(points) > 2 and now_ns - points[1][0] >= self.window_ns:
            points.popleft()
        began_ns, began = points[0]
        if now_ns - began_ns < self.window_ns:
            return 0.0
        return (value - began) * NS_PER_S / (now_ns - began_ns)


DRIVING: Final = frozenset({Mode.AUTOMATIC, Mode.STOPPING})

ALLOWED_AFTER: Final[dict[Mode, frozenset[Mode]]] = {
    Mode.INIT: frozenset({Mode.INIT, Mode.MANUAL, Mode.EMERGENCY}),
    Mode.MANUAL: frozenset({Mode.MANUAL, Mode.READY, Mode.INIT}),
    Mode.READY: frozenset({Mode.READY, Mode.MANUAL, Mode.AUTOMATIC, Mode.EMERGENCY, Mode.INIT}),
    Mode.AUTOMATIC: frozenset(
        {Mode.AUTOMATIC, Mode.STOPPING, Mode.READY, Mode.MANUAL, Mode.EMERGENCY}
    ),
    Mode.STOPPING: frozenset({Mode.STOPPING, Mode.READY, Mode.MANUAL, Mode.EMERGENCY}),
    Mode.EMERGENCY: frozenset({Mode.EMERGENCY, Mode.MANUAL}),
}
"""Which mode may follow which, written here a second time: the supervisor is watched, not asked.

One frame may be lost, so what two transitions in a row give is allowed too where it is harmless:
a supervisor that restarts (INIT) is legal only while nothing drives."""
assert set(ALLOWED_AFTER) == set(Mode)

AUTHORISES: Final[dict[Mode, tuple[bool, bool, bool]]] = {
    Mode.INIT: (False, False, False),
    Mode.MANUAL: (False, False, False),
    Mode.READY: (False, False, False),
    Mode.AUTOMATIC: (True, True, True),
    Mode.STOPPING: (True, True, True),
    Mode.EMERGENCY: (True, False, True),
}
"""Steering, throttle, brake: what each mode may authorise at most."""
assert set(AUTHORISES) == set(Mode)


class ModeRules:
    """Judges the sequence of SUPERVISOR_STATE frames."""

    def __init__(self) -> None:
        self._last: SupervisorState | None = None

    def judge(
        self, state: SupervisorState, *, was_permitted: bool, was_requested: bool
    ) -> list[MonitorReason]:
        """Rules this frame breaks.

        Args:
            state: The frame's content.
            was_permitted: Our verdict was PERMIT when the frame came.
            was_requested: The gateway has asked to engage a moment ago.
        """
        broken = []
        last, self._last = self._last, state
        before = None if last is None else last.mode
        if before is not None and state.mode not in ALLOWED_AFTER[before]:
            broken.append(MonitorReason.MODE_RULE)
        begins = state.mode is Mode.AUTOMATIC and before is not Mode.AUTOMATIC
        if begins and not (was_permitted and was_requested and before is Mode.READY):
            broken.append(MonitorReason.MODE_RULE)
        if last is not None and not _keeps_its_word(last, state):
            broken.append(MonitorReason.MODE_RULE)
        given = (state.steering_authorised, state.throttle_authorised, state.brake_authorised)
        if any(g and not may for g, may in zip(given, AUTHORISES[state.mode], strict=True)):
            broken.append(MonitorReason.AUTHORISATION_RULE)
        return broken


def _keeps_its_word(last: SupervisorState, state: SupervisorState) -> bool:
    """A latch never clears by itself; while driving nothing is reset, no limit moves."""
    if last.mode is Mode.EMERGENCY and state.mode is Mode.MANUAL:
        return last.reset_epoch != state.reset_epoch
    if last.mode in DRIVING and state.mode in DRIVING:
        return (last.reset_epoch, last.decision_age_ms_max) == (
            state.reset_epoch, state.decision_age_ms_max
        )
    return True


def reports_code(message: SteerDriver | ThrottleDriver | BrakeDriver) -> bool:
    """Whether a driver frame reports any code but ER0: each denies a drive."""
    return (
        message.er1 or message.er2 or message.er3 or message.er4 or message.er5 or message.er6
    )
