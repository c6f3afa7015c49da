"""What makes a driving car brake, one by one, with the time the design gives it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import partial

from bench.limits import axles_diverge, speed_diverges, steering_diverges
from bench.rig import NS_PER_MS, NS_PER_S, PLANNER_PERIOD_NS, Rig
from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame
from canbus.node import NODE_IDS
from canbus.timing import bits_time_ns, frame_bits_max
from dbc.codec import Decoded, decode, encode
from dbc.endpoint import FAILSAFE_ID, SPEC_OF_NAME
from dbc.messages import Request
from dbc.protection import COUNTER_MODULO
from dbc.timing import decision_age_limit_ms
from safety_monitor.motion import (
    AXLE_DIVERGENCE_NS,
    SPEED_DIVERGENCE_NS,
    STEERING_DIVERGENCE_NS,
)
from vehicles import Vehicle

SENSED_NS = 20 * NS_PER_MS
SILENT_NS = 75 * NS_PER_MS
PLANNER_MARGIN_NS = 15 * NS_PER_MS
"""The design's time budget, from the cause to EMERGENCY_BRAKE on the bus."""


class Origin(Enum):
    """From when the time counts."""

    CAUSE = "cause"
    FRAME = "end of the stranger's frame"
    DECISION = "the planner's last decision"
    LIMIT = "limit exceeded on the bus"


class Budget(Enum):
    """Which of the design's budgets holds."""

    SENSED = "sensed"
    SILENT = "silent"
    PLANNER = "planner silent"
    MONITOR = "monitor"


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """One cause of an emergency brake."""

    name: str
    budget: Budget
    begin: Callable[[Rig], None]
    origin: Origin = Origin.CAUSE
    watch_s: float = 1.0
    """How long to wait for the brake."""
    is_heard: bool = True
    """False when no frame can get out."""
    exceeds: Callable[[Rig], bool] | None = None
    """With `Origin.LIMIT`: whether what the status frames say is outside the monitor's limit."""
    hold_ns: int = 0
    """How long the monitor lets the limit be exceeded, by the vehicle file's own words."""


def wire_ns(vehicle: Vehicle) -> int:
    """The longest frame that may be under way, and EMERGENCY_BRAKE itself: none outranks it."""
    return 2 * bits_time_ns(frame_bits_max(8), round(vehicle.bus.bitrate_bps))


def bus_budget_ns(cause: Cause, vehicle: Vehicle) -> int:
    """From the origin to the end of the first EMERGENCY_BRAKE."""
    if cause.budget is Budget.SILENT:
        return SILENT_NS
    if cause.budget is Budget.PLANNER:
        limit_ms = decision_age_limit_ms(PLANNER_PERIOD_NS / NS_PER_MS)
        return limit_ms * NS_PER_MS + PLANNER_MARGIN_NS
    return cause.hold_ns + SENSED_NS + wire_ns(vehicle)


def brake_budget_ns(cause: Cause, vehicle: Vehicle) -> int:
    """From the origin to 90 % brake: the servo's whole travel on top."""
    return bus_budget_ns(cause, vehicle) + round(vehicle.brake.full_travel_s * NS_PER_S)


# Beginnings --------------------------------------------------------------------------------------


def _set_fault(name: str, value: object, rig: Rig) -> None:
    setattr(rig.car.faults, name, value)


def _press_emergency_stop(rig: Rig) -> None:
    rig.car.driver.emergency_stop_pressed = True


def _inject(frame: Frame, rig: Rig) -> None:
    rig.world.inject(frame)


def _forge(message: str, rig: Rig) -> None:
    """A stranger continues a node's own sequence: content, counter and CRC are right."""
    _, newest = rig.newest[SPEC_OF_NAME[message].can_id]
    decoded = decode(newest)
    assert isinstance(decoded, Decoded) and decoded.counter is not None
    counter = (decoded.counter + 1) % COUNTER_MODULO
    rig.world.inject(encode(decoded.spec, decoded.message, counter))


def _kill(name: str, rig: Rig) -> None:
    rig.world.stations[name].is_alive = False


def _mute(name: str, rig: Rig) -> None:
    rig.world.stations[name].is_mute = True


def _silence_bus(rig: Rig) -> None:
    rig.world.wire.filters.append(lambda true_ns, sender, frame, receiver: False)


def _silence_planner(rig: Rig) -> None:
    rig.is_silent = True


def _request_stop(rig: Rig) -> None:
    rig.request(Request.EMERGENCY_STOP)


def _steer_with(fault: str, rig: Rig) -> None:
    _set_fault(fault, True, rig)
    rig.curvature_per_m = -rig.curvature_per_m


