"""The three command frames: the planner's newest decision, its age, and when they are due."""

from __future__ import annotations

import math
from typing import Final

from canbus.frame import Frame
from canbus.node import PERIOD_NS
from dbc.endpoint import SPEC_OF_NAME, Endpoint
from dbc.messages import (
    BrakeCommand,
    BrakeStatus,
    SteerCommand,
    SupervisorState,
    ThrottleCommand,
    ThrottleStatus,
)
from dbc.spec import SignalRangeError
from gateway.brake import brake_position_ratio
from gateway.commands import COMMAND_PERIOD_NS, NS_PER_MS, NS_PER_S, Decision
from gateway.direction import Rolling, TurningRound
from gateway.kinematics import Kinematics
from gateway.requests import DRIVING_MODES
from vehicles.vehicle import Vehicle, VehicleError

AGE_STEP_NS: Final = 5 * NS_PER_MS
"""Resolution of the decision's age on the wire (DBC); rounded up, never down."""
AGE_MS_MAX: Final = 1270.0
"""The wire's largest age; an older decision is sent as this old."""

COMMAND_INTERVAL_NS_MIN: Final = SPEC_OF_NAME["STEER_COMMAND"].min_interval_ns
JITTER_NS_MAX: Final = 1_000_000
"""How early a cycle may come and still count as on time."""

GRACE_NS: Final = PERIOD_NS - COMMAND_INTERVAL_NS_MIN
"""How late a planner may decide and not find a repetition in its way."""

assert GRACE_NS + COMMAND_INTERVAL_NS_MIN <= PERIOD_NS  # never waits for more than one cycle
assert COMMAND_INTERVAL_NS_MIN + JITTER_NS_MAX < PERIOD_NS < COMMAND_PERIOD_NS


