"""The brake-servo ECU: servo, brake pedal, rear-wheel encoder; ER3."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from canbus.node import PERIOD_NS
from dbc.messages import BrakeDriver, BrakeStatus, ErrorCode, Mode, Reason
from ecus.brake_servo.control import HillHold, RestInputs, ServoRest, approach
from ecus.brake_servo.mode import ACTION, NOT_DRIVEN, BrakeAction, Situation
from ecus.brake_servo.params import EXPOSED, BrakeParams
from ecus.brake_servo.ports import RELEASED, BrakeActuator, BrakeSensors
from ecus.common.actuator_ecu import NS_PER_S, ActuatorEcu, Told
from ecus.common.driver_input import Debounce
from ecus.common.encoder import EncoderSpeed
from ecus.common.limits import clamp, readable_ratio
from ecus.common.node_state import SAFE_STATES
from vehicles import Vehicle

STUCK_RATIO: Final = 0.3
"""A servo this far from where it is sent, for longer than its travel takes, is stuck."""

TRAVEL_MARGIN: Final = 1.3
LOAD_MARGIN_RATIO: Final = 0.02
"""Up to its holding force, and this much, the servo may stay on for ever: its continuous rating."""

STOP_GROWTH_PER_S: Final = 0.1
"""A controlled stop that takes too long, downhill for instance, brakes harder and harder."""

POSITION_RATIO_MAX: Final = 1.2
REAR_SPEED_RADPS_MAX: Final = 200.0
PERIOD_S: Final = PERIOD_NS * 1e-9


class BrakeServoEcu(ActuatorEcu[BrakeSensors, BrakeActuator | None]):
    """Node 4."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._start_params = self.params = BrakeParams.of(vehicle)
        super().__init__(
            vehicle,
            node="BrakeServo",
            eds="brake_servo",
            prefix="BRAKE",
            authorisation="brake_authorised",
            also_subscribed=(),
            parameters={name: getattr(self.params, name) for name in EXPOSED},
        )
        self.rest = ServoRest()
        self._hill = HillHold()
        self._encoder = EncoderSpeed(self.params.wheel_encoder_pulses_per_rev)
        self._stuck = Debounce(round(TRAVEL_MARGIN * self.params.full_travel_s * NS_PER_S))
        self._position_ratio = 0.0
        self._pedal_ratio = 0.0
        self._wheel_speed_radps = 0.0
        self._applied_ratio = 0.0
        self._stopping_since_ns = 0
        self._action = BrakeAction.NONE

    @property
    def _command_timeout_ns(self) -> int:
        return round(self.params.command_timeout_s * NS_PER_S)

    def _apply_parameters(self, written: Mapping[str, float] | None) -> None:
        base = self._start_params if written is None else self.params
        values = dict(written or {})
        if "on_time_s_max" in values:
            values["on_time_s_max"] = max(values["on_time_s_max"], base.on_time_s_min)
        self.params = replace(base, **values)

    def _sense(self, now_ns: int, sensors: BrakeSensors) -> bool:
        self._wheel_speed_radps = clamp(
            self._encoder.update(now_ns, sensors.wheel_count, sensors.wheel_edge_age_s),
            -REAR_SPEED_RADPS_MAX,
            REAR_SPEED_RADPS_MAX,
        )
        speed_mps = self._wheel_speed_radps * self.params.wheel_radius_m
        self._hill.sense(now_ns, PERIOD_S, speed_mps, sensors.slope_rad)
        if self._driving_situation() is not Situation.STOPPING:
            self._stopping_since_ns = now_ns
        self._position_ratio = readable_ratio(sensors.servo_position_ratio)
        pedal_ratio = readable_ratio(sensors.pedal_ratio)
        if math.isnan(self._position_ratio) or math.isnan(pedal_ratio):
            self.shell.add_cause(ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS)
        self._check_servo(now_ns)
        # The servo moves the driver's pedal: what is beyond the servo is the driver.
        beyond = pedal_ratio - clamp(self._position_ratio, 0.0, 1.0)
        self._pedal_ratio = beyond if math.isnan(beyond) else clamp(beyond, 0.0, POSITION_RATIO_MAX)
        return beyond > self.params.driver_pedal_ratio_max

    def _check_servo(self, now_ns: int) -> None:
        is_off = abs(self._position_ratio - self._applied_ratio) > STUCK_RATIO
        is_driven = self._action not in NOT_DRIVEN
        if self._stuck.update(is_driven and is_off, now_ns):
            self.shell.add_cause(ErrorCode.ER1, Reason.SERVO_STUCK, self._stuck.since_ns)
        inputs = RestInputs(
            is_loaded=self._wanted_ratio(now_ns) > self.params.hold_ratio + LOAD_MARGIN_RATIO,
            speed_mps=self._wheel_speed_radps * self.params.wheel_radius_m,
            is_traction_inhibited=self._is_traction_inhibited(now_ns),
        )
        if self.rest.update(now_ns, PERIOD_NS, inputs, self.params.on_time_s_max):
            self.shell.add_cause(ErrorCode.ER3, Reason.SERVO_ON_TOO_LONG)

    def _is_traction_inhibited(self, now_ns: int) -> bool:
        """In a safe state, unless the supervisor is heard to authorise traction."""
        supervisor = self._supervisor
        is_heard = supervisor is not None and self.endpoint.is_fresh("SUPERVISOR_STATE", now_ns)
        is_authorised = is_heard and supervisor is not None and supervisor.throttle_authorised
        return self.state in SAFE_STATES and not is_authorised

    def _wanted_ratio(self, now_ns: int) -> float:
        """Where the servo is to go in the state in force, resting apart."""
        action = ACTION[self.state][self._driving_situation()]
        if action is BrakeAction.FULL:
            return 1.0
        if action is BrakeAction.STOP:
            late_s = (now_ns - self._stopping_since_ns) / NS_PER_S - self.params.controlled_stop_s
            extra_ratio = STOP_GROWTH_PER_S * max(late_s, 0.0)
            return min(self.params.controlled_stop_ratio + extra_ratio, 1.0)
        if action is BrakeAction.FOLLOW:
            command = self._valid_command(now_ns)
            ratio: float = 0.0 if command is None else command.position_ratio
            return 0.0 if math.isnan(ratio) else ratio
        return 0.0

    def _driving_situation(self) -> Situation:
        supervisor = self._supervisor
        is_stopping = supervisor is not None and supervisor.mode is Mode.STOPPING
        return Situation.STOPPING if is_stopping else Situation.NORMAL

    def _act(self, now_ns: int) -> BrakeActuator | None:
        situation = Situation.RESTING if self.rest.is_resting else self._driving_situation()
        self._action = ACTION[self.state][situation]
        if self._action is not BrakeAction.FOLLOW:
            self._hill.forget()
        if self._action in NOT_DRIVEN:
            self._applied_ratio = 0.0
            return RELEASED if self._action is BrakeAction.RELEASE else None
        if self._action is BrakeAction.REST:
            self._applied_ratio = 0.0
            return BrakeActuator(servo_position_ratio=0.0, servo_powered=True)
        wanted = self._wanted_ratio(now_ns)
        if self._action is BrakeAction.FOLLOW:
            wanted = self._hill.update(now_ns, wanted, self._applied_ratio)
        if self._action is BrakeAction.FULL:
            self._applied_ratio = wanted  # as fast as the servo can
        else:
            self._applied_ratio = approach(
                self._applied_ratio, wanted, self.params.position_rate_per_s_max, PERIOD_S
            )
        return BrakeActuator(servo_position_ratio=self._applied_ratio, servo_powered=True)

    def _status(self) -> BrakeStatus:
        position = self._position_ratio
        if not math.isnan(position):
            position = clamp(position, 0.0, POSITION_RATIO_MAX)
        is_released = self._action in NOT_DRIVEN
        return BrakeStatus(
            servo_position_ratio=position,
            applied_position_ratio=math.nan if is_released else self._applied_ratio,
            rear_wheel_speed_radps=self._wheel_speed_radps,
        )

    def _driver(self, told: Told) -> BrakeDriver:
        er0, er1, er2, er3, er4, er5, er6 = told.er
        return BrakeDriver(
            pedal_ratio=self._pedal_ratio,
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

