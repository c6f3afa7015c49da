"""Command against measured: a node whose echo agrees with itself may still not do what it is told.

The echo is compared in `motion.py`. Here the gateway's command is, over the time in which the
vehicle by its own file gets from one end of its range to the other: a node that moves towards its
command cannot stay on one side of it for longer, wherever the command goes meanwhile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from dbc.messages import MonitorReason
from safety_monitor.checks import Finding, Persistence
from safety_monitor.envelope import Limits
from safety_monitor.verdict import Severity

STEER_COMMAND_ID: Final = 0x202
THROTTLE_COMMAND_ID: Final = 0x203
BRAKE_COMMAND_ID: Final = 0x204


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Errors:
    """Command less measured; NaN while there is no command to follow."""

    wheel_angle_rad: Final[float]
    speed_mps: Final[float]
    brake_ratio: Final[float]

    def __init__(self, *, wheel_angle_rad: float, speed_mps: float, brake_ratio: float) -> None:
        self.wheel_angle_rad = wheel_angle_rad
        self.speed_mps = speed_mps
        self.brake_ratio = brake_ratio


NOTHING_TO_FOLLOW: Final = Errors(
    wheel_angle_rad=math.nan, speed_mps=math.nan, brake_ratio=math.nan
)


class Axis:
    """One command with the error it allows, and how long it has been exceeded on either side."""

    __slots__ = ("above", "below", "identifier", "limit", "reason")

    def __init__(
        self, reason: MonitorReason, identifier: int, limit: float, hold_ns: int
    ) -> None:
        self.reason = reason
        self.identifier = identifier
        self.limit = limit
        self.above = Persistence(hold_ns)
        self.below = Persistence(hold_ns)

    def judge(self, now_ns: int, error: float, findings: list[Finding]) -> None:
        """Takes in this step's error."""
        share = error / self.limit
        if self.above.holds(share > 1.0, now_ns):
            findings.append(self._finding(share))
        if self.below.holds(share < -1.0, now_ns):
            findings.append(self._finding(-share))

    def _finding(self, share: float) -> Finding:
        return Finding(
            reason=self.reason, severity=Severity.HAZARD, identifier=self.identifier, share=share
        )


class FollowingChecks:
    """Judges one `Errors` per step; written limits of a node (SDO) do not lengthen the times."""

    def __init__(self, limits: Limits) -> None:
        reasons = MonitorReason
        self._steering = Axis(
            reasons.STEERING_DIVERGENCE, STEER_COMMAND_ID, limits.wheel_angle_divergence_rad_max,
            limits.steering_follow_ns,
        )
        self._speed = Axis(
            reasons.SPEED_DIVERGENCE, THROTTLE_COMMAND_ID, limits.speed_divergence_mps_max,
            limits.speed_follow_ns,
        )
        self._brake = Axis(
            reasons.BRAKE_DIVERGENCE, BRAKE_COMMAND_ID, limits.brake_divergence_ratio_max,
            limits.brake_follow_ns,
        )

    def judge(self, now_ns: int, errors: Errors) -> list[Finding]:
        """Commands that have not been followed for too long. Too much brake is no hazard."""
        findings: list[Finding] = []
        self._steering.judge(now_ns, errors.wheel_angle_rad, findings)
        self._speed.judge(now_ns, errors.speed_mps, findings)
        self._brake.judge(now_ns, max(errors.brake_ratio, 0.0), findings)
        return findings
