"""The brake-servo ECU through its steps: following, full force, ER3 and the driver's foot."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from dbc.messages import ErrorCode, Mode, NodeState, Reason
from ecus.brake_servo.ports import RELEASED, BrakeActuator
from tests.ecus.ecus_fakes import Rig, changed, flags, sdo_write, tabby

FULL = BrakeActuator(servo_position_ratio=1.0, servo_powered=True)
RESTING = BrakeActuator(servo_position_ratio=0.0, servo_powered=True)
ON_TIME_STEPS = 3000
"""30 s on TABBY EVO."""


def braking(speed_mps: float = 0.0) -> Rig:
    """In EMERGENCY, the car moving at a constant speed."""
    rig = Rig("BrakeServo")
    rig.speed_mps = speed_mps
    rig.drive()
    return rig.emergency()


def test_servo_follows_the_command_no_faster_than_it_can() -> None:
    rig = Rig("BrakeServo").drive(0.4)
    rig.steps(20)
    echoes = [m.applied_position_ratio for m in rig.all_sent("STATUS")]
    assert max(b - a for a, b in pairwise(echoes)) <= 0.01 / 0.29 + 0.002
    assert rig.output.actuator == BrakeActuator(servo_position_ratio=0.4, servo_powered=True)


def test_setpoint_not_available_releases() -> None:
    rig = Rig("BrakeServo").drive(0.4)
    rig.setpoint = math.nan
    rig.steps(20)
    assert rig.output.actuator.servo_position_ratio == 0.0


def test_controlled_stop_uses_its_own_force() -> None:
    rig = Rig("BrakeServo").drive(1.0)
    rig.mode = Mode.STOPPING
    rig.steps(40)
    assert rig.output.actuator.servo_position_ratio == 0.25


def test_emergency_is_full_force_in_the_same_step() -> None:
    assert braking().step() == FULL


def test_safe_alone_is_full_force_without_anybody_on_the_bus() -> None:
    rig = Rig("BrakeServo").drive()
    rig.mode = rig.age_ms = None
    rig.steps(6)
    assert rig.state is NodeState.SAFE_ALONE
    for _ in range(50):
        assert rig.output.actuator == FULL
        rig.step()


def test_emergency_brakes_even_a_node_that_was_never_started() -> None:
    rig = Rig("BrakeServo", started=False)
    assert rig.emergency().step() == FULL or rig.step() == FULL


def test_reset_to_manual_releases() -> None:
    rig = braking(3.0)
    rig.steps(50)
    rig.mode, rig.is_authorised, rig.reset_epoch = Mode.MANUAL, False, 1
    assert rig.step() == RELEASED


# ER3 -----------------------------------------------------------------------------------------


def test_er3_at_standstill_releases_the_servo_only_after_its_on_time() -> None:
    rig = braking()
    rig.steps(ON_TIME_STEPS)
    assert rig.output.actuator == FULL and not rig.all_sent("EMCY")
    rig.steps(3)
    assert rig.output.actuator == RESTING
    (emcy,) = rig.all_sent("EMCY")
    assert (emcy.error_code, emcy.er_code, emcy.reason) == (
        0xFF03, ErrorCode.ER3, Reason.SERVO_ON_TOO_LONG
    )
    assert rig.state is NodeState.EMERGENCY
    assert ErrorCode.ER3 in flags(rig.all_sent("DRIVER")[-1])


def test_er3_while_moving_is_reported_and_braking_goes_on() -> None:
    rig = braking(3.0)
    for _ in range(ON_TIME_STEPS + 100):
        assert rig.step() == FULL
    assert flags(rig.all_sent("DRIVER")[-1]) == {ErrorCode.ER3}


@pytest.mark.parametrize(("speed_mps", "rests"), [(0.04, True), (0.07, False)])
def test_er3_rests_only_when_the_car_stands(speed_mps: float, rests: bool) -> None:
    rig = braking(speed_mps)
    rig.steps(ON_TIME_STEPS + 100)
    assert (rig.output.actuator == RESTING) is rests


def test_er3_waits_for_half_a_second_of_standstill() -> None:
    rig = braking(3.0)
    rig.steps(ON_TIME_STEPS + 10)
    rig.speed_mps = 0.0
    rig.steps(57)  # a tenth of a second until the encoder tells less than 0.05 m/s
    assert rig.output.actuator == FULL
    rig.steps(6)
    assert rig.output.actuator == RESTING


def test_resting_servo_brakes_again_when_the_car_rolls_above_a_fifth_of_a_metre() -> None:
    rig = braking()
    rig.steps(ON_TIME_STEPS + 10)
    assert rig.output.actuator == RESTING
    rig.speed_mps = 0.17
    rig.steps(60)
    assert rig.output.actuator == RESTING
    rig.speed_mps = 0.24
    rig.steps(60)
    assert rig.output.actuator == FULL


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_resting_servo_brakes_again_rolling_either_way(sign: float) -> None:
    rig = braking()
    rig.steps(ON_TIME_STEPS + 10)
    rig.speed_mps = sign * 0.5
    rig.steps(20)
    assert rig.output.actuator == FULL


def test_er3_never_rests_while_the_supervisor_authorises_traction() -> None:
    rig = braking()
    rig.mode = Mode.AUTOMATIC  # this node has seen a cause, the supervisor has not heard it yet
    rig.steps(1)
    rig.node.state = NodeState.SAFE_ALONE
    rig.steps(ON_TIME_STEPS + 50)
    assert rig.output.actuator == FULL
    assert ErrorCode.ER3 in flags(rig.all_sent("DRIVER")[-1])


def test_er3_rests_alone_when_no_supervisor_is_heard() -> None:
    rig = Rig("BrakeServo").drive()
    rig.mode = rig.age_ms = None
    rig.steps(ON_TIME_STEPS + 20)
    assert rig.state is NodeState.SAFE_ALONE and rig.output.actuator == RESTING


def test_er3_in_automatic_is_reported_and_the_command_is_followed() -> None:
    rig = Rig("BrakeServo").drive(0.4)
    rig.steps(ON_TIME_STEPS + 100)
    assert rig.state is NodeState.ACTIVE and not rig.all_sent("EMERGENCY_BRAKE")
    assert rig.output.actuator.servo_position_ratio == 0.4
    assert flags(rig.all_sent("DRIVER")[-1]) == {ErrorCode.ER3}


def test_holding_force_is_the_servos_continuous_rating() -> None:
    rig = Rig("BrakeServo").drive(0.32)
    rig.steps(ON_TIME_STEPS + 100)
    assert not flags(rig.all_sent("DRIVER")[-1])


def test_reset_ends_the_rest_and_the_servo_needs_as_long_to_cool() -> None:
    rig = braking()
    rig.steps(ON_TIME_STEPS + 20)
    rig.mode, rig.is_authorised, rig.reset_epoch = Mode.MANUAL, False, 1
    assert rig.steps(3) == RELEASED
    rig.drive()
    rig.emergency().steps(10)
    assert rig.output.actuator == FULL  # braking first
    rig.steps(60)
    assert rig.output.actuator == RESTING  # and still warm from before


def test_on_time_is_at_least_three_longest_stops_even_when_written() -> None:
    rig = Rig("BrakeServo")
    rig.extra.append(sdo_write("BrakeServo", 1, 5000))
    rig.step()
    assert rig.node.params.on_time_s_max == 3 * tabby().longest_stop_s
    rig.extra.append(sdo_write("BrakeServo", 1, 60_000))
    rig.step()
    assert rig.node.params.on_time_s_max == 60.0


def test_vehicle_with_too_short_an_on_time_is_refused() -> None:
    with pytest.raises(AssertionError):
        Rig("BrakeServo", changed(tabby(), brake={"on_time_s_max": 9.0}), started=False)


# Servo and sensors ---------------------------------------------------------------------------


def test_servo_that_does_not_move_is_reported_stuck_after_its_travel_time() -> None:
    rig = Rig("BrakeServo").drive(1.0)
    rig.sense(servo_position_ratio=0.0)
    rig.steps(35)
    assert rig.state is NodeState.ACTIVE
    rig.steps(15)
    assert rig.node.state is NodeState.SAFE_ALONE
    assert rig.all_sent("EMERGENCY_BRAKE")[0].reason is Reason.SERVO_STUCK
    assert rig.output.actuator == FULL


def test_released_servo_elsewhere_is_not_stuck() -> None:
    rig = Rig("BrakeServo")
    rig.sense(servo_position_ratio=0.9)
    rig.steps(100)
    assert not flags(rig.all_sent("DRIVER")[-1])


def test_status_tells_position_echo_and_rear_wheel() -> None:
    rig = Rig("BrakeServo")
    rig.speed_mps = 2.0
    rig.sense(servo_position_ratio=0.3)
    rig.steps(30)
    status = rig.now_sent("STATUS")[0]
    assert status.servo_position_ratio == pytest.approx(0.3)
    assert math.isnan(status.applied_position_ratio)
    assert status.rear_wheel_speed_radps * 0.287 == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize(
    ("reading", "told"),
    [(9.0, math.nan), (1.04, 1.04), (-0.04, 0.0), (-0.5, math.nan), (math.nan, math.nan)],
)
def test_impossible_servo_positions_never_break_the_frame(reading: float, told: float) -> None:
    rig = Rig("BrakeServo")
    rig.sense(servo_position_ratio=reading)
    rig.steps(2)
    position = rig.now_sent("STATUS")[0].servo_position_ratio
    assert position == pytest.approx(told, nan_ok=True)


def test_impossible_rear_speed_saturates() -> None:
    rig = Rig("BrakeServo")
    rig.speed_mps = 1e5
    rig.steps(5)
    assert rig.now_sent("STATUS")[0].rear_wheel_speed_radps == 200.0


@pytest.mark.parametrize("what", ["servo_position_ratio", "pedal_ratio"])
def test_broken_sensor_is_er1(what: str) -> None:
    rig = Rig("BrakeServo")
    rig.sense(**{what: math.nan})
    rig.steps(2)
    assert flags(rig.all_sent("DRIVER")[-1]) == {ErrorCode.ER1}


def test_pedal_moved_by_the_servo_is_no_driver() -> None:
    rig = braking(3.0)
    rig.steps(100)
    assert rig.sensors.pedal_ratio == 1.0
    assert not rig.node.is_driver_active
    assert rig.all_sent("DRIVER")[-1].pedal_ratio == 0.0


def test_driver_who_brakes_further_than_the_servo_is_seen() -> None:
    rig = Rig("BrakeServo").drive(0.4)
    rig.steps(20)
    rig.sense(pedal_ratio=0.47)
    rig.steps(8)
    assert rig.node.is_driver_active
    assert rig.all_sent("DRIVER")[-1].pedal_ratio == pytest.approx(0.07, abs=0.001)


def test_broken_pedal_is_not_available_and_no_driver() -> None:
    rig = Rig("BrakeServo")
    rig.sense(pedal_ratio=math.nan)
    rig.steps(10)
    assert math.isnan(rig.all_sent("DRIVER")[-1].pedal_ratio)
    assert not rig.node.is_driver_active


def test_starting_node_leaves_the_servo_to_its_watchdog_until_it_knows_who_drives() -> None:
    """Its power may have failed on the way: the watchdog brakes while the relay is closed."""
    rig = Rig("BrakeServo", started=False)
    rig.mode, rig.is_authorised = Mode.INIT, False
    for _ in range(50):
        assert rig.step() is None
    assert rig.state is NodeState.STARTING
    rig.mode = Mode.MANUAL
    rig.steps(2)
    assert rig.step() == RELEASED


def test_starting_node_brakes_when_the_supervisor_is_in_emergency() -> None:
    rig = Rig("BrakeServo", started=False)
    rig.mode, rig.is_authorised = Mode.INIT, False
    rig.steps(20)
    rig.mode = Mode.EMERGENCY
    rig.steps(2)
    assert rig.step() == FULL
