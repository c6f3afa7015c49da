"""The motion envelope: speed, steering, lateral acceleration and jerk, and divergence."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from dbc.messages import MonitorReason
from safety_monitor.checks import (
    ANGLE_WINDOW_NS,
    ENVELOPE_HOLD_NS,
    JERK_WINDOW_NS,
    Finding,
    Persistence,
    Slope,
)
from safety_monitor.envelope import Limits
from safety_monitor.verdict import Severity

STEER_STATUS_ID: Final = 0x182
THROTTLE_STATUS_ID: Final = 0x183
BRAKE_STATUS_ID: Final = 0x184

STEERING_DIVERGENCE_NS: Final = 200_000_000
SPEED_DIVERGENCE_NS: Final = 1_000_000_000
AXLE_DIVERGENCE_NS: Final = 200_000_000
BRAKE_DIVERGENCE_NS: Final = 450_000_000
"""Longer than the servo's full travel of 0.29 s and its stick."""
AXLE_SPEED_DIVERGENCE_MPS: Final = 1.0
"""Driven and rear wheels; a locked or spinning axle may differ for a moment."""
WRONG_WAY_MPS: Final = 0.3
"""A car that moves so fast against the setpoint in force, or the command that is not in force yet,
goes the wrong way: a drive that turns round too early or never, a reverse contact that sticks, a
hill that is too steep."""
WRONG_WAY_NS: Final = 100_000_000
_R: Final = MonitorReason


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class Motion:
    """What the status frames say, and THROTTLE_COMMAND; NaN where they say nothing."""

    wheel_angle_rad: Final[float]
    applied_wheel_angle_rad: Final[float]
    front_speed_radps: Final[float]
    applied_speed_radps: Final[float]
    commanded_speed_radps: Final[float]
    rear_speed_radps: Final[float]
    servo_ratio: Final[float]
    applied_servo_ratio: Final[float]

    def __init__(
        self,
        *,
        wheel_angle_rad: float,
        applied_wheel_angle_rad: float,
        front_speed_radps: float,
        applied_speed_radps: float,
        commanded_speed_radps: float,
        rear_speed_radps: float,
        servo_ratio: float,
        applied_servo_ratio: float,
    ) -> None:
        self.wheel_angle_rad = wheel_angle_rad
        self.applied_wheel_angle_rad = applied_wheel_angle_rad
        self.front_speed_radps = front_speed_radps
        self.applied_speed_radps = applied_speed_radps
        self.commanded_speed_radps = commanded_speed_radps
        self.rear_speed_radps = rear_speed_radps
        self.servo_ratio = servo_ratio
        self.applied_servo_ratio = applied_servo_ratio


class Bound:
    """A quantity with its limit, and how long it has been exceeded."""

    __slots__ = ("identifier", "limit", "persistence", "reason")

    def __init__(
        self, reason: MonitorReason, identifier: int, limit: float, hold_ns: int = ENVELOPE_HOLD_NS
    ) -> None:
        self.reason = reason
        self.identifier = identifier
        self.limit = limit
        self.persistence = Persistence(hold_ns)


