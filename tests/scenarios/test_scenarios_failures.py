"""Every failure of one part while the car drives itself, from its cause to the safe state."""

from __future__ import annotations

import math

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame, FrameKind
from canbus.node import NODE_IDS
from dbc.messages import ErrorCode, Mode, NodeState, Reason, Request
from simulation.world import in_time
from tests.scenarios.driving import Drive

pytestmark = pytest.mark.whole_car

NODES = list(NODE_IDS)
ACTUATORS = ("Steering", "Throttle", "BrakeServo")


def assert_safe(drive: Drive) -> None:
    """The car stands, braked, without drive torque, and stays so."""
    assert drive.brakes_to_standstill(), drive.log()
    drive.run(1.0)
    assert abs(drive.speed) < 0.02
    assert drive.brake > 0.9
    assert drive.car.truth.motor_torque_nm <= 0.01
    assert drive.car.truth.relay_closed


def er2_of_silence(drive: Drive) -> bool:
    return any("ER2" in event.text for _, event in drive.world.events)


@pytest.mark.parametrize("name", NODES)
@pytest.mark.parametrize("how", ["dead", "mute"])
def test_any_single_node_dead_or_mute_stops_the_car(name: str, how: str) -> None:
    drive = Drive().go(5.0, 0.03)
    began_ns = drive.world.now_ns
    if how == "dead":
        drive.stop_node(name)
    else:
        drive.world.stations[name].is_mute = True
    drive.run(0.3)
    first_ns = drive.emergencies[0][0]
    limit_ms = 85 + 15 if name == "Gateway" else 75
    assert first_ns - began_ns <= limit_ms * 1_000_000 + 1_000_000  # the wire
    assert_safe(drive)
    if name == "Gateway":
        assert ErrorCode.ER5 in {message.code for _, _, message in drive.emergencies}
    else:
        assert er2_of_silence(drive), drive.log()


def test_a_dead_brake_ecu_is_braked_by_its_hardware_watchdog() -> None:
    drive = Drive().go(5.0)
    drive.stop_node("BrakeServo")
    drive.run(0.05 + 0.29 + 0.05)
    assert drive.brake > 0.9


def test_bus_silence_leaves_every_node_safe_alone() -> None:
    drive = Drive().go(6.0, 0.05)
    angle_before = drive.car.truth.column_angle_rad
    with drive.losing(lambda frame: True):
        drive.run(0.4)
        assert {drive.node_state(name) for name in ACTUATORS} == {NodeState.SAFE_ALONE}
        assert drive.car.truth.column_angle_rad == pytest.approx(angle_before, abs=0.3)
        assert_safe(drive)


def test_all_nodes_without_power_leave_the_brake_to_the_watchdog() -> None:
    drive = Drive().go(5.0)
    for name in NODES:
        drive.stop_node(name)
    assert_safe(drive)


@pytest.mark.parametrize(
    ("fault", "value", "code", "reason"),
    [
        ("steering_motor_fault", True, ErrorCode.ER4, Reason.MOTOR_FAULT),
        ("steering_angle_override_rad", math.nan, ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS),
        ("steering_angle_override_rad", 12.0, ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS),
        ("steering_torque_override_nm", math.nan, ErrorCode.ER6, Reason.SENSOR_OUT_OF_BOUNDS),
    ],
)
def test_er4_and_er6_brake_and_let_the_steering_coast(
    fault: str, value: object, code: ErrorCode, reason: Reason
) -> None:
    drive = Drive().go(5.0, 0.03)
    began_ns = drive.world.now_ns
    setattr(drive.car.faults, fault, value)
    drive.run(0.04)
    assert drive.first_emergency() == (code, reason)
    assert drive.emergencies[0][0] - began_ns <= 20_000_000 + 1_000_000
    assert drive.is_in(Mode.EMERGENCY)
    steering = drive.world.stations["Steering"].node
    assert math.isnan(steering._status().applied_steering_wheel_angle_rad)
    assert code in drive.codes
    assert_safe(drive)