def _accelerate_without_motor(rig: Rig) -> None:
    rig.car.faults.traction_dead = True
    rig.speed_mps = rig.world.vehicle.traction.speed_mps_max


# All of them -------------------------------------------------------------------------------------


def _fault(name: str, fault: str, value: object) -> Cause:
    return Cause(name=name, budget=Budget.SENSED, begin=partial(_set_fault, fault, value))


def _sensed() -> list[Cause]:
    forged = ("SUPERVISOR_STATE", "STEER_STATUS", "THROTTLE_STATUS", "BRAKE_STATUS",
              "SAFETY_VERDICT", "STEER_COMMAND")
    return [
        Cause(name="emergency-stop input", budget=Budget.SENSED, begin=_press_emergency_stop),
        Cause(name="FAILSAFE frame", budget=Budget.SENSED, origin=Origin.FRAME,
              begin=partial(_inject, Frame(FAILSAFE_ID))),
        Cause(name="planner asks for the emergency brake", budget=Budget.SENSED,
              begin=_request_stop),
        _fault("ER4: steering motor fault", "steering_motor_fault", True),
        _fault("ER6: steering angle NaN", "steering_angle_override_rad", math.nan),
        _fault("ER6: steering angle out of bounds", "steering_angle_override_rad", 12.0),
        _fault("ER6: steering torque NaN", "steering_torque_override_nm", math.nan),
        _fault("throttle pedal NaN", "throttle_pedal_override_ratio", math.nan),
        _fault("brake pedal NaN", "brake_pedal_override_ratio", math.nan),
        _fault("servo position NaN", "servo_position_override_ratio", math.nan),
        *(
            Cause(name=f"forged {message}", budget=Budget.SENSED, origin=Origin.FRAME,
                  begin=partial(_forge, message))
            for message in forged
        ),
    ]


def _silent() -> list[Cause]:
    causes = []
    for name in NODE_IDS:
        budget = Budget.PLANNER if name == "Gateway" else Budget.SILENT
        causes += [
            Cause(name=f"{name} dead", budget=budget, begin=partial(_kill, name)),
            Cause(name=f"{name} mute", budget=budget, begin=partial(_mute, name)),
        ]
    return [
        *causes,
        Cause(name="bus silent", budget=Budget.SILENT, begin=_silence_bus, is_heard=False),
        Cause(name="planner silent", budget=Budget.PLANNER, origin=Origin.DECISION,
              begin=_silence_planner),
    ]


def _nmt() -> list[Cause]:
    """Actuator nodes obey and say so themselves; the other two merely fall silent."""
    addressed = {"all nodes": 0} | {name: NODE_IDS[name] for name in NODE_IDS}
    del addressed["Supervisor"]  # the master obeys nobody
    budgets = {"SafetyMonitor": Budget.SILENT, "Gateway": Budget.SILENT}
    return [
        Cause(name=f"NMT stop of {name}", budget=budgets.get(name, Budget.SENSED),
              origin=Origin.FRAME,
              begin=partial(_inject, nmt_frame(NmtCommand.STOP, node_id)))
        for name, node_id in addressed.items()
    ]


def _monitored() -> list[Cause]:
    return [
        Cause(name="steering motor dead in a turn", budget=Budget.MONITOR, origin=Origin.LIMIT,
              begin=partial(_steer_with, "steering_motor_dead"), exceeds=steering_diverges,
              hold_ns=STEERING_DIVERGENCE_NS, watch_s=2.0),
        Cause(name="steering angle stuck in a turn", budget=Budget.MONITOR, origin=Origin.LIMIT,
              begin=partial(_steer_with, "steering_angle_stuck"), exceeds=steering_diverges,
              hold_ns=STEERING_DIVERGENCE_NS, watch_s=2.0),
        Cause(name="traction dead when accelerating", budget=Budget.MONITOR, origin=Origin.LIMIT,
              begin=_accelerate_without_motor, exceeds=speed_diverges,
              hold_ns=SPEED_DIVERGENCE_NS, watch_s=4.0),
        Cause(name="motor encoder dead", budget=Budget.MONITOR, origin=Origin.LIMIT,
              begin=partial(_set_fault, "motor_encoder_dead", True), exceeds=axles_diverge,
              hold_ns=AXLE_DIVERGENCE_NS, watch_s=2.0),
        Cause(name="wheel encoder dead", budget=Budget.MONITOR, origin=Origin.LIMIT,
              begin=partial(_set_fault, "wheel_encoder_dead", True), exceeds=axles_diverge,
              hold_ns=AXLE_DIVERGENCE_NS, watch_s=2.0),
    ]


CAUSES = {cause.name: cause for cause in (*_sensed(), *_silent(), *_nmt(), *_monitored())}
"""By name, in the order of the table."""
