"""The steer ECU through its steps: following, holding, letting go; ER4 and ER6."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from dbc.messages import ErrorCode, Mode, NodeState, Reason
from ecus.steering.ecu import SteeringEcu
from tests.ecus.ecus_fakes import MS, Rig, changed, flags, sdo_write, tabby


def turned(angle_rad: float = 1.0, setpoint: float = 1.0) -> Rig:
    """Driving at 5 m/s with the wheel at an angle."""
    rig = Rig("Steering")
    rig.sense(column_angle_rad=angle_rad)
    rig.steps(30)
    rig.wheel_speed_radps = 5.0 / tabby().geometry.wheel_radius_m
    return rig.drive(setpoint)


def test_taking_over_starts_from_the_measured_angle_without_a_jerk() -> None:
    rig = Rig("Steering")
    rig.sense(column_angle_rad=3.0)
    rig.age_ms = math.nan  # no decision yet
    rig.steps(60)
    rig.mode = Mode.READY
    rig.steps(2)
    rig.mode, rig.is_authorised = Mode.AUTOMATIC, True
    actuator = rig.steps(3)
    assert actuator.motor_enabled and actuator.motor_duty_ratio == pytest.approx(0.0, abs=1e-9)
    assert rig.now_sent("STATUS")[0].applied_steering_wheel_angle_rad == 3.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_motor_turns_towards_the_command_and_the_echo_is_limited_in_rate(sign: float) -> None:
    rig = Rig("Steering").drive(sign * 5.0)
    for _ in range(20):
        actuator = rig.step()
        assert actuator.motor_enabled and sign * actuator.motor_duty_ratio > 0.0
    echoes = [m.applied_steering_wheel_angle_rad for m in rig.all_sent("STATUS")]
    steps = [abs(b - a) for a, b in pairwise(echoes)]
    assert max(steps) <= tabby().steering.wheel_rate_radps_max * 0.01 + 0.001
    assert sign * echoes[-1] > 0.5


def test_command_beyond_the_rack_is_limited() -> None:
    rig = Rig("Steering").drive(16.0)
    rig.steps(200)
    echo = rig.now_sent("STATUS")[0].applied_steering_wheel_angle_rad
    assert echo == pytest.approx(9.25, abs=0.001)


def test_status_tells_the_measured_angle_and_not_available_when_the_sensor_is_broken() -> None:
    rig = Rig("Steering")
    rig.sense(column_angle_rad=-4.2)
    rig.step()
    status = rig.now_sent("STATUS")[0]
    assert status.steering_wheel_angle_rad == pytest.approx(-4.2)
    assert math.isnan(status.applied_steering_wheel_angle_rad)
    rig.sense(column_angle_rad=9.7)
    rig.step()
    assert math.isnan(rig.now_sent("STATUS")[0].steering_wheel_angle_rad)


@pytest.mark.parametrize("angle_rad", [9.6, -9.6])
def test_sensor_just_inside_its_bounds_is_no_er6(angle_rad: float) -> None:
    rig = Rig("Steering")
    rig.sense(column_angle_rad=angle_rad)
    rig.steps(3)
    assert not flags(rig.all_sent("DRIVER")[-1])


def test_safe_state_holds_the_angle() -> None:
    rig = turned()
    rig.emergency()
    for _ in range(100):
        actuator = rig.step()
        assert actuator.motor_enabled
        rig.setpoint = -8.0  # nobody listens to the planner now
    assert rig.now_sent("STATUS")[0].applied_steering_wheel_angle_rad == pytest.approx(1.0, abs=0.1)


def test_held_angle_is_where_the_reference_was_and_is_reached_within_the_rate() -> None:
    rig = turned(0.0, 5.0)
    rig.steps(10)
    before = rig.now_sent("STATUS")[0].applied_steering_wheel_angle_rad
    rig.emergency()
    rig.steps(30)
    echoes = [m.applied_steering_wheel_angle_rad for m in rig.all_sent("STATUS")]
    assert echoes[-1] == pytest.approx(before, abs=0.15)
    assert max(abs(b - a) for a, b in pairwise(echoes)) <= 0.0878


def test_safe_alone_without_anybody_on_the_bus_holds_until_the_longest_stop() -> None:
    rig = turned()
    rig.mode = rig.age_ms = rig.wheel_speed_radps = rig.servo = None
    rig.steps(6)
    assert rig.state is NodeState.SAFE_ALONE and rig.output.actuator.motor_enabled
    held = 0
    while rig.step().motor_enabled:
        held += 1
    assert held * 0.01 == pytest.approx(tabby().longest_stop_s, abs=0.03)
    rig.steps(50)
    assert rig.is_idle  # for good


@pytest.mark.parametrize(("speed_mps", "holds"), [(0.51, True), (0.49, False), (-0.49, False)])
def test_hold_ends_below_half_a_metre_per_second(speed_mps: float, holds: bool) -> None:
    rig = turned()
    rig.emergency()
    rig.steps(5)
    rig.wheel_speed_radps = speed_mps / tabby().geometry.wheel_radius_m
    rig.steps(2)
    assert rig.output.actuator.motor_enabled is holds
    rig.wheel_speed_radps = 20.0
    rig.steps(5)
    assert rig.output.actuator.motor_enabled is holds  # for good


def test_unknown_speed_is_not_taken_for_slow() -> None:
    rig = turned()
    rig.emergency()
    rig.wheel_speed_radps = math.nan
    rig.steps(10)
    assert rig.output.actuator.motor_enabled


@pytest.mark.parametrize("torque_nm", [2.6, -2.6])
def test_drivers_hand_ends_the_hold_for_good(torque_nm: float) -> None:
    rig = turned()
    rig.emergency().steps(3)
    rig.sense(driver_torque_nm=torque_nm)
    rig.steps(5)
    assert rig.output.actuator.motor_enabled
    rig.step()
    assert rig.is_idle
    rig.sense(driver_torque_nm=0.0)
    rig.steps(20)
    assert rig.is_idle


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ({"motor_fault": True}, ErrorCode.ER4),
        ({"column_angle_rad": math.nan}, ErrorCode.ER6),
        ({"column_angle_rad": math.inf}, ErrorCode.ER6),
        ({"driver_torque_nm": math.nan}, ErrorCode.ER6),
    ],
)
def test_er4_and_er6_open_the_motor_at_once_and_call_for_the_brake(
    values: dict[str, float], code: ErrorCode
) -> None:
    rig = turned()
    sound = rig.sensors
    rig.sense(**values)
    rig.step()
    assert rig.state is NodeState.SAFE_ALONE and rig.is_idle
    assert rig.now_sent("EMERGENCY_BRAKE")[0].code is code
    assert flags(rig.now_sent("DRIVER")[0]) == {code}
    rig.sensors = sound
    rig.steps(20)
    assert rig.is_idle  # a fault that went away does not close it again


@pytest.mark.parametrize("values", [{"motor_fault": True}, {"column_angle_rad": math.nan}])
def test_er4_and_er6_end_a_hold(values: dict[str, float]) -> None:
    rig = turned()
    rig.emergency().steps(3)
    assert rig.output.actuator.motor_enabled
    rig.sense(**values)
    rig.step()
    assert rig.is_idle


def test_emergency_of_a_released_node_does_not_move_the_wheel() -> None:
    rig = Rig("Steering")
    rig.emergency().steps(20)
    assert rig.state is NodeState.EMERGENCY and rig.is_idle


def test_motor_that_speeds_up_the_wheel_is_no_driver() -> None:
    rig = Rig("Steering").drive()
    inertia = tabby().steering.wheel_inertia_kgm2
    angle, rate = 0.0, 0.0
    for count in range(40):
        acceleration = 80.0 if count < 10 else 0.0 if count < 30 else -80.0
        rate += acceleration * 0.01
        angle += rate * 0.01
        rig.sense(column_angle_rad=angle, driver_torque_nm=-inertia * acceleration)
        rig.step()
        assert not rig.node.is_driver_active
    assert max(abs(d.torque_nm) for d in rig.all_sent("DRIVER")) < 2.5


def test_torque_beyond_the_signal_saturates_and_broken_torque_is_not_available() -> None:
    rig = Rig("Steering")
    rig.sense(driver_torque_nm=-1e6)
    rig.steps(2)
    assert rig.all_sent("DRIVER")[-1].torque_nm == -40.0
    rig.sense(driver_torque_nm=math.nan)
    rig.steps(2)
    assert math.isnan(rig.all_sent("DRIVER")[-1].torque_nm)
    assert not rig.node.is_driver_active


def test_er6_reason_and_emcy_name_the_sensor() -> None:
    rig = turned()
    rig.sense(column_angle_rad=math.nan)
    rig.step()
    (emcy,) = rig.now_sent("EMCY")
    assert (emcy.error_code, emcy.er_code) == (0xFF06, ErrorCode.ER6)
    assert emcy.reason is Reason.SENSOR_OUT_OF_BOUNDS and emcy.er_bits == 1 << 6


def test_driver_in_automatic_is_followed_by_nothing_until_the_supervisor_decides() -> None:
    rig = turned()
    rig.sense(driver_torque_nm=5.0)
    rig.steps(10)
    assert rig.state is NodeState.ACTIVE and rig.output.actuator.motor_enabled
    assert not rig.all_sent("EMERGENCY_BRAKE")


def test_written_angle_limit_beyond_the_sensor_is_cut_to_it() -> None:
    vehicle = changed(
        tabby(),
        steering={"wheel_angle_rad_max": 4.0, "sensor_angle_rad_max": 5.0},
    )
    rig = Rig("Steering", vehicle)
    rig.extra.append(sdo_write("Steering", 5, 9000))
    rig.step()
    assert isinstance(rig.node, SteeringEcu)
    assert rig.node.params.wheel_angle_rad_max == 5.0


def test_held_time_counts_from_the_last_step_that_followed() -> None:
    rig = turned()
    rig.steps(500)
    rig.emergency().steps(20)
    assert rig.output.actuator.motor_enabled
    assert rig.now_ns > 5_000 * MS


# The sensor's zero -------------------------------------------------------------------------------


def crooked(zero_rad: float) -> Rig:
    """A car whose file says what the sensor reads straight ahead."""
    vehicle = tabby()
    return Rig("Steering", replace(vehicle, steering=replace(vehicle.steering, zero_rad=zero_rad)))


@pytest.mark.parametrize("zero_rad", [0.2, -0.2])
def test_the_zero_of_the_vehicle_file_is_taken_off_the_reading(zero_rad: float) -> None:
    rig = crooked(zero_rad)
    rig.sense(column_angle_rad=1.0 + zero_rad)
    rig.steps(30)
    rig.drive(1.0)
    rig.step()
    status = rig.now_sent("STATUS")[0]
    assert status.steering_wheel_angle_rad == pytest.approx(1.0, abs=0.0003)
    assert status.applied_steering_wheel_angle_rad == pytest.approx(1.0, abs=0.0003)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sensor_is_broken_by_what_it_reads_whatever_its_zero(sign: float) -> None:
    rig = crooked(0.2)
    for reading_rad, is_broken in ((sign * 9.59, False), (sign * 9.61, True)):
        rig.sense(column_angle_rad=reading_rad)
        rig.step()
        assert math.isnan(rig.now_sent("STATUS")[0].steering_wheel_angle_rad) is is_broken


def test_a_written_range_leaves_room_for_the_zero() -> None:
    rig = crooked(0.2)
    rig.extra.append(sdo_write("Steering", 5, 9590))
    rig.steps(2)
    assert rig.node.params.wheel_angle_rad_max == pytest.approx(9.4)