@pytest.mark.parametrize("reading", [math.nan, 1.05, -0.05])
@pytest.mark.parametrize(
    "sensor",
    ["throttle_pedal_override_ratio", "brake_pedal_override_ratio",
     "servo_position_override_ratio"],
)
def test_a_pedal_or_servo_that_cannot_be_read_brakes(sensor: str, reading: float) -> None:
    drive = Drive().go(5.0)
    setattr(drive.car.faults, sensor, reading)
    drive.run(0.04)
    assert drive.first_emergency() == (ErrorCode.ER1, Reason.SENSOR_OUT_OF_BOUNDS)
    assert_safe(drive)


@pytest.mark.parametrize("encoder", ["motor_encoder_dead", "wheel_encoder_dead"])
def test_an_encoder_that_lies_is_found_by_comparing_axles(encoder: str) -> None:
    drive = Drive().go(5.0)
    setattr(drive.car.faults, encoder, True)
    drive.run(0.5)
    assert drive.first_emergency() == (ErrorCode.ER1, Reason.VERDICT_BRAKE)
    assert drive.brakes_to_standstill()


@pytest.mark.parametrize("fault", ["steering_motor_dead", "steering_angle_stuck"])
def test_a_steering_that_does_not_follow_is_vetoed(fault: str) -> None:
    drive = Drive().go(5.0, 0.03)
    setattr(drive.car.faults, fault, True)
    drive.curvature_per_m = -0.03
    drive.run(0.8)
    assert drive.first_emergency() == (ErrorCode.ER1, Reason.VERDICT_BRAKE)
    assert drive.brakes_to_standstill()


def test_a_dead_servo_is_replaced_by_all_regeneration_there_is() -> None:
    drive = Drive().go(6.0)
    drive.car.faults.servo_stuck = True
    drive.request(Request.EMERGENCY_STOP, 0.6)
    assert drive.is_in(Mode.EMERGENCY)
    assert drive.brake < 0.05
    assert drive.car.truth.motor_torque_nm < -50.0
    drive.run(5.0)
    assert abs(drive.speed) < 0.5


def test_a_dead_servo_is_replaced_though_the_drive_s_own_encoder_is_dead_too() -> None:
    drive = Drive().go(6.0)
    drive.car.faults.servo_stuck = True
    drive.car.faults.motor_encoder_dead = True
    drive.request(Request.EMERGENCY_STOP, 0.8)
    assert drive.brake < 0.05
    assert drive.car.truth.motor_torque_nm < -50.0  # the rear wheels' encoder says that it moves


def test_a_car_without_a_servo_that_stops_uphill_rolls_back_at_walking_pace() -> None:
    drive = Drive().go(2.0)
    drive.car.faults.servo_dead = True
    drive.car.faults.slope_rad = 0.12
    drive.request(Request.EMERGENCY_STOP, 2.0)
    fastest_mps = 0.0
    for _ in range(200):
        drive.run(0.02)
        fastest_mps = max(fastest_mps, -drive.speed)
    assert 0.3 < fastest_mps < 1.1


def test_er5_a_silent_planner_is_noticed_at_its_age_limit() -> None:
    drive = Drive().go(5.0)
    decided_ns = drive.world.now_ns - 20_000_000  # the last decision of `run`
    drive.is_planner_silent = True
    drive.run(0.15)
    first_ns, _, message = drive.emergencies[0]
    assert (message.code, message.reason) == (ErrorCode.ER5, Reason.PLANNER_SILENT)
    assert 80_000_000 < first_ns - decided_ns <= 100_000_000 + 1_000_000
    assert_safe(drive)


def test_the_gateway_never_refreshes_an_old_decision() -> None:
    drive = Drive().go(5.0)
    drive.is_planner_silent = True
    drive.run(0.02)
    ages = [drive.state.decision_age_s]
    drive.run(0.02)
    ages.append(drive.state.decision_age_s)
    assert ages[1] == pytest.approx(ages[0] + 0.02, abs=0.001)


def test_er3_the_servo_rests_at_standstill_and_brakes_a_car_that_rolls() -> None:
    drive = Drive().go(5.0)
    drive.request(Request.EMERGENCY_STOP)
    drive.run(25.0)
    assert drive.brake > 0.9
    drive.run(8.0)
    assert ErrorCode.ER3 in drive.codes
    assert drive.brake < 0.05  # released to save the servo
    assert drive.is_in(Mode.EMERGENCY)
    drive.car.faults.slope_rad = -0.08  # somebody lets the car roll
    drive.run(1.5)
    assert drive.brake > 0.9  # applied again
    assert abs(drive.speed) < 0.05