class CommandSender:
    """Holds the planner's newest decision and never refreshes it: its age only grows.

    Raises:
        VehicleError: The vehicle can do more than the DBC's signals can carry.
    """

    def __init__(
        self, vehicle: Vehicle, kinematics: Kinematics, endpoint: Endpoint, planner_period_ns: int
    ) -> None:
        _check_representable(vehicle, kinematics)
        self._vehicle = vehicle
        self._kinematics = kinematics
        self._endpoint = endpoint
        self._planner_period_ns = planner_period_ns
        self._decision: Decision | None = None
        self._decided_ns = 0
        self._turning_round = TurningRound()
        self._is_unsent = False
        self._sent_ns: int | None = None

    def submit(self, decision: Decision, decided_ns: int) -> None:
        """A new decision, made at `decided_ns`."""
        self._decision, self._decided_ns, self._is_unsent = decision, decided_ns, True

    def forget(self) -> None:
        """Drops the decision, so that nothing ever drives on it again."""
        self._decision, self._is_unsent = None, False
        self._turning_round.forget()

    def decision_age_s(self, now_ns: int) -> float:
        """Age of the newest decision; NaN when there is none."""
        return math.nan if self._decision is None else (now_ns - self._decided_ns) / NS_PER_S

    def step(self, now_ns: int) -> list[Frame]:
        """The command frames if they are due: at once with a new decision, else every 20 ms.

        A repetition waits for one cycle more when a new decision is about to come.
        """
        if not self._is_due(now_ns):
            return []
        self._sent_ns, self._is_unsent = now_ns, False
        age_ms = wheel_angle_rad = wheel_speed_radps = brake_ratio = math.nan
        decision = self._decision
        if decision is not None:
            decision = self._turned_round(decision, now_ns)
            age_ms = wire_age_ms(now_ns - self._decided_ns)
            wheel_angle_rad = self._kinematics.steering_wheel_angle_rad(decision.curvature_per_m)
            wheel_speed_radps = self._kinematics.wheel_speed_radps(
                decision.speed_mps, decision.curvature_per_m
            )
            brake_ratio = self._brake_ratio(decision, now_ns)
        steer = SteerCommand(steering_wheel_angle_rad=wheel_angle_rad, decision_age_ms=age_ms)
        throttle = ThrottleCommand(wheel_speed_radps=wheel_speed_radps, decision_age_ms=age_ms)
        brake = BrakeCommand(position_ratio=brake_ratio, decision_age_ms=age_ms)
        frame = self._endpoint.frame
        return [
            frame("STEER_COMMAND", steer),
            frame("THROTTLE_COMMAND", throttle),
            frame("BRAKE_COMMAND", brake),
        ]

    def _is_due(self, now_ns: int) -> bool:
        if self._sent_ns is None:
            return True
        if self._is_unsent:
            return now_ns - self._sent_ns >= COMMAND_INTERVAL_NS_MIN
        if now_ns + PERIOD_NS <= self._sent_ns + COMMAND_PERIOD_NS + JITTER_NS_MAX:
            return False
        # The next cycle would be too late for a repetition. But just before a new decision it would
        # only stand in that one's way, so one cycle is granted to a planner that has been on time.
        expected_ns = self._decided_ns + self._planner_period_ns
        is_imminent = now_ns - GRACE_NS < expected_ns < now_ns + COMMAND_INTERVAL_NS_MIN
        return self._decision is None or not is_imminent

    def _turned_round(self, decision: Decision, now_ns: int) -> Decision:
        """The decision, or one to stand with the same curvature until the car may turn round."""
        supervisor = self._endpoint.get("SUPERVISOR_STATE", SupervisorState)
        if supervisor is not None and supervisor.mode in DRIVING_MODES:
            rolling = self._rolling(now_ns)
            speed_mps = self._turning_round.commanded_mps(now_ns, decision.speed_mps, rolling)
        else:  # the throttle ECU counts from AUTOMATIC on, and nobody holds the car before
            self._turning_round.forget()
            speed_mps = max(decision.speed_mps, 0.0)
        if speed_mps == decision.speed_mps:
            return decision
        return Decision(speed_mps=speed_mps, curvature_per_m=decision.curvature_per_m)

    def _rolling(self, now_ns: int) -> Rolling:
        front_radps = rear_radps = applied_radps = math.nan
        throttle = self._endpoint.get("THROTTLE_STATUS", ThrottleStatus)
        if throttle is not None and self._endpoint.is_fresh("THROTTLE_STATUS", now_ns):
            front_radps = throttle.wheel_speed_radps
            applied_radps = throttle.applied_wheel_speed_radps
        brake = self._endpoint.get("BRAKE_STATUS", BrakeStatus)
        if brake is not None and self._endpoint.is_fresh("BRAKE_STATUS", now_ns):
            rear_radps = brake.rear_wheel_speed_radps
        radius_m = self._vehicle.geometry.wheel_radius_m
        return Rolling(
            front_mps=front_radps * radius_m,
            rear_mps=rear_radps * radius_m,
            applied_mps=applied_radps * radius_m,
        )

    def _brake_ratio(self, decision: Decision, now_ns: int) -> float:
        status = self._endpoint.get("THROTTLE_STATUS", ThrottleStatus)
        if status is None or not self._endpoint.is_fresh("THROTTLE_STATUS", now_ns):
            return brake_position_ratio(self._vehicle, decision, math.nan, math.nan)
        return brake_position_ratio(
            self._vehicle, decision, status.wheel_speed_radps, status.applied_wheel_speed_radps
        )


def wire_age_ms(age_ns: int) -> float:
    """A decision's age as the frames carry it: rounded up to 5 ms, at most 1270 ms."""
    return min(-(-age_ns // AGE_STEP_NS) * (AGE_STEP_NS / NS_PER_MS), AGE_MS_MAX)


def _check_representable(vehicle: Vehicle, kinematics: Kinematics) -> None:
    """Every decision the vehicle allows must fit into the command frames."""
    fastest_radps = kinematics.wheel_speed_radps(
        vehicle.traction.speed_mps_max, vehicle.curvature_per_m_max
    )
    throttle = ThrottleCommand(wheel_speed_radps=fastest_radps, decision_age_ms=0.0)
    steer = SteerCommand(
        steering_wheel_angle_rad=vehicle.steering.wheel_angle_rad_max, decision_age_ms=0.0
    )
    try:
        SPEC_OF_NAME["THROTTLE_COMMAND"].pack(throttle)
        SPEC_OF_NAME["STEER_COMMAND"].pack(steer)
    except SignalRangeError as error:
        raise VehicleError(f"vehicle {vehicle.name} exceeds the DBC: {error}") from error
