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


class FollowingChecks:
    """Judges one `Errors` per step; written limits of a node (SDO) do not lengthen the times."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._persistence = {
            (can_id, side): Persistence(hold_ns)
            for can_id, hold_ns in (
                (STEER_COMMAND_ID, limits.steering_follow_ns),
                (THROTTLE_COMMAND_ID, limits.speed_follow_ns),
                (BRAKE_COMMAND_ID, limits.brake_follow_ns),
            )
            for side in (1.0, -1.0)
        }

    def judge(self, now_ns: int, errors: Errors) -> list[Finding]:
        """Commands that have not been followed for too long. Too much brake is no hazard."""
        limits, reasons = self._limits, MonitorReason
        brake_ratio = max(errors.brake_ratio, 0.0)
        axes = (
            (reasons.STEERING_DIVERGENCE, STEER_COMMAND_ID, errors.wheel_angle_rad,
             limits.wheel_angle_divergence_rad_max),
            (reasons.SPEED_DIVERGENCE, THROTTLE_COMMAND_ID, errors.speed_mps,
             limits.speed_divergence_mps_max),
            (reasons.BRAKE_DIVERGENCE, BRAKE_COMMAND_ID, brake_ratio,
             limits.brake_divergence_ratio_max),
        )
        findings = []
        for reason, can_id, error, limit in axes:
            for side in (1.0, -1.0):
                share = side * error / limit
                if self._persistence[can_id, side].holds(share > 1.0, now_ns):
                    findings.append(
                        Finding(
                            reason=reason, severity=Severity.HAZARD, identifier=can_id, share=share
                        )
                    )
        return findings
