"""Everything that must end in the safe state while an actuator node drives."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame
from canbus.node import NODE_IDS
from dbc.endpoint import FAILSAFE_ID, Endpoint
from dbc.messages import ErrorCode, Reason
from tests.ecus.ecus_fakes import (
    BUS_OFF,
    ECUS,
    EMERGENCY_SENDERS,
    MS,
    Rig,
)

NAMES = list(ECUS)
SETPOINT = {"Steering": 2.0, "Throttle": 10.0, "BrakeServo": 0.4}


def late(rig: Rig) -> None:
    rig.step(span_ns=61 * MS)


def overruns(rig: Rig) -> None:
    for _ in range(3):
        rig.step(span_ns=16 * MS)


def supervisor_silent(rig: Rig) -> None:
    rig.mode = None
    rig.steps(6)


def nmt(command: NmtCommand) -> Callable[[Rig], None]:
    def act(rig: Rig) -> None:
        rig.extra.append(nmt_frame(command, NODE_IDS[rig.name]))
        rig.step()

    return act


def bus_off(rig: Rig) -> None:
    rig.extra.append(BUS_OFF)
    rig.step()


def foreign_sender(rig: Rig) -> None:
    rig.extra.append(Endpoint(rig.name, ()).frame(f"{rig.prefix}_STATUS", rig.node._status()))
    rig.step()


def planner_silent(rig: Rig) -> None:
    rig.age_ms = math.nan
    rig.steps(10)


def command_missing(rig: Rig) -> None:
    rig.age_ms = None
    rig.steps(10)


def sensor(**values: object) -> Callable[[Rig], None]:
    def act(rig: Rig) -> None:
        rig.sense(**values)
        rig.step()

    return act


def servo_stuck(rig: Rig) -> None:
    rig.sense(servo_position_ratio=0.9)
    rig.steps(40)


OWN_CAUSES: dict[str, tuple[ErrorCode, Reason, Callable[[Rig], None]]] = {
    "late": (ErrorCode.ER2, Reason.LATE, late),
    "overruns": (ErrorCode.ER2, Reason.OVERRUNS, overruns),
    "supervisor silent": (ErrorCode.ER2, Reason.SUPERVISOR_SILENT, supervisor_silent),
    "NMT stop": (ErrorCode.ER2, Reason.NMT_COMMAND, nmt(NmtCommand.STOP)),
    "NMT pre-operational": (
        ErrorCode.ER2, Reason.NMT_COMMAND, nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    ),
    "NMT reset": (ErrorCode.ER2, Reason.NMT_COMMAND, nmt(NmtCommand.RESET_NODE)),
    "NMT reset communication": (
        ErrorCode.ER2, Reason.NMT_COMMAND, nmt(NmtCommand.RESET_COMMUNICATION)
    ),
    "bus-off": (ErrorCode.ER2, Reason.BUS_OFF, bus_off),
    "stranger with our identifier": (ErrorCode.ER1, Reason.FOREIGN_SENDER, foreign_sender),
    "planner silent": (ErrorCode.ER5, Reason.PLANNER_SILENT, planner_silent),
    "command missing": (ErrorCode.ER5, Reason.COMMAND_MISSING, command_missing),
}
SENSOR_CAUSES: dict[str, dict[str, tuple[ErrorCode, Reason, Callable[[Rig], None]]]] = {
    "Steering": {
        "ER4 motor fault": (ErrorCode.ER4, Reason.MOTOR_FAULT, sensor(motor_fault=True)),
        "ER6 angle NaN": (
            ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS, sensor(column_angle_rad=math.nan)
        ),
        "ER6 angle too large": (
            ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS, sensor(column_angle_rad=-9.61)
        ),
        "ER6 torque NaN": (
            ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS, sensor(driver_torque_nm=math.nan)
        ),
    },
    "Throttle": {
        "pedal NaN": (ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS, sensor(pedal_ratio=math.nan)),
        "pedal beyond": (ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS, sensor(pedal_ratio=1.05)),
        "pedal below": (ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS, sensor(pedal_ratio=-0.05)),
    },
    "BrakeServo": {
        "pedal NaN": (ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS, sensor(pedal_ratio=math.nan)),
        "pedal beyond": (ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS, sensor(pedal_ratio=1.05)),
        "position beyond": (
            ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS, sensor(servo_position_ratio=1.05)
        ),
        "position below": (
            ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS, sensor(servo_position_ratio=-0.05)
        ),
        "position NaN": (
            ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS, sensor(servo_position_ratio=math.nan)
        ),
        "servo stuck": (ErrorCode.ER1, Reason.SERVO_STUCK, servo_stuck),
    },
}
ALL_OWN = [
    pytest.param(name, *values, id=f"{name}: {cause}")
    for name in NAMES
    for cause, values in (OWN_CAUSES | SENSOR_CAUSES[name]).items()
]


def failsafe(rig: Rig) -> None:
    rig.extra.append(Frame(FAILSAFE_ID))
    rig.step()


def emergency_of(peer: str) -> Callable[[Rig], None]:
    def act(rig: Rig) -> None:
        rig.extra.append(rig.emergency_frame(peer))
        rig.step()

    return act


FOREIGN_STOPS = [
    pytest.param(name, act, id=f"{name}: {what}")
    for name in NAMES
    for what, act in [
        ("FAILSAFE", failsafe),
        *((f"EMERGENCY_BRAKE of {p}", emergency_of(p)) for p in EMERGENCY_SENDERS if p != name),
    ]
]
