"""Backwards through the gateway: ranges, turning round, and the brake."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gateway.brake import brake_position_ratio
from gateway.commands import CommandError, Decision, decide
from gateway.direction import Rolling, TurningRound
from gateway.kinematics import Kinematics
from gateway.motion_commands import decide_car_command, decide_cmd_vel
from vehicles import Vehicle, load_vehicle

MS = 1_000_000
TABBY = load_vehicle("tabby_evo")  # 1.5 m/s backwards
RADIUS_M = TABBY.geometry.wheel_radius_m
FORWARDS_ONLY = replace(TABBY, traction=replace(TABBY.traction, reverse_speed_mps_max=0.0))


def test_the_reverse_speed_of_the_vehicle_is_the_limit() -> None:
    assert decide(TABBY, speed_mps=-1.5, curvature_per_m=0.0).speed_mps == -1.5
    with pytest.raises(CommandError, match=r"speed_mps = -1\.501: allowed -1\.5 to 7\.5 m/s"):
        decide(TABBY, speed_mps=-1.501, curvature_per_m=0.0)


@pytest.mark.parametrize("speed_mps", [-0.001, -1.0, -math.inf])
def test_a_vehicle_without_reverse_refuses(speed_mps: float) -> None:
    with pytest.raises(CommandError, match=r"allowed 0 to 7\.5 m/s"):
        decide(FORWARDS_ONLY, speed_mps=speed_mps, curvature_per_m=0.0)


@pytest.mark.parametrize("yaw_rate_radps", [0.05, -0.05])
def test_a_cmd_vel_backwards_turns_the_car_as_asked(yaw_rate_radps: float) -> None:
    decision = decide_cmd_vel(TABBY, speed_mps=-1.0, yaw_rate_radps=yaw_rate_radps)
    assert decision.speed_mps * decision.curvature_per_m == pytest.approx(yaw_rate_radps)
    limit = TABBY.curvature_per_m_max
    decide_cmd_vel(TABBY, speed_mps=-1.0, yaw_rate_radps=limit)
    with pytest.raises(CommandError, match="yaw_rate_radps"):
        decide_cmd_vel(TABBY, speed_mps=-1.0, yaw_rate_radps=limit * 1.001)


def test_a_car_command_backwards_has_both_wheels_backwards() -> None:
    kinematics = Kinematics.of(TABBY.geometry, TABBY.steering)
    wheels = kinematics.rear_wheel_speeds_mps(-1.0, 0.05)
    assert abs(wheels.right_mps) > abs(wheels.left_mps)  # outside of a turn with wheels to the left
    angle = kinematics.road_wheel_angle_rad(0.05)
    given = {"left_mps": wheels.left_mps, "right_mps": wheels.right_mps, "ackermann_rad": angle}
    decision = decide_car_command(TABBY, **given)
    assert decision.speed_mps == pytest.approx(-1.0)
    assert decision.curvature_per_m == pytest.approx(0.05)
    with pytest.raises(CommandError, match="left_mps"):
        decide_car_command(FORWARDS_ONLY, **given)
    with pytest.raises(CommandError, match="differential"):
        decide_car_command(TABBY, left_mps=-1.2, right_mps=-0.8, ackermann_rad=angle)


# Turning round -----------------------------------------------------------------------------------


def rolling(front_mps: float, rear_mps: float | None = None, applied_mps: float = 0.0) -> Rolling:
    """Both axles alike, unless one is told apart."""
    rear_mps = front_mps if rear_mps is None else rear_mps
    return Rolling(front_mps=front_mps, rear_mps=rear_mps, applied_mps=applied_mps)


STANDING = rolling(0.0)


def backwards() -> TurningRound:
    """Has turned round by 600 ms."""
    turning = TurningRound()
    assert turning.commanded_mps(0, -1.0, STANDING) == 0.0
    assert turning.commanded_mps(600 * MS, -1.0, STANDING) == -1.0
    return turning


def test_forwards_and_standing_pass_at_once() -> None:
    turning = TurningRound()
    for wanted in (0.0, 3.0, 0.0):
        assert turning.commanded_mps(0, wanted, rolling(2.0)) == wanted


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_other_direction_comes_after_600_ms_at_standstill(sign: float) -> None:
    turning = TurningRound() if sign > 0.0 else backwards()
    began_ns = 1_000 * MS
    for n in range(50):
        commanded = turning.commanded_mps(began_ns + n * 20 * MS, -sign, rolling(sign * 0.5))
        assert commanded == 0.0
    stood_ns = began_ns + 1_000 * MS
    assert turning.commanded_mps(stood_ns, -sign, rolling(sign * 0.09)) == 0.0
    assert turning.commanded_mps(stood_ns + 599 * MS, -sign, STANDING) == 0.0
    assert turning.commanded_mps(stood_ns + 600 * MS, -sign, STANDING) == -sign
    moving = rolling(-sign * 0.5, applied_mps=-sign * 0.5)
    assert turning.commanded_mps(stood_ns + 620 * MS, -sign, moving) == -sign


@pytest.mark.parametrize("other_mps", [math.nan, 1.0])
def test_an_axle_that_is_not_known_or_rolls_on_is_no_standstill(other_mps: float) -> None:
    for now in (rolling(0.0, other_mps), rolling(other_mps, 0.0)):
        turning = TurningRound()
        turning.commanded_mps(0, -1.0, STANDING)
        assert turning.commanded_mps(400 * MS, -1.0, now) == 0.0
        assert turning.commanded_mps(800 * MS, -1.0, STANDING) == 0.0
        assert turning.commanded_mps(1_400 * MS, -1.0, STANDING) == -1.0


def test_a_car_that_was_told_to_go_has_not_stood() -> None:
    turning = TurningRound()  # a hill start that has not moved the car yet
    turning.commanded_mps(0, 0.0, STANDING)
    assert turning.commanded_mps(1_000 * MS, 1.0, STANDING) == 1.0
    assert turning.commanded_mps(1_020 * MS, -1.0, STANDING) == 0.0
    assert turning.commanded_mps(1_620 * MS, -1.0, STANDING) == -1.0


def test_a_car_that_was_told_to_stand_has_stood() -> None:
    turning = TurningRound()
    turning.commanded_mps(0, 0.0, STANDING)
    assert turning.commanded_mps(600 * MS, -1.0, STANDING) == -1.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_car_that_rolls_the_other_way_with_nothing_applied_is_held_first(sign: float) -> None:
    turning = TurningRound() if sign > 0.0 else backwards()
    began_ns = 1_000 * MS
    driven = rolling(-sign * 0.5, applied_mps=sign * 0.1)
    assert turning.commanded_mps(began_ns, sign, driven) == sign  # the drive is at it already
    for away in (rolling(-sign * 0.1), rolling(-sign * 0.1, 0.0), rolling(math.nan, -sign * 0.1)):
        assert turning.commanded_mps(began_ns, sign, away) == 0.0
    assert turning.commanded_mps(began_ns, sign, STANDING) == 0.0
    assert turning.commanded_mps(began_ns + 599 * MS, sign, STANDING) == 0.0
    assert turning.commanded_mps(began_ns + 600 * MS, sign, STANDING) == sign


def test_the_next_drive_begins_forwards() -> None:
    turning = backwards()
    turning.forget()
    assert turning.commanded_mps(620 * MS, -1.0, STANDING) == 0.0


# The brake ---------------------------------------------------------------------------------------


def ratio(speed_mps: float, measured_mps: float, applied_mps: float, car: Vehicle = TABBY) -> float:
    decision = Decision(speed_mps=speed_mps, curvature_per_m=0.0)
    return brake_position_ratio(car, decision, measured_mps / RADIUS_M, applied_mps / RADIUS_M)


@pytest.mark.parametrize(
    ("speed_mps", "measured_mps", "applied_mps"),
    [(0.5, 3.0, 1.0), (0.0, 3.0, 0.0), (0.0, 0.6, 0.0), (0.0, 0.3, 0.0), (1.0, 0.8, 1.0),
     (0.0, 2.0, 1.0), (1.0, 0.0, 0.0)],
)  # fmt: skip
def test_the_brake_is_the_same_backwards(
    speed_mps: float, measured_mps: float, applied_mps: float
) -> None:
    assert ratio(-speed_mps, -measured_mps, -applied_mps) == ratio(
        speed_mps, measured_mps, applied_mps
    )


def test_a_car_that_rolls_backwards_though_told_to_stand_is_braked() -> None:
    assert ratio(0.0, -2.0, 0.0) > TABBY.brake.hold_ratio
