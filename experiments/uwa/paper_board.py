"""UWA's low-level controller: a PID on an Arduino Uno, byte commands, a check every 300 ms.

The paper prints neither gains nor a period; the gains are fitted to its Table 3 and Fig. 9, the
period is assumed. The motor driver's and the throttle's PWM have 8 bits (Sections 4.2 and 5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from ecus.brake_servo.ports import BrakeActuator
from ecus.common.limits import clamp
from ecus.steering.ports import SteeringActuator
from ecus.supervisor.ports import SupervisorActuator
from ecus.throttle.ports import DAC_CODE_MAX, DAC_REFERENCE_V, ThrottleActuator, dac_code
from experiments.uah.paper_board import Run, Sample, sample
from simulation.plant.car import Car
from vehicles import load_vehicle

PERIOD_NS: Final = 10_000_000
PERIOD_S: Final = PERIOD_NS * 1e-9
"""Assumption: of the control loop."""
CHECK_NS: Final = 300_000_000
"""UWA 7.1: "checks whether new serial data has been received every 300ms"."""

BYTE_MAX: Final = 255
STEER_MIN, STEER_MAX = -128, 127
"""UWA Table 1."""
PWM_STEPS: Final = 255
SUPPLY_V: Final = 5.0
VOLT_PER_BYTE: Final = SUPPLY_V / PWM_STEPS

COLUMN_RAD_MAX: Final = load_vehicle("fsae_electric").steering.wheel_angle_rad_max
"""Assumption: the whole range of the command is the whole range of the wheel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PidGains:
    """Of the steering: duty per degree of the column."""

    proportional: float
    integral_per_s: float
    derivative_s: float


GAINS: Final = PidGains(proportional=0.030, integral_per_s=0.0133, derivative_s=0.002)
"""Fitted by `experiments.uwa.fit`, with the sensor's zero, to Table 3 and to the R^2 of Fig. 9."""


def steer_byte(column_rad: float) -> int:
    """The command for an angle of the column."""
    return round(clamp(column_rad / COLUMN_RAD_MAX * -STEER_MIN, STEER_MIN, STEER_MAX))


def column_rad(steer: int) -> float:
    """The angle that a command asks for."""
    return steer / -STEER_MIN * COLUMN_RAD_MAX


class UwaBoard:
    """The board in a car of its own, which drives itself.

    Args:
        car: Parked; its relay is closed here.
        gains: Of the steering.
    """

    def __init__(self, car: Car, gains: PidGains = GAINS) -> None:
        self._car = car
        self._gains = gains
        self._brake = self._accelerate = self._steer = 0
        self._is_told = False
        self._is_emergency = False
        self._integral = 0.0
        self._before_deg = math.nan
        self._now_ns = 0
        self._samples: list[Sample] = []
        self._servo: list[float] = []
        car.actuate_supervisor(0, SupervisorActuator(automatic_relay_closed=True))

    def tell(self, *, brake: int = 0, accelerate: int = 0, steer: int = 0) -> None:
        """The three commands of Table 1."""
        assert 0 <= brake <= BYTE_MAX and 0 <= accelerate <= BYTE_MAX
        assert STEER_MIN <= steer <= STEER_MAX
        self._brake, self._accelerate, self._steer = brake, accelerate, steer
        self._is_told = True

    def run_for(self, span_s: float, *, is_told: bool = True) -> None:
        """Drives on; `is_told`: the same commands keep coming."""
        for _ in range(round(span_s / PERIOD_S)):
            self._is_told = self._is_told or is_told
            if self._now_ns % CHECK_NS == 0:
                self._is_emergency = self._is_emergency or not self._is_told
                self._is_told = False
            self._control()
            self._now_ns += PERIOD_NS
            self._car.advance(self._now_ns)
            truth = self._car.truth
            self._samples.append(sample(truth))
            self._servo.append(truth.servo_position_ratio)

    @property
    def now_s(self) -> float:
        """True time."""
        return self._now_ns * 1e-9

    @property
    def run(self) -> Run:
        """All that happened so far."""
        return Run.of(self._samples)

    @property
    def servo_ratio(self) -> list[float]:
        """The brake servo at the same times."""
        return self._servo

    def _control(self) -> None:
        now_ns, car = self._now_ns, self._car
        angle_deg = math.degrees(car.sense_steering(now_ns).column_angle_rad)
        duty = self._pid(math.degrees(column_rad(self._steer)), angle_deg)
        car.actuate_steering(
            now_ns,
            SteeringActuator(
                motor_duty_ratio=round(duty * PWM_STEPS) / PWM_STEPS, motor_enabled=True
            ),
        )
        volts = 0.0 if self._is_emergency else self._accelerate * VOLT_PER_BYTE
        code = round(volts / DAC_REFERENCE_V * DAC_CODE_MAX)
        car.actuate_throttle(
            now_ns, ThrottleActuator(throttle_dac_code=code, regen_dac_code=dac_code(0.0))
        )
        ratio = 1.0 if self._is_emergency else self._brake / BYTE_MAX
        car.actuate_brake(now_ns, BrakeActuator(servo_position_ratio=ratio, servo_powered=True))

    def _pid(self, setpoint_deg: float, angle_deg: float) -> float:
        """Duty, -1 to 1. The derivative is that of the reading; the integral ends at full duty."""
        gains, error_deg = self._gains, setpoint_deg - angle_deg
        before_deg = angle_deg if math.isnan(self._before_deg) else self._before_deg
        self._before_deg = angle_deg
        self._integral += gains.integral_per_s * error_deg * PERIOD_S
        damping = gains.derivative_s * (angle_deg - before_deg) / PERIOD_S
        duty = gains.proportional * error_deg + self._integral - damping
        self._integral = clamp(self._integral, -1.0, 1.0)
        return clamp(duty, -1.0, 1.0)
