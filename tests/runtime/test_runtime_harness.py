"""The harness: frames to readings, commands to frames, and what a cut wire reads as."""

from __future__ import annotations

import math
from typing import Any

import pytest

from canbus.frame import Frame, FrameKind, ReceivedFrame
from dbc.harness import (
    BrakeEncoderWire,
    BrakeSensorsWire,
    RelayCoil,
    SteeringSensorsWire,
    SupervisorSensorsWire,
    ThrottleSensorsWire,
)
from dbc.spec import SignalRangeError
from ecus.brake_servo.ports import BrakeActuator
from ecus.steering.ports import SteeringActuator
from ecus.supervisor.ports import SupervisorActuator
from ecus.throttle.ports import ThrottleActuator
from runtime.harness import STALE_NS, HarnessPort, decode_harness, harness_frame
from runtime.wires import (
    BrakeWires,
    MonitorWires,
    SteeringWires,
    SupervisorWires,
    ThrottleWires,
)
from tests.runtime.runtime_fakes import FakeBus, FakeClock

MS = 1_000_000
STEERING = SteeringSensorsWire(column_angle_rad=0.5, driver_torque_nm=-1.25, motor_fault=True)
THROTTLE = ThrottleSensorsWire(encoder_count=-7, encoder_edge_age_s=0.002, pedal_ratio=0.25)
ENCODER = BrakeEncoderWire(wheel_count=42, wheel_edge_age_s=0.004)
BRAKE = BrakeSensorsWire(servo_position_ratio=0.75, pedal_ratio=0.5, slope_rad=0.1)
STOP = SupervisorSensorsWire(
    button_pressed=True, emergency_stop_pressed=False, automatic_relay_closed=True
)


def given(wires: Any, arrival_ns: int, **messages: object) -> Any:
    wires.take([ReceivedFrame(arrival_ns, harness_frame(n, m)) for n, m in messages.items()])
    return wires


def content(frame: Frame) -> Any:
    reading = decode_harness(ReceivedFrame(0, frame))
    assert reading is not None
    return reading.content


def test_steering_readings_come_through() -> None:
    sensors = given(SteeringWires(), 0, STEERING_SENSORS=STEERING).sensors(10 * MS)
    assert sensors.column_angle_rad == pytest.approx(0.5, abs=1e-6)
    assert sensors.driver_torque_nm == pytest.approx(-1.25, abs=1e-3)
    assert sensors.motor_fault


def test_steering_is_nan_before_the_first_frame() -> None:
    sensors = SteeringWires().sensors(0)
    assert math.isnan(sensors.column_angle_rad) and math.isnan(sensors.driver_torque_nm)


@pytest.mark.parametrize(("age_ns", "is_broken"), [(STALE_NS, False), (STALE_NS + 1, True)])
def test_readings_older_than_50_ms_are_broken(age_ns: int, is_broken: bool) -> None:
    steering = given(SteeringWires(), 5 * MS, STEERING_SENSORS=STEERING).sensors(5 * MS + age_ns)
    throttle = given(ThrottleWires(), 5 * MS, THROTTLE_SENSORS=THROTTLE).sensors(5 * MS + age_ns)
    brake = given(BrakeWires(), 5 * MS, BRAKE_SENSORS=BRAKE).sensors(5 * MS + age_ns)
    readings = (
        steering.column_angle_rad,
        steering.driver_torque_nm,
        throttle.pedal_ratio,
        brake.pedal_ratio,
        brake.servo_position_ratio,
    )
    assert [math.isnan(reading) for reading in readings] == [is_broken] * 5


def test_stale_is_what_the_hardware_watchdogs_call_stale() -> None:
    assert STALE_NS == 50 * MS


def test_nan_of_a_broken_sensor_comes_through() -> None:
    broken = BrakeSensorsWire(servo_position_ratio=math.nan, pedal_ratio=0.5, slope_rad=math.nan)
    sensors = given(BrakeWires(), 0, BRAKE_SENSORS=broken).sensors(0)
    assert math.isnan(sensors.servo_position_ratio) and sensors.pedal_ratio == 0.5


def test_age_of_an_edge_grows_with_the_age_of_the_frame() -> None:
    throttle = given(ThrottleWires(), 0, THROTTLE_SENSORS=THROTTLE).sensors(7 * MS)
    brake = given(BrakeWires(), 0, BRAKE_ENCODER=ENCODER).sensors(7 * MS)
    assert throttle.encoder_edge_age_s == pytest.approx(0.009)
    assert brake.wheel_edge_age_s == pytest.approx(0.011)
    assert (throttle.encoder_count, brake.wheel_count) == (-7, 42)


def test_age_of_an_edge_saturates_at_1_s() -> None:
    throttle = given(ThrottleWires(), 0, THROTTLE_SENSORS=THROTTLE)
    assert throttle.sensors(5_000 * MS).encoder_edge_age_s == 1.0


def test_emergency_stop_is_not_pressed_before_the_first_frame() -> None:
    assert not SupervisorWires().sensors(0).emergency_stop_pressed
    assert not MonitorWires().sensors(0).emergency_stop_pressed


