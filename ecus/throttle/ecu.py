"""The throttle ECU: traction motor through a DAC, or drives; encoder, pedal, regeneration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from canbus.node import PERIOD_NS
from dbc.messages import (
    BrakeStatus,
    ErrorCode,
    Mode,
    Reason,
    SteerStatus,
    ThrottleDriver,
    ThrottleStatus,
)
from ecus.common.actuator_ecu import NS_PER_S, ActuatorEcu, Told
from ecus.common.encoder import EncoderSpeed
from ecus.common.limits import clamp, readable_ratio
from ecus.common.node_state import SAFE_STATES
from ecus.throttle.control import STANDSTILL_MPS, SpeedLoop, actuator_of
from ecus.throttle.direction import Direction
from ecus.throttle.hill_start import HillPhase, HillStart
from ecus.throttle.mode import ACTION, Situation, ThrottleAction
from ecus.throttle.params import EXPOSED, ThrottleParams
from ecus.throttle.ports import IDLE, ThrottleActuator, ThrottleSensors
from ecus.throttle.wheel_drives import WheelDrives
from vehicles import Vehicle

BRAKING_RATIO_MIN: Final = 0.05
"""Servo position above which the pads touch: no drive torque, frozen integrator."""

BRAKED_RATIO_MIN: Final = 0.5
"""Servo position that counts as braking in an emergency."""

TRAVEL_MARGIN: Final = 1.3
"""The servo is given this multiple of its travel time before it counts as dead."""

REGEN_SPEED_MPS_MIN: Final = 0.3
"""Regeneration ends here: what is left of it could not hold the car."""

FOLLOWING: Final = frozenset({ThrottleAction.FOLLOW, ThrottleAction.STOP})
"""The speed loop drives."""

PEDAL_RATIO_MAX: Final = 1.2
WHEEL_SPEED_RADPS_MAX: Final = 320.0
PERIOD_S: Final = PERIOD_NS * 1e-9


class ThrottleEcu(ActuatorEcu[ThrottleSensors, ThrottleActuator]):
    """Node 3."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._start_params = self.params = ThrottleParams.of(vehicle)
        super().__init__(
            vehicle,
            node="Throttle",
            eds="throttle",
            prefix="THROTTLE",
            authorisation="throttle_authorised",
            also_subscribed=("BRAKE_STATUS", *(("STEER_STATUS",) if vehicle.drives else ())),
            parameters={name: getattr(self.params, name) for name in EXPOSED},
        )
        self.loop = SpeedLoop()
        self._hill = HillStart()
        self._is_asked = False
        self._direction = Direction()
        self._encoder = EncoderSpeed(self.params.encoder_pulses_per_rev)
        self._wheel_speed_radps = 0.0
        self._pedal_ratio = 0.0
        self._safe_since_ns: int | None = None
        self._action = ThrottleAction.IDLE
        self._steering_ratio = vehicle.steering.ratio
        self._wheels: WheelDrives | None = None
        if vehicle.drives is not None:
            self._wheels = WheelDrives(vehicle, vehicle.drives, self.params)
            self._use_drives(*self._wheels.outputs)

    @property
    def _command_timeout_ns(self) -> int:
        return round(self.params.command_timeout_s * NS_PER_S)

    @property
    def _speed_mps(self) -> float:
        return self._wheel_speed_radps * self.params.wheel_radius_m

    def _apply_parameters(self, written: Mapping[str, float] | None) -> None:
        base = self._start_params if written is None else self.params
        self.params = replace(base, **(written or {}))

    def _sense(self, now_ns: int, sensors: ThrottleSensors) -> bool:
        motor_radps = self._encoder.update(
            now_ns, sensors.encoder_count, sensors.encoder_edge_age_s
        )
        wheel_radps = motor_radps / self.params.gear_ratio
        if self._wheels is not None:
            wheel_radps = self._wheels.speed_mps(self._road_wheel_rad) / self.params.wheel_radius_m
        if not math.isnan(wheel_radps):
            wheel_radps = clamp(wheel_radps, -WHEEL_SPEED_RADPS_MAX, WHEEL_SPEED_RADPS_MAX)
        self._wheel_speed_radps = wheel_radps
        self._pedal_ratio = readable_ratio(sensors.pedal_ratio)
        if math.isnan(self._pedal_ratio):
            self.shell.add_cause(ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS)
        return self._pedal_ratio > self.params.driver_pedal_ratio_max

    def _act(self, now_ns: int) -> ThrottleActuator:
        before = self._action
        self._action = ACTION[self.state][self._situation(now_ns)]
        if self._action not in FOLLOWING:
            self._hill.forget()
        if self._action is ThrottleAction.IDLE:
            self._direction.release()
            return IDLE
        if self._action is ThrottleAction.CUT:
            return self._geared(IDLE)
        if self._action is ThrottleAction.REGENERATE:
            if self._wheels is not None:
                self._wheels.brake()
                return IDLE
            if not self._rolls(now_ns):
                return self._geared(IDLE)
            regen_mps2 = self.params.regen_deceleration_mps2_full
            return self._geared(actuator_of(-regen_mps2, self.params))
        if before is ThrottleAction.IDLE:
            self.loop.start(self._speed_mps)
            self._is_asked = False
        brake = None
        if self.endpoint.is_fresh("BRAKE_STATUS", now_ns):
            brake = self.endpoint.get("BRAKE_STATUS", BrakeStatus)
        return self._follow(now_ns, brake)

    def _follow(self, now_ns: int, brake: BrakeStatus | None) -> ThrottleActuator:
        """The speed loop, seen in the direction in which the drive turns."""
        is_servo_braking = brake is None or not brake.servo_position_ratio <= BRAKING_RATIO_MIN
        target_mps = max(self._target_mps(now_ns), -self.params.reverse_speed_mps_max)
        self._direction.update(now_ns, target_mps, is_standing=self._is_standing(brake))
        sign = self._direction.sign
        along_mps, speed_mps = max(sign * target_mps, 0.0), sign * self._speed_mps
        brake_mps2 = 0.0
        if brake is not None:
            brake_mps2 = brake.servo_position_ratio * self.params.brake_mps2_full
        before = self._hill.phase
        phase = self._hill.update(
            now_ns,
            PERIOD_S,
            is_held=is_servo_braking
            and along_mps > 0.0
            and brake is not None
            and brake.applied_position_ratio > BRAKING_RATIO_MIN,
            speed_mps=speed_mps,
            hold_mps2=self.params.hold_mps2,
            brake_mps2=brake_mps2,
        )
        if phase is not HillPhase.NONE:
            is_servo_braking = False
        if phase is HillPhase.PUSH:
            actuator = self.loop.push(self._hill.push_mps2, self._hill.hill_mps2, self.params)
        else:
            if phase is HillPhase.MOVE and before is HillPhase.PUSH:
                self.loop.set_off(self._hill.hill_mps2 - self.params.rolling_resistance_mps2)
            actuator = self.loop.update(
                along_mps,
                speed_mps,
                PERIOD_S,
                self.params,
                is_servo_braking=is_servo_braking,
                brake_mps2=0.0 if phase is HillPhase.NONE else brake_mps2,
            )
        self._is_asked = actuator != IDLE
        if self._wheels is None:
            return self._geared(actuator)
        if not is_servo_braking:  # else no torque against the pads
            self._wheels.follow(sign * self.loop.reference_mps, self._road_wheel_rad)
        return IDLE

    def _geared(self, actuator: ThrottleActuator) -> ThrottleActuator:
        """With the reverse contact as it is: it never switches while the car may move."""
        if self._direction.sign > 0.0:
            return actuator
        return ThrottleActuator(
            throttle_dac_code=actuator.throttle_dac_code,
            regen_dac_code=actuator.regen_dac_code,
            reverse_selected=True,
        )

    def _is_standing(self, brake: BrakeStatus | None) -> bool:
        """Both axles stand, and nothing is asked of the motor; what is not known moves."""
        is_asked = self._is_asked or self._hill.phase is not HillPhase.NONE
        if brake is None or is_asked or self.loop.reference_mps != 0.0:
            return False
        rear_mps = brake.rear_wheel_speed_radps * self.params.wheel_radius_m
        return abs(self._speed_mps) < STANDSTILL_MPS and abs(rear_mps) < STANDSTILL_MPS

    @property
    def _road_wheel_rad(self) -> float:
        """Where the front wheels point; straight on as long as nobody has told."""
        status = self.endpoint.get("STEER_STATUS", SteerStatus)
        if status is None or math.isnan(status.steering_wheel_angle_rad):
            return 0.0
        return status.steering_wheel_angle_rad / self._steering_ratio

    def _target_mps(self, now_ns: int) -> float:
        """The planner's speed; zero in a controlled stop and without a valid command."""
        command = self._valid_command(now_ns)
        if self._action is ThrottleAction.STOP or command is None:
            return 0.0
        wheel_speed_radps: float = command.wheel_speed_radps
        return 0.0 if math.isnan(wheel_speed_radps) else (
            wheel_speed_radps * self.params.wheel_radius_m
        )

    def _situation(self, now_ns: int) -> Situation:
        if self.state not in SAFE_STATES:
            self._safe_since_ns = None
            supervisor = self._supervisor
            is_stopping = supervisor is not None and supervisor.mode is Mode.STOPPING
            return Situation.STOPPING if is_stopping else Situation.NORMAL
        if self._safe_since_ns is None:
            self._safe_since_ns = now_ns
        return Situation.NORMAL if self._is_servo_working(now_ns) else Situation.BRAKE_MISSING

    def _is_servo_working(self, now_ns: int) -> bool:
        """Whether the servo brakes, or still has time to."""
        assert self._safe_since_ns is not None
        status = self.endpoint.get("BRAKE_STATUS", BrakeStatus)
        if status is None or not self.endpoint.is_fresh("BRAKE_STATUS", now_ns):
            return False
        travel_ns = round(TRAVEL_MARGIN * self.params.brake_travel_s * NS_PER_S)
        is_due = now_ns - self._safe_since_ns > travel_ns
        return not is_due or status.servo_position_ratio >= BRAKED_RATIO_MIN

    def _rolls(self, now_ns: int) -> bool:
        """Either way, by either axle: the encoder of one may be dead, or its wheel locked.

        Regeneration opposes the motor's rotation, whichever way the reverse contact points.
        """
        speeds_mps = [self._speed_mps]
        status = self.endpoint.get("BRAKE_STATUS", BrakeStatus)
        if status is not None and self.endpoint.is_fresh("BRAKE_STATUS", now_ns):
            speeds_mps.append(status.rear_wheel_speed_radps * self.params.wheel_radius_m)
        return any(abs(speed_mps) >= REGEN_SPEED_MPS_MIN for speed_mps in speeds_mps)

    def _status(self) -> ThrottleStatus:
        is_following = self._action in FOLLOWING
        reference_mps = self._direction.sign * self.loop.reference_mps
        reference_radps = reference_mps / self.params.wheel_radius_m
        return ThrottleStatus(
            wheel_speed_radps=self._wheel_speed_radps,
            applied_wheel_speed_radps=reference_radps if is_following else math.nan,
        )

    def _driver(self, told: Told) -> ThrottleDriver:
        pedal_ratio = self._pedal_ratio
        if not math.isnan(pedal_ratio):
            pedal_ratio = clamp(pedal_ratio, 0.0, PEDAL_RATIO_MAX)
        er0, er1, er2, er3, er4, er5, er6 = told.er
        return ThrottleDriver(
            pedal_ratio=pedal_ratio,
            driver_active=told.driver_active,
            node_state=told.node_state,
            present_codes=told.present_codes,
            er0=er0,
            er1=er1,
            er2=er2,
            er3=er3,
            er4=er4,
            er5=er5,
            er6=er6,
        )
