"""ER0 to ER6 on real SocketCAN: a cause outside the nodes, EMCY, brake frame, actuator."""

from __future__ import annotations

import signal
import time
from pathlib import Path

from dbc.harness import BrakeActuatorWire, SteeringSensorsWire, SupervisorSensorsWire
from dbc.messages import SPECS, ErrorCode, Mode, Reason
from tests.vcan.answers import EMCY, brakes_for, emcy, latches
from tests.vcan.latency import PLANNER_SILENT_S, SENSED_S, SILENT_S, within
from tests.vcan.shell import cansend
from tests.vcan.stack import VEHICLE, Stack, pause
from vehicles.reading import vehicle_text
from vehicles.writing import with_number

ON_TIME_S_MAX = 10.0
"""Of the car whose servo rests: hardly more than its vehicle file allows. Half a minute of bus is
much to emulate."""


def _is_stop_pressed(reading: object) -> bool:
    return isinstance(reading, SupervisorSensorsWire) and reading.emergency_stop_pressed


def _is_motor_faulty(reading: object) -> bool:
    return isinstance(reading, SteeringSensorsWire) and reading.motor_fault


def _is_servo_on(command: object) -> bool:
    return isinstance(command, BrakeActuatorWire) and command.servo_position_ratio > 0.0


def _is_out_of_bounds(reading: object) -> bool:
    return isinstance(reading, SteeringSensorsWire) and reading.column_angle_rad > 14.0


def test_er0_a_malformed_command_is_ignored_counted_and_reported(driving: Stack) -> None:
    begin_s = cansend("202#0011")  # starting the program may take longer than the answer
    since_s = driving.first(begin_s, lambda line: line.data == b"\x00\x11").time_s
    latches(driving, "ER0: malformed command", since_s, "Steering", ErrorCode.ER0, SENSED_S)
    pause(0.3)
    assert not [line for line in driving.log(since_s) if 0x010 < line.can_id < 0x020]
    assert driving.mode is Mode.AUTOMATIC


def test_er1_the_emergency_stop_button_brakes(driving: Stack) -> None:
    begin_s = driving.hands(emergency_stop_pressed=True)
    since_s = driving.sensed(begin_s, _is_stop_pressed)
    message = brakes_for(driving, "ER1: emergency-stop button", since_s, ErrorCode.ER1, SENSED_S)
    assert message.reason in (Reason.EMERGENCY_STOP_INPUT, Reason.VERDICT_BRAKE)
    latches(driving, "ER1: emergency-stop button", since_s, "Supervisor", ErrorCode.ER1, SENSED_S)


def test_er1_the_failsafe_frame_of_anybody_brakes(driving: Stack) -> None:
    begin_s = cansend("001#")
    since_s = driving.first(begin_s, lambda line: line.can_id == 0x001).time_s
    brakes_for(driving, "ER1: FAILSAFE frame", since_s, ErrorCode.ER1, SENSED_S)
    latches(driving, "ER1: FAILSAFE frame", since_s, "Supervisor", ErrorCode.ER1, SENSED_S)


def test_er2_a_stopped_node_brakes(driving: Stack) -> None:
    since_s = driving.kill("throttle", signal.SIGSTOP)
    message = brakes_for(driving, "ER2: throttle, SIGSTOP", since_s, ErrorCode.ER2, SILENT_S)
    assert message.reason in (Reason.NODE_SILENT, Reason.VERDICT_BRAKE)
    latches(driving, "ER2: throttle, SIGSTOP", since_s, "Supervisor", ErrorCode.ER2, SILENT_S)


def test_er4_a_fault_of_the_motor_driver_brakes_and_lets_the_wheel_go(driving: Stack) -> None:
    begin_s = driving.break_("steering_motor_fault")
    since_s = driving.sensed(begin_s, _is_motor_faulty)
    message = brakes_for(driving, "ER4: motor driver's fault", since_s, ErrorCode.ER4, SENSED_S)
    assert message.reason is Reason.MOTOR_FAULT
    latches(driving, "ER4: motor driver's fault", since_s, "Steering", ErrorCode.ER4, SENSED_S)


def test_er5_a_silent_planner_brakes(driving: Stack) -> None:
    since_s = driving.kill("planner", signal.SIGSTOP)
    brakes_for(driving, "ER5: planner, SIGSTOP", since_s, ErrorCode.ER5, PLANNER_SILENT_S)
    # Whose cycle is next when the last command has become too old is the chance of the planner's
    # phase; who hears of it from another has an emergency, and no code of its own.
    first = SPECS[driving.first_brake(since_s).can_id].sender
    assert first in ("Steering", "Throttle", "BrakeServo")
    latches(driving, "ER5: planner, SIGSTOP", since_s, first, ErrorCode.ER5, PLANNER_SILENT_S)


def test_er6_a_steering_sensor_out_of_bounds_brakes(driving: Stack) -> None:
    begin_s = driving.break_("steering_angle_override_rad", 15.0)
    since_s = driving.sensed(begin_s, _is_out_of_bounds)
    message = brakes_for(driving, "ER6: angle out of bounds", since_s, ErrorCode.ER6, SENSED_S)
    assert message.reason is Reason.SENSOR_OUT_OF_BOUNDS
    latches(driving, "ER6: angle out of bounds", since_s, "Steering", ErrorCode.ER6, SENSED_S)


def test_er3_a_servo_on_for_too_long_rests_at_standstill(
    module_stack: Stack, tmp_path: Path
) -> None:
    """Last of this file: a stack with another vehicle file has the bus alone."""
    module_stack.__exit__(None, None, None)
    path = tmp_path / "warm.toml"
    text = vehicle_text(VEHICLE)
    path.write_text(with_number(text, "brake", "on_time_s_max", ON_TIME_S_MAX, "for a test"))
    with Stack(tmp_path, vehicle=str(path)) as stack:
        stack.recover()
        stack.drive()
        begin_s = stack.hands(emergency_stop_pressed=True)
        since_s = stack.sensed(begin_s, _is_servo_on)
        stack.brakes()
        stack.event("brake_servo", "ER3", ON_TIME_S_MAX + 2.0)
        line = emcy(stack, time.time() - 1.0, "BrakeServo", ErrorCode.ER3)
        within("ER3: servo on for too long", EMCY, since_s, line, ON_TIME_S_MAX + SENSED_S)
        stack.wait(lambda: stack.truth().servo_position_ratio < 0.1, 2.0)
        assert abs(stack.truth().speed_mps) < 0.01
        assert stack.mode is Mode.EMERGENCY