def test_er2_a_node_late_by_more_than_50_ms_brakes() -> None:
    drive = Drive().go(5.0)
    drive.world.stations["Steering"].lateness_ns = lambda: 56_000_000
    drive.run(0.015)
    drive.world.stations["Steering"].lateness_ns = in_time
    drive.run(0.2)
    assert any(e.node == "Steering" and "ER2 LATE" in e.text for _, e in drive.world.events)
    assert ErrorCode.ER2 in drive.codes
    assert_safe(drive)


@pytest.mark.parametrize("name", NODES)
def test_a_cycle_late_by_20_ms_now_and_then_does_not_brake(name: str) -> None:
    drive = Drive().go(5.0)
    for _ in range(5):
        drive.world.stations[name].lateness_ns = lambda: 20_000_000
        drive.run(0.02)
        drive.world.stations[name].lateness_ns = in_time
        drive.run(0.2)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()


@pytest.mark.parametrize("command", [NmtCommand.STOP, NmtCommand.RESET_NODE])
@pytest.mark.parametrize("name", NODES[1:])
def test_a_strangers_nmt_stops_the_car_and_is_reported(name: str, command: NmtCommand) -> None:
    drive = Drive().go(5.0)
    drive.world.inject(nmt_frame(command, NODE_IDS[name]))
    drive.run(0.1)
    assert drive.is_in(Mode.EMERGENCY), drive.log()
    strangers = [e for _, e in drive.world.events if e.node == "Supervisor" and "000#" in e.text]
    assert strangers
    assert_safe(drive)


def test_a_failsafe_frame_from_anybody_is_obeyed() -> None:
    drive = Drive().go(5.0)
    drive.world.inject(Frame(0x001))
    drive.run(0.03)
    assert drive.is_in(Mode.EMERGENCY)
    assert_safe(drive)


def test_the_emergency_stop_input_brakes_within_20_ms() -> None:
    drive = Drive().go(5.0)
    began_ns = drive.world.now_ns
    drive.car.driver.emergency_stop_pressed = True
    drive.run(0.04)
    assert drive.emergencies[0][0] - began_ns <= 21_000_000
    assert_safe(drive)


@pytest.mark.parametrize("name", ACTUATORS)
def test_a_node_that_restarts_while_driving_does_not_drive_on(name: str) -> None:
    drive = Drive().go(5.0)
    station = drive.world.stations[name]
    station.restart()
    drive.run(0.2)
    assert drive.is_in(Mode.EMERGENCY), drive.log()
    assert drive.node_state(name) is not NodeState.ACTIVE
    assert_safe(drive)


def test_a_supervisor_that_restarts_adopts_the_emergency_and_keeps_braking() -> None:
    drive = Drive().go(6.0)
    drive.stop_node("Supervisor")
    drive.run(0.5)
    drive.world.stations["Supervisor"].restart()
    drive.run(0.3)
    assert drive.is_in(Mode.EMERGENCY), drive.log()
    assert_safe(drive)
    drive.request(Request.RESET, 0.5)
    assert drive.is_in(Mode.MANUAL)
    assert drive.brake < 0.2


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x183, b"\x55" * 8),
        Frame(0x183, b"\x00" * 3),
        Frame(0x204, bytes(range(8))),
        Frame(0x202, b"", FrameKind.REMOTE),
        Frame(0x7F0, b"\x01"),
        Frame(0x184, b"\x00" * 8, FrameKind.EXTENDED),
        Frame(0x450, b"\x01\x02"),
    ],
    ids=str,
)
def test_one_frame_nobody_should_send_moves_nothing_and_is_reported(frame: Frame) -> None:
    drive = Drive().go(5.0)
    angle, brake = drive.car.truth.column_angle_rad, drive.brake
    events = len(drive.world.events)
    drive.world.inject(frame)
    drive.run(0.3)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert drive.car.truth.column_angle_rad == pytest.approx(angle, abs=0.05)
    assert drive.brake == pytest.approx(brake, abs=0.05)
    assert len(drive.world.events) > events
