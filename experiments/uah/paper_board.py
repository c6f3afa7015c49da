"""UAH's controller: two PI loops at 10 Hz on one board (Sections 4.5 and 4.6), on our plant.

As in the paper: setpoints and measurements in whole degrees, no derivative, no limit on the
integral (Eq. 4-8), the wheel's speed as encoder pulses per 100 ms, one output per 100 ms that the
motor driver and the DAC hold. Without a setpoint for 1 s the car stops and the wheel is centred.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from ecus.brake_servo.ports import BrakeActuator
from ecus.steering.ports import SteeringActuator
from ecus.supervisor.ports import SupervisorActuator
from ecus.throttle.ports import ThrottleActuator, dac_code
from experiments.response import FloatArray, StepFigures, step_figures
from simulation.plant.car import Car
from simulation.plant.params import PlantParams
from simulation.plant.state import Truth
from telemetry.recording import STANDSTILL_MPS

PERIOD_NS: Final = 100_000_000
PERIOD_S: Final = PERIOD_NS * 1e-9
REFRESH_NS: Final = 10_000_000
"""The held outputs are renewed this often, since our plant's watchdogs want it; UAH had none."""
SILENCE_NS_MAX: Final = 1_000_000_000
"""UAH 4.5: no setpoint for one second stops the car and brings the wheel to zero."""

BEFORE_S: Final = 0.5
"""So long before a step the wheel's angle is averaged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperGains:
    """Of the two loops; the paper prints none, these were fitted to its step responses."""

    steering_duty_per_deg: float
    steering_duty_per_deg_s: float
    steering_duty_max: float
    """Of the motor driver's PWM: the wheel is to turn smoothly."""
    throttle_per_degps: float
    throttle_per_deg: float


def deg_per_pulse(plant: PlantParams) -> float:
    """Of a front wheel, for a pulse of the motor's encoder."""
    return 360.0 / (plant.sensors.motor_pulses_per_rev * plant.traction.gear_ratio)


class PaperPi:
    """Eq. 4-6 and 8, the derivative left out."""

    def __init__(self, proportional: float, integral: float) -> None:
        self._proportional = proportional
        self._integral_gain = integral
        self._integral = 0.0

    def update(self, reference: float, measure: float) -> float:
        """The control value of one period."""
        error = reference - measure
        self._integral += error * self._integral_gain * PERIOD_S
        return error * self._proportional + self._integral


Sample = tuple[float, float, float, float, float]
"""Time, angle of the steering column, speed, position; true ones, SI units."""


def sample(truth: Truth) -> Sample:
    """Of the car now."""
    return (truth.time_ns * 1e-9, truth.column_angle_rad, truth.speed_mps, truth.pose.x_m,
            truth.pose.y_m)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """What the car did, at the true times of the samples, each of shape (N,)."""

    time_s: FloatArray
    column_angle_rad: FloatArray
    speed_mps: FloatArray
    x_m: FloatArray
    y_m: FloatArray

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> Self:
        """From what was noted, at least one sample."""
        time_s, column_angle_rad, speed_mps, x_m, y_m = np.array(samples).T
        return cls(time_s=time_s, column_angle_rad=column_angle_rad, speed_mps=speed_mps,
                   x_m=x_m, y_m=y_m)  # fmt: skip

    @property
    def moving(self) -> Run:
        """The part in which the car moves."""
        kept = np.abs(self.speed_mps) > STANDSTILL_MPS
        return Run(**{field.name: getattr(self, field.name)[kept] for field in fields(self)})

    def after(self, start_s: float) -> NDArray[np.bool_]:
        """Which samples come after a step."""
        return self.time_s > start_s + 1e-9

    def steering_deg(self, start_s: float) -> FloatArray:
        """The wheel's way since a step, degrees: an error of its sensor's zero is no response."""
        before = ~self.after(start_s) & (self.time_s > start_s - BEFORE_S)
        zero_rad = float(self.column_angle_rad[before].mean())
        return np.asarray(np.degrees(self.column_angle_rad - zero_rad))

    def steering(self, start_s: float, step_rad: float, band: float) -> StepFigures:
        """Figures of a step of the steering wheel, in degrees."""
        after = self.after(start_s)
        return step_figures(
            self.time_s[after] - start_s, self.steering_deg(start_s)[after],
            math.degrees(step_rad), band,
        )  # fmt: skip

    def speed(self, start_s: float, step_mps: float, band: float) -> StepFigures:
        """Figures of a step of the speed from standstill, in m/s."""
        after = self.after(start_s)
        return step_figures(self.time_s[after] - start_s, self.speed_mps[after], step_mps, band)


