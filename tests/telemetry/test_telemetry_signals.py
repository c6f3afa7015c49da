"""Signals, spans and causes read back from frames."""

from __future__ import annotations

import math
from typing import Any

import pytest

from canbus.frame import Frame
from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import (
    BrakeStatus,
    ErrorCode,
    Inhibit,
    Mode,
    NodeState,
    SteerDriver,
    SteerStatus,
    SupervisorState,
    ThrottleStatus,
)
from telemetry.bus_log import BusLog
from telemetry.signals import CodeSpan, ModeSpan, messages_of, read_signals
from vehicles import load_vehicle

MS = 1_000_000
VEHICLE = load_vehicle("tabby_evo")
NO_CODES: dict[str, bool] = {f"er{number}": False for number in range(7)}


def frame(name: str, message: Any) -> Frame:
    return encode(SPEC_OF_NAME[name], message)


def supervisor(mode: Mode, **codes: bool) -> Frame:
    state = SupervisorState(
        mode=mode,
        steering_authorised=False,
        throttle_authorised=False,
        brake_authorised=False,
        reset_epoch=0,
        decision_age_ms_max=85.0,
        inhibit=Inhibit.NONE,
        **{**NO_CODES, **codes},
    )
    return frame("SUPERVISOR_STATE", state)


def test_modes_become_spans_without_gaps() -> None:
    log = BusLog()
    modes = [Mode.INIT, Mode.MANUAL, Mode.MANUAL, Mode.AUTOMATIC, Mode.EMERGENCY, Mode.EMERGENCY]
    for number, mode in enumerate(modes):
        log.add((10 + 10 * number) * MS, supervisor(mode))
    signals = read_signals(log, VEHICLE)
    assert signals.modes == (
        ModeSpan(start_s=0.01, end_s=0.02, mode=Mode.INIT),
        ModeSpan(start_s=0.02, end_s=0.04, mode=Mode.MANUAL),
        ModeSpan(start_s=0.04, end_s=0.05, mode=Mode.AUTOMATIC),
        ModeSpan(start_s=0.05, end_s=0.06, mode=Mode.EMERGENCY),
    )
    assert signals.emergency_brakes == 1 and signals.end_s == pytest.approx(0.06)


def test_codes_of_supervisor_and_nodes_become_spans() -> None:
    log = BusLog()
    for number in range(4):
        log.add(number * 10 * MS, supervisor(Mode.MANUAL, er5=number in (1, 2)))
    driver = SteerDriver(
        torque_nm=0.0,
        driver_active=False,
        node_state=NodeState.RELEASED,
        present_codes=0,
        **{**NO_CODES, "er6": True},
    )
    log.add(40 * MS, frame("STEER_DRIVER", driver))
    log.add(60 * MS, frame("STEER_DRIVER", driver))
    signals = read_signals(log, VEHICLE)
    assert set(signals.codes) == {
        CodeSpan(start_s=0.01, end_s=0.03, code=ErrorCode.ER5),
        CodeSpan(start_s=0.04, end_s=0.06, code=ErrorCode.ER6),
    }
    assert signals.code_names == ("ER5", "ER6")


def test_setpoint_and_measured_are_read_as_sent() -> None:
    log = BusLog()
    steering = SteerStatus(steering_wheel_angle_rad=4.0, applied_steering_wheel_angle_rad=4.5)
    log.add(0, frame("STEER_STATUS", steering))
    wheels = ThrottleStatus(wheel_speed_radps=10.0, applied_wheel_speed_radps=12.0)
    log.add(1 * MS, frame("THROTTLE_STATUS", wheels))
    servo = BrakeStatus(
        servo_position_ratio=0.25, applied_position_ratio=1.0, rear_wheel_speed_radps=0.0
    )
    log.add(2 * MS, frame("BRAKE_STATUS", servo))
    signals = read_signals(log, VEHICLE)
    assert signals.steering_rad.measured[0] == pytest.approx(4.0, abs=1e-3)
    assert signals.steering_rad.setpoint[0] == pytest.approx(4.5, abs=1e-3)
    # UAH Eq. 14 by hand: 10 rad/s on 0.287 m at a road wheel of 0.1 rad.
    assert signals.speed_mps.measured[0] == pytest.approx(2.87 * math.cos(0.1), abs=1e-2)
    assert signals.speed_mps.setpoint[0] == pytest.approx(3.444 * math.cos(0.1), abs=1e-2)
    assert signals.brake_ratio.measured[0] == pytest.approx(0.25, abs=5e-3)
    assert signals.brake_ratio.setpoint[0] == pytest.approx(1.0, abs=5e-3)


def test_empty_log_has_no_signals() -> None:
    signals = read_signals(BusLog(), VEHICLE)
    assert len(signals.speed_mps.time_s) == 0
    assert not signals.modes and not signals.codes and not signals.code_names
    assert signals.end_s == 0.0 and signals.emergency_brakes == 0


def test_corrupt_frames_are_left_out() -> None:
    log = BusLog()
    good = supervisor(Mode.MANUAL)
    log.add(0, good)
    log.add(1, Frame(good.can_id, bytes([good.data[0] ^ 1, *good.data[1:]])))
    assert len(list(messages_of(log, "SUPERVISOR_STATE"))) == 1