@pytest.mark.parametrize("wires", [SupervisorWires, MonitorWires])
def test_emergency_stop_line_that_is_cut_reads_as_pressed(wires: Any) -> None:
    panel = given(wires(), 0, SUPERVISOR_SENSORS=STOP)
    assert not panel.sensors(STALE_NS).emergency_stop_pressed
    assert panel.sensors(STALE_NS + 1).emergency_stop_pressed


def test_relays_contact_is_not_known_before_the_first_frame_nor_by_a_cut_wire() -> None:
    assert SupervisorWires().sensors(0).automatic_relay_closed is None
    panel = given(SupervisorWires(), 0, SUPERVISOR_SENSORS=STOP)
    assert panel.sensors(0).automatic_relay_closed is True
    assert panel.sensors(STALE_NS + 1).automatic_relay_closed is None


def test_button_is_not_pressed_by_a_cut_wire() -> None:
    panel = given(SupervisorWires(), 0, SUPERVISOR_SENSORS=STOP)
    assert panel.sensors(0).button_pressed
    assert not panel.sensors(STALE_NS + 1).button_pressed


def test_newest_frame_wins() -> None:
    wires = given(SteeringWires(), 0, STEERING_SENSORS=STEERING)
    turned = SteeringSensorsWire(column_angle_rad=1.5, driver_torque_nm=0.0, motor_fault=False)
    given(wires, 10 * MS, STEERING_SENSORS=turned)
    assert wires.sensors(10 * MS).column_angle_rad == pytest.approx(1.5, abs=1e-6)


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x202, bytes(7)),
        Frame(0x202, bytes(8), FrameKind.FD),
        Frame(0x202, b"", FrameKind.REMOTE),
        Frame(0x202, bytes(8), FrameKind.EXTENDED),
        Frame(0x202, bytes([0xFF, 0xFF, 0x7F, 0, 0, 0, 0, 0])),  # 16.78 rad, beyond the range
    ],
)
def test_a_bad_frame_is_counted_and_changes_nothing(frame: Frame) -> None:
    wires = given(SteeringWires(), 0, STEERING_SENSORS=STEERING)
    before = wires.sensors(MS)
    wires.take([ReceivedFrame(MS, frame)])
    assert wires.sensors(MS) == before
    assert wires.bad_frames == 1


def test_frames_for_others_are_not_counted() -> None:
    wires = given(SteeringWires(), 0, BRAKE_SENSORS=BRAKE)
    assert wires.bad_frames == 0
    assert math.isnan(wires.sensors(0).column_angle_rad)


def test_commands_become_frames() -> None:
    duty = SteeringActuator(motor_duty_ratio=-0.25, motor_enabled=True)
    dacs = ThrottleActuator(throttle_dac_code=2048, regen_dac_code=410, reverse_selected=True)
    servo = BrakeActuator(servo_position_ratio=0.75, servo_powered=True)
    (steering,) = SteeringWires().frames(duty)
    (throttle,) = ThrottleWires().frames(dacs)
    (brake,) = BrakeWires().frames(servo)
    assert (steering.can_id, throttle.can_id, brake.can_id) == (0x102, 0x103, 0x104)
    assert content(steering).motor_duty_ratio == pytest.approx(-0.25)
    assert content(steering).motor_enabled
    assert content(throttle).throttle_dac_code == 2048
    assert content(throttle).regen_dac_code == 410 and content(throttle).reverse_selected
    assert content(brake).servo_position_ratio == pytest.approx(0.75)
    assert content(brake).servo_powered


@pytest.mark.parametrize(
    ("closed", "coil"),
    [(None, RelayCoil.LEAVE), (False, RelayCoil.OPEN), (True, RelayCoil.CLOSE)],
)
def test_relay_is_moved_or_left(closed: bool | None, coil: RelayCoil) -> None:
    (frame,) = SupervisorWires().frames(SupervisorActuator(automatic_relay_closed=closed))
    assert content(frame).relay_coil is coil


def test_the_safety_monitor_moves_nothing() -> None:
    assert MonitorWires().frames(None) == []


@pytest.mark.parametrize("duty", [math.nan, 1.01, -math.inf])
def test_an_impossible_command_is_refused(duty: float) -> None:
    with pytest.raises(SignalRangeError, match="motor_duty_ratio"):
        SteeringWires().frames(SteeringActuator(motor_duty_ratio=duty, motor_enabled=True))


def test_port_reads_and_writes_the_harness_bus_without_waiting() -> None:
    clock = FakeClock(20 * MS)
    bus = FakeBus(clock, [(12 * MS, harness_frame("STEERING_SENSORS", STEERING))])
    port = HarnessPort(SteeringWires(), bus)
    port.poll()
    assert port.sensors(clock()).motor_fault
    port.actuate(clock(), SteeringActuator(motor_duty_ratio=0.0, motor_enabled=False))
    assert [frame.can_id for _, frame in bus.sent] == [0x102]
    assert bus.waits == [0]


def test_port_counts_commands_that_the_bus_refused() -> None:
    bus = FakeBus(FakeClock())
    bus.refuses = True
    port = HarnessPort(SteeringWires(), bus)
    port.actuate(0, SteeringActuator(motor_duty_ratio=0.0, motor_enabled=False))
    assert port.tx_failures == 1
