"""The steer ECU: steering motor or drive, angle sensor, driver's torque; ER4 and ER6."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from canbus.node import PERIOD_NS
from dbc.messages import (
    BrakeStatus,
    ErrorCode,
    Reason,
    SteerDriver,
    SteerStatus,
    ThrottleStatus,
)
from ecus.common.actuator_ecu import NS_PER_S, ActuatorEcu, Told
from ecus.common.limits import clamp
from ecus.common.node_state import SAFE_STATES
from ecus.steering.control import SteeringLoop
from ecus.steering.drive import SteeringDrive
from ecus.steering.mode import ACTION, SteerAction
from ecus.steering.params import EXPOSED, SteeringParams
from ecus.steering.ports import COAST, SteeringActuator, SteeringSensors
from vehicles import Vehicle

HOLD_SPEED_MPS_MIN: Final = 0.5
"""Below this the wheel is let go in a safe state (design, safe alone)."""

_SPEED_SOURCES: Final = ("THROTTLE_STATUS", "BRAKE_STATUS")

TORQUE_NM_MAX: Final = 40.0
"""What STEER_DRIVER can carry."""

_FAILURES: Final = frozenset({ErrorCode.ER4, ErrorCode.ER6})

PERIOD_S: Final = PERIOD_NS * 1e-9


class SteeringEcu(ActuatorEcu[SteeringSensors, SteeringActuator]):
    """Node 2."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._start_params = self.params = SteeringParams.of(vehicle)
        super().__init__(
            vehicle,
            node="Steering",
            eds="steering",
            prefix="STEER",
            authorisation="steering_authorised",
            also_subscribed=_SPEED_SOURCES,
            parameters={name: getattr(self.params, name) for name in EXPOSED},
        )
        self.loop = SteeringLoop()
        self._angle_rad = math.nan
        self._torque_nm = 0.0
        self._rate_before_radps = 0.0
        self._is_failed = False
        self._hold_rad: float | None = None
        self._hold_since_ns = 0
        self._action = SteerAction.COAST
        self._drive: SteeringDrive | None = None
        if vehicle.drives is not None:
            self._drive = SteeringDrive(vehicle, vehicle.drives)
            self._use_drives(self._drive)

    @property
    def _command_timeout_ns(self) -> int:
        return round(self.params.command_timeout_s * NS_PER_S)

    def _apply_parameters(self, written: Mapping[str, float] | None) -> None:
        base = self._start_params if written is None else self.params
        values = dict(written or {})
        if "wheel_angle_rad_max" in values:  # beyond it the sensor would count as broken (ER6)
            values["wheel_angle_rad_max"] = min(
                values["wheel_angle_rad_max"],
                base.sensor_angle_rad_max - abs(base.zero_rad),
            )
        self.params = replace(base, **values)

    def _sense(self, now_ns: int, sensors: SteeringSensors) -> bool:
        angle_rad = sensors.column_angle_rad
        if not abs(angle_rad) <= self.params.sensor_angle_rad_max:  # NaN included
            self.shell.add_cause(ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS)
            angle_rad = math.nan
        if math.isnan(sensors.driver_torque_nm):
            self.shell.add_cause(ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS)
        if sensors.motor_fault:
            self.shell.add_cause(ErrorCode.ER4, Reason.MOTOR_FAULT)
        causes = self.shell.causes
        self._is_failed = bool(causes) and any(cause.code in _FAILURES for cause in causes)
        self._angle_rad = angle_rad = angle_rad - self.params.zero_rad
        self.loop.measure(angle_rad, PERIOD_S)
        if self._drive is not None:
            self._drive.measure(angle_rad)
        # The motor turns the driver's wheel as well: what it takes to speed that up is not him.
        acceleration = (self.loop.rate_radps - self._rate_before_radps) / PERIOD_S
        self._rate_before_radps = self.loop.rate_radps
        inertia_nm = self.params.wheel_inertia_kgm2 * acceleration
        self._torque_nm = sensors.driver_torque_nm + inertia_nm
        return abs(self._torque_nm) > self.params.driver_torque_nm_max

    def _act(self, now_ns: int) -> SteeringActuator:
        before = self._action
        self._update_hold(now_ns)
        self._action = ACTION[self.state][self._hold_rad is not None]
        if self._action is SteerAction.COAST or math.isnan(self._angle_rad):
            return COAST
        if before is SteerAction.COAST:
            self.loop.start(self._angle_rad)
        if self._action is SteerAction.FOLLOW:
            command = self._valid_command(now_ns)
            wanted_rad = self.loop.reference_rad if command is None else (
                command.steering_wheel_angle_rad
            )
            if math.isnan(wanted_rad):
                wanted_rad = self.loop.reference_rad
            self._hold_rad = self.loop.reference_rad
            self._hold_since_ns = now_ns
        else:
            assert self._hold_rad is not None
            wanted_rad = self._hold_rad
        duty = self.loop.update(wanted_rad, PERIOD_S, self.params)
        if self._drive is not None:  # it follows the reference with loops of its own
            self._drive.turn_to(self.loop.reference_rad)
            return COAST
        return SteeringActuator(motor_duty_ratio=duty, motor_enabled=True)

    def _update_hold(self, now_ns: int) -> None:
        """Gives up holding: not in a safe state, failed, the driver's hand, slow, or too long."""
        if self._hold_rad is None:
            return
        is_over = now_ns - self._hold_since_ns > round(self.params.hold_s_max * NS_PER_S)
        if (
            self.state not in SAFE_STATES
            or self._is_failed
            or self.is_driver_active
            or is_over
            or self._is_slow(now_ns)
        ):
            self._hold_rad = None

    def _is_slow(self, now_ns: int) -> bool:
        """Both axles below 0.5 m/s for certain: one may be locked, or its speed unknown."""
        throttle = self.endpoint.get("THROTTLE_STATUS", ThrottleStatus)
        brake = self.endpoint.get("BRAKE_STATUS", BrakeStatus)
        is_known = all(self.endpoint.is_fresh(name, now_ns) for name in _SPEED_SOURCES)
        if throttle is None or brake is None or not is_known:
            return False
        slow_radps = HOLD_SPEED_MPS_MIN / self.params.wheel_radius_m
        return (
            abs(throttle.wheel_speed_radps) < slow_radps
            and abs(brake.rear_wheel_speed_radps) < slow_radps
        )

    def _status(self) -> SteerStatus:
        is_coasting = self._action is SteerAction.COAST
        return SteerStatus(
            steering_wheel_angle_rad=self._angle_rad,
            applied_steering_wheel_angle_rad=math.nan if is_coasting else self.loop.reference_rad,
        )

    def _driver(self, told: Told) -> SteerDriver:
        torque_nm = self._torque_nm
        if not math.isnan(torque_nm):
            torque_nm = clamp(torque_nm, -TORQUE_NM_MAX, TORQUE_NM_MAX)
        er0, er1, er2, er3, er4, er5, er6 = told.er
        return SteerDriver(
            torque_nm=torque_nm,
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
