"""CarCommand and CmdVel as decisions, and the electronic differential, by hand."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.commands import CommandError, Decision
from gateway.kinematics import Kinematics, WheelSpeeds
from gateway.motion_commands import decide_car_command, decide_cmd_vel
from vehicles import load_vehicle

BAJA = load_vehicle("baja_5b")
KIN = Kinematics.of(BAJA.geometry, BAJA.steering)
CURVATURE_MAX = BAJA.curvature_per_m_max
SPEED_MAX = BAJA.traction.speed_mps_max

speeds = st.floats(0.0, SPEED_MAX)
curvatures = st.floats(-CURVATURE_MAX, CURVATURE_MAX)


def test_the_differential_turns_the_wheels_about_one_centre() -> None:
    # R = 1.6 m, track 0.4 m, 0.4 m/s: 0.25 rad/s x (1.6 -+ 0.2) m
    wheels = KIN.rear_wheel_speeds_mps(0.4, 1 / 1.6)
    assert (wheels.left_mps, wheels.right_mps) == pytest.approx((0.35, 0.45))
    assert KIN.rear_wheel_speeds_mps(0.4, -1 / 1.6).left_mps == pytest.approx(0.45)
    assert KIN.rear_wheel_speeds_mps(0.4, 0.0) == WheelSpeeds(left_mps=0.4, right_mps=0.4)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(speed=speeds, curvature=curvatures)
def test_the_wheels_mean_is_the_cars_speed_and_their_difference_its_yaw_rate(
    speed: float, curvature: float
) -> None:
    wheels = KIN.rear_wheel_speeds_mps(speed, curvature)
    assert (wheels.left_mps + wheels.right_mps) / 2 == pytest.approx(speed)
    yaw_radps = (wheels.right_mps - wheels.left_mps) / BAJA.geometry.track_m
    assert yaw_radps == pytest.approx(KIN.yaw_rate_radps(speed, curvature), abs=1e-12)


def test_a_missing_speed_stays_missing() -> None:
    assert math.isnan(KIN.rear_wheel_speeds_mps(math.nan, 0.1).left_mps)
    assert math.isnan(KIN.rear_wheel_speeds_mps(1.0, math.nan).right_mps)


@pytest.mark.parametrize(("radius_m", "yaw_rate_radps"), [(1.6, 0.25), (2.0, 0.20)])
@pytest.mark.parametrize("side", [1, -1])
def test_cmd_vel_of_the_papers_circles(radius_m: float, yaw_rate_radps: float, side: int) -> None:
    decision = decide_cmd_vel(BAJA, speed_mps=0.4, yaw_rate_radps=side * yaw_rate_radps)
    assert decision.speed_mps == 0.4
    assert decision.curvature_per_m == pytest.approx(side / radius_m)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(speed=st.floats(1e-3, SPEED_MAX), curvature=curvatures)
def test_every_curvature_that_the_car_reaches_can_be_asked_for_either_way(
    speed: float, curvature: float
) -> None:
    by_yaw_rate = decide_cmd_vel(
        BAJA, speed_mps=speed, yaw_rate_radps=KIN.yaw_rate_radps(speed, curvature)
    )
    wheels = KIN.rear_wheel_speeds_mps(speed, curvature)
    by_wheels = decide_car_command(
        BAJA,
        left_mps=wheels.left_mps,
        right_mps=wheels.right_mps,
        ackermann_rad=KIN.road_wheel_angle_rad(curvature),
    )
    for decision in (by_yaw_rate, by_wheels):
        assert decision.speed_mps == pytest.approx(speed)
        assert decision.curvature_per_m == pytest.approx(curvature, abs=1e-9)


def test_standing_still_is_a_decision_and_turning_on_the_spot_is_none() -> None:
    assert decide_cmd_vel(BAJA, speed_mps=0.0, yaw_rate_radps=0.0) == Decision(
        speed_mps=0.0, curvature_per_m=0.0
    )
    with pytest.raises(CommandError, match=r"^yaw_rate_radps = 0.1: allowed -?0 to 0 rad/s$"):
        decide_cmd_vel(BAJA, speed_mps=0.0, yaw_rate_radps=0.1)
    standing = decide_car_command(BAJA, left_mps=0, right_mps=0, ackermann_rad=0.3)
    assert standing.speed_mps == 0.0
    assert standing.curvature_per_m == pytest.approx(math.tan(0.3) / 0.57)


@pytest.mark.parametrize("value", [0.31, -0.31, math.nan, math.inf])
def test_a_yaw_rate_out_of_reach_names_field_value_and_range(value: float) -> None:
    high = 0.4 * CURVATURE_MAX
    with pytest.raises(CommandError, match=rf"^yaw_rate_radps = .*allowed -{high:.6g} to .* rad/s"):
        decide_cmd_vel(BAJA, speed_mps=0.4, yaw_rate_radps=value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ackermann_rad": 0.41}, r"^ackermann_rad = 0.41: allowed -0.4 to 0.4 rad"),
        ({"ackermann_rad": math.nan}, r"^ackermann_rad = nan"),
        ({"left_mps": -1.03}, r"^left_mps = -1.03: allowed -1.02 to 2.52 m/s"),
        ({"right_mps": math.inf}, r"^right_mps = inf: allowed -1.02 to"),
        ({"left_mps": 2.52, "right_mps": 2.52}, r"^speed_mps = 2.52: allowed -1 to 2.5 m/s"),
    ],
)
def test_a_car_command_out_of_range_names_field_value_and_range(
    change: dict[str, float], message: str
) -> None:
    values: dict[str, Any] = {"left_mps": 1.0, "right_mps": 1.0, "ackermann_rad": 0.0} | change
    with pytest.raises(CommandError, match=message):
        decide_car_command(BAJA, **values)


def test_wheels_that_do_not_fit_the_angle_are_refused_and_told_what_would() -> None:
    angle = KIN.road_wheel_angle_rad(1 / 1.6)
    with pytest.raises(
        CommandError, match=r"^right_mps - left_mps = 0: .* allowed 0.072 to 0.128 m/s"
    ):
        decide_car_command(BAJA, left_mps=0.4, right_mps=0.4, ackermann_rad=angle)
    decide_car_command(BAJA, left_mps=0.363, right_mps=0.437, ackermann_rad=angle)
    for left_mps, right_mps in ((0.365, 0.435), (0.335, 0.465), (0.45, 0.35)):
        with pytest.raises(CommandError, match="electronic differential"):
            decide_car_command(
                BAJA, left_mps=left_mps, right_mps=right_mps, ackermann_rad=angle
            )


@pytest.mark.parametrize("value", [True, "1", None])
@pytest.mark.parametrize("field", ["left_mps", "right_mps", "ackermann_rad"])
def test_a_wrong_type_is_a_type_error_that_names_the_field(field: str, value: Any) -> None:
    values: dict[str, Any] = {"left_mps": 1.0, "right_mps": 1.0, "ackermann_rad": 0.0, field: value}
    with pytest.raises(TypeError, match=f"^{field} = "):
        decide_car_command(BAJA, **values)