class PaperBoard:
    """The board in a car of its own.

    Args:
        car: Parked; its relay is closed here, as the paper's switch does.
        gains: Of both loops.
    """

    def __init__(self, car: Car, gains: PaperGains) -> None:
        self._car = car
        self._duty_max = gains.steering_duty_max
        self._steering = PaperPi(gains.steering_duty_per_deg, gains.steering_duty_per_deg_s)
        self._speed = PaperPi(gains.throttle_per_degps, gains.throttle_per_deg)
        self._deg_per_pulse = deg_per_pulse(car.params)
        self._count = 0
        self._setpoint_deg = 0
        self._setpoint_degps = 0
        self._told_ns = 0
        self._now_ns = 0
        self._measured_deg = self._measured_degps = 0
        self._duty = 0.0
        self._throttle = 0.0
        self._samples: list[Sample] = []
        car.actuate_supervisor(0, SupervisorActuator(automatic_relay_closed=True))

    def tell(self, wheel_rad: float, wheel_radps: float) -> None:
        """A setpoint over the serial line: steering wheel and front wheel, in whole degrees."""
        self._setpoint_deg = round(math.degrees(wheel_rad))
        self._setpoint_degps = round(math.degrees(wheel_radps))
        self._told_ns = self._now_ns

    def run_until(self, true_ns: int, is_told: bool = True) -> None:
        """Drives on; `is_told`: the same setpoint keeps coming, as from a planner that lives."""
        while self._now_ns < true_ns:
            if is_told:
                self._told_ns = self._now_ns
            if self._now_ns % PERIOD_NS == 0:
                self._control(self._now_ns)
            self._refresh(self._now_ns)
            self._now_ns += REFRESH_NS
            self._car.advance(self._now_ns)
            self._samples.append(sample(self._car.truth))

    @property
    def run(self) -> Run:
        """All that happened so far."""
        return Run.of(self._samples)

    @property
    def measured(self) -> tuple[float, float]:
        """What the board reports: steering wheel, rad, and front wheel, rad/s."""
        return math.radians(self._measured_deg), math.radians(self._measured_degps)

    def _control(self, now_ns: int) -> None:
        if now_ns - self._told_ns > SILENCE_NS_MAX:
            self._setpoint_deg = self._setpoint_degps = 0
        angle_rad = self._car.sense_steering(now_ns).column_angle_rad
        count = self._car.sense_throttle(now_ns).encoder_count
        speed_degps = round((count - self._count) * self._deg_per_pulse / PERIOD_S)
        self._count = count
        self._measured_deg, self._measured_degps = round(math.degrees(angle_rad)), speed_degps
        duty = self._steering.update(self._setpoint_deg, self._measured_deg)
        self._duty = min(self._duty_max, max(-self._duty_max, duty))
        self._throttle = self._speed.update(self._setpoint_degps, speed_degps)

    def _refresh(self, now_ns: int) -> None:
        car = self._car
        car.actuate_steering(
            now_ns, SteeringActuator(motor_duty_ratio=self._duty, motor_enabled=True)
        )
        car.actuate_throttle(
            now_ns,
            ThrottleActuator(
                throttle_dac_code=dac_code(self._throttle), regen_dac_code=dac_code(-self._throttle)
            ),
        )
        car.actuate_brake(now_ns, BrakeActuator(servo_position_ratio=0.0, servo_powered=False))
