"""Who steers the experiments' car: UNICAMP's own controller, ours, and ours without the IMU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from experiments.unicamp.plant import BAJA
from experiments.unicamp.wire import Known, Targets
from gateway.commands import COMMAND_PERIOD_NS
from gateway.curvature_control import CurvatureControl, CurvatureTuning
from gateway.kinematics import Kinematics
from gateway.motion_commands import decide_cmd_vel

KINEMATICS: Final = Kinematics.of(BAJA.geometry, BAJA.steering)
PAPER_PERIOD_NS: Final = 100_000_000
"""UNICAMP 6.1: "produced at a 10 Hz rate". """
PAPER_ANGLE_RAD_MAX: Final = BAJA.steering.sensor_angle_rad_max / BAJA.steering.ratio
"""The paper names no limit: the linkage's end stop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperGains:
    """Of the PID in Fig. 3; the paper prints none."""

    proportional_rad_m: float
    """Angle for an error of the curvature."""
    integral_rad_m_per_s: float
    derivative_rad_m_s: float


class PaperDriver:
    """Fig. 3: angle = atan(L kappa_des) + PID(kappa_des - omega_meas / v_des), at 10 Hz.

    The measured curvature takes the commanded speed, and both rear motors get the same one
    (Section 4), so the tyres do what a differential would. No word of the paper bounds the
    integral; here it stands while the angle is at its end stop.
    """

    period_ns = PAPER_PERIOD_NS

    def __init__(self, gains: PaperGains) -> None:
        self._gains = gains
        self._integral = 0.0
        self._error = 0.0
        self.speed_mps = self.curvature_per_m = 0.0

    def decide(self, known: Known) -> Targets:
        """One cycle."""
        speed = self.speed_mps
        if speed == 0.0 or known.yaw is None:
            return Targets(road_wheel_rad=0.0, left_mps=0.0, right_mps=0.0)
        gains, period_s = self._gains, self.period_ns * 1e-9
        error = self.curvature_per_m - known.yaw.yaw_rate_radps / speed
        step = gains.integral_rad_m_per_s * error * period_s
        change = (error - self._error) / period_s
        self._error = error
        feed_forward = KINEMATICS.road_wheel_angle_rad(self.curvature_per_m)
        feedback = gains.proportional_rad_m * error + gains.derivative_rad_m_s * change
        angle = feed_forward + feedback + self._integral + step
        within = min(max(angle, -PAPER_ANGLE_RAD_MAX), PAPER_ANGLE_RAD_MAX)
        if (angle - within) * step <= 0.0:
            self._integral += step
        return Targets(road_wheel_rad=within, left_mps=speed, right_mps=speed)


class OurDriver:
    """CmdVel through this stack's curvature control and electronic differential.

    Args:
        tuning: None: feed-forward alone.
    """

    period_ns = COMMAND_PERIOD_NS

    def __init__(self, tuning: CurvatureTuning | None) -> None:
        self._control = None if tuning is None else CurvatureControl(BAJA, tuning)
        self.speed_mps = self.curvature_per_m = 0.0

    def decide(self, known: Known) -> Targets:
        """One cycle."""
        yaw_rate = KINEMATICS.yaw_rate_radps(self.speed_mps, self.curvature_per_m)
        decision = decide_cmd_vel(BAJA, speed_mps=self.speed_mps, yaw_rate_radps=yaw_rate)
        if self._control is not None:
            measured = 0.5 * (known.left_mps + known.right_mps)
            decision = self._control.update(known.now_ns, decision, measured, known.yaw)
        wheels = KINEMATICS.rear_wheel_speeds_mps(decision.speed_mps, decision.curvature_per_m)
        return Targets(
            road_wheel_rad=KINEMATICS.road_wheel_angle_rad(decision.curvature_per_m),
            left_mps=wheels.left_mps, right_mps=wheels.right_mps,
        )  # fmt: skip