class MotionChecks:
    """Judges one `Motion` per step."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._rate = Slope(ANGLE_WINDOW_NS)
        self._jerk = Slope(JERK_WINDOW_NS)
        steer, throttle = STEER_STATUS_ID, THROTTLE_STATUS_ID
        self._bounds = (  # in the order of `_values`
            Bound(_R.SPEED, throttle, limits.speed_mps_max),
            Bound(_R.STEERING_ANGLE, steer, limits.wheel_angle_rad_max),
            Bound(_R.STEERING_RATE, steer, limits.wheel_rate_radps_max),
            Bound(_R.LATERAL_ACCELERATION, steer, limits.lateral_acceleration_mps2_max),
            Bound(_R.LATERAL_JERK, steer, limits.lateral_jerk_mps3_max),
            Bound(_R.STEERING_DIVERGENCE, steer, limits.wheel_angle_divergence_rad_max,
                  STEERING_DIVERGENCE_NS),
            Bound(_R.SPEED_DIVERGENCE, throttle, limits.speed_divergence_mps_max,
                  SPEED_DIVERGENCE_NS),
            Bound(_R.BRAKE_DIVERGENCE, BRAKE_STATUS_ID, limits.brake_divergence_ratio_max,
                  BRAKE_DIVERGENCE_NS),
        )
        self._axles = Persistence(AXLE_DIVERGENCE_NS)
        self._wrong_way = Persistence(WRONG_WAY_NS)

    def judge(self, now_ns: int, motion: Motion) -> list[Finding]:
        """Limits exceeded for long enough, and measured values that are not available."""
        findings: list[Finding] = []
        for bound, value in zip(self._bounds, self._values(now_ns, motion), strict=True):
            share = abs(value) / bound.limit
            if bound.persistence.holds(share > 1.0, now_ns):
                findings.append(self._finding(bound.reason, bound.identifier, share))
        for identifier, value in (
            (STEER_STATUS_ID, motion.wheel_angle_rad),
            (THROTTLE_STATUS_ID, motion.front_speed_radps),
            (BRAKE_STATUS_ID, motion.rear_speed_radps),
            (BRAKE_STATUS_ID, motion.servo_ratio),
        ):
            if math.isnan(value):
                findings.append(self._finding(_R.VALUE_NOT_AVAILABLE, identifier, 0.0))
        wrong_way = self._wrong_way_share(motion)
        if self._wrong_way.holds(wrong_way > 1.0, now_ns):
            findings.append(self._finding(_R.SPEED_DIVERGENCE, THROTTLE_STATUS_ID, wrong_way))
        axles = self._axle_share(motion)
        if self._axles.holds(axles > 1.0, now_ns):
            findings.append(self._finding(_R.SPEED_DIVERGENCE, BRAKE_STATUS_ID, axles))
        return findings

    @staticmethod
    def _finding(reason: MonitorReason, identifier: int, share: float) -> Finding:
        return Finding(
            reason=reason, severity=Severity.HAZARD, identifier=identifier, share=share
        )

    def _values(self, now_ns: int, m: Motion) -> list[float]:
        """What is bounded. A setpoint that is not available cannot diverge."""
        limits = self._limits
        radius_m = limits.wheel_radius_m
        road_wheel_rad = m.wheel_angle_rad / limits.steering_ratio
        curvature_per_m = math.tan(road_wheel_rad) / limits.wheelbase_m
        # The rear wheels roll at the speed of the reference point (UAH, after Eq. 9).
        lateral_mps2 = (m.rear_speed_radps * radius_m) ** 2 * curvature_per_m
        speed_mps = max(abs(m.front_speed_radps), abs(m.rear_speed_radps)) * radius_m
        backwards_mps = -min(m.front_speed_radps, m.rear_speed_radps) * radius_m
        return [
            # backwards by the share of its own limit
            max(speed_mps, backwards_mps * limits.speed_mps_max / limits.reverse_speed_mps_max),
            m.wheel_angle_rad,
            self._rate.update(now_ns, m.wheel_angle_rad),
            lateral_mps2,
            self._jerk.update(now_ns, lateral_mps2),
            m.applied_wheel_angle_rad - m.wheel_angle_rad,
            (m.applied_speed_radps - m.front_speed_radps) * radius_m,
            m.applied_servo_ratio - m.servo_ratio,
        ]

    def _wrong_way_share(self, m: Motion) -> float:
        """How fast both axles go against the setpoint in force, or against the command while that
        is still 0; 0 if they do not, or nothing is in force."""
        setpoint_radps = m.applied_speed_radps
        if setpoint_radps == 0.0:
            setpoint_radps = m.commanded_speed_radps
        if not abs(setpoint_radps) > 0.0:  # NaN as well: a driver goes where he likes
            return 0.0
        way = math.copysign(1.0, setpoint_radps)
        against_radps = min(-way * m.front_speed_radps, -way * m.rear_speed_radps)
        if not against_radps > 0.0:
            return 0.0
        return against_radps * self._limits.wheel_radius_m / WRONG_WAY_MPS

    def _axle_share(self, m: Motion) -> float:
        """Driven against rear wheels: an encoder that lies shows here."""
        road_wheel_rad = m.wheel_angle_rad / self._limits.steering_ratio
        rear_from_front = m.front_speed_radps * math.cos(road_wheel_rad)  # UAH Eq. 14
        difference_mps = abs(rear_from_front - m.rear_speed_radps) * self._limits.wheel_radius_m
        return difference_mps / AXLE_SPEED_DIVERGENCE_MPS
