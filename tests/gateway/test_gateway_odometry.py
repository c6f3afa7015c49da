"""The pose by the wheels: on paper, with missing frames, and against the truth of a lap."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dbc.database import VEHICLE_DBC, load
from gateway.api import Car
from gateway.commands import CommandError
from gateway.core import PlannerInputs
from gateway.odometry import ROLLED_NS_MAX, SPEED_STEP_RADPS, ErrorSources, Odometry
from gateway.poses import GivenPose, OdometryPose
from tests.gateway.scripted import MS, TABBY, Rig, RigLink

RADIUS_M = TABBY.geometry.wheel_radius_m
HALF_TRACK_M = 0.5 * TABBY.geometry.track_m
NO_ERRORS = ErrorSources(
    wheel_radius_ratio=0.0, rounded_speed_ratio=0.0, speed_delay_s=0.0, curvature_ratio=0.0,
    steering_zero_ratio=0.0, curvature_delay_s=0.0, position_walk_m=0.0, heading_walk_rad=0.0,
)  # fmt: skip


def driven(
    speed_mps: float, wheel_rad: float, duration_s: float, sources: ErrorSources | None = None
) -> Odometry:
    """A car that has been at one speed on one circle all the time."""
    odometry = Odometry(TABBY, sources)
    drive_on(odometry, speed_mps, wheel_rad, 0, duration_s)
    return odometry


def drive_on(
    odometry: Odometry, speed_mps: float, wheel_rad: float, start_ns: int, duration_s: float
) -> int:
    curvature_per_m = math.tan(wheel_rad / 40.0) / 2.36
    left_mps = speed_mps * (1.0 - HALF_TRACK_M * curvature_per_m)
    for number in range(round(duration_s * 100) + 1):
        now_ns = start_ns + number * 10 * MS
        odometry.steered(now_ns, wheel_rad)
        odometry.rolled(now_ns, left_mps / RADIUS_M)
    return now_ns


def test_a_circle_by_the_left_wheel_is_that_of_the_axles_centre() -> None:
    # 5 m/s for 6 s on a radius of 2.36 / tan(5 / 40) = 18.78 m: 30 m are 1.597 rad of it
    pose = driven(5.0, 5.0, 6.0).pose(6000 * MS)
    radius_m = 2.36 / math.tan(0.125)
    assert pose.way_m == pytest.approx(30.0)
    assert pose.heading_rad == pytest.approx(30.0 / radius_m)
    assert pose.x_m == pytest.approx(radius_m * math.sin(30.0 / radius_m), abs=1e-3)
    assert pose.y_m == pytest.approx(radius_m * (1.0 - math.cos(30.0 / radius_m)), abs=1e-3)
    assert pose.speed_mps == pytest.approx(5.0)


def test_the_heading_is_wrapped_and_a_pose_given_is_gone_on_from() -> None:
    odometry = Odometry(TABBY)
    odometry.give(GivenPose(x_m=100.0, y_m=-7.0, heading_rad=math.pi - 0.1))
    drive_on(odometry, 5.0, 5.0, 0, 6.0)
    pose = odometry.pose(6000 * MS)
    turned = 30.0 * math.tan(0.125) / 2.36
    assert pose.heading_rad == pytest.approx(math.pi - 0.1 + turned - 2.0 * math.pi)
    assert pose.x_m < 100.0 and -math.pi <= pose.heading_rad <= math.pi


def test_backwards_goes_back() -> None:
    odometry = driven(2.0, 1.0, 3.0)
    drive_on(odometry, -2.0, 1.0, 3010 * MS, 3.0)
    pose = odometry.pose(6010 * MS)
    assert (pose.x_m, pose.y_m, pose.heading_rad) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert pose.way_m == pytest.approx(12.0, abs=0.02)


def test_a_car_that_stands_goes_nowhere_and_its_error_grows_no_more() -> None:
    odometry = driven(4.0, 0.0, 2.0)
    drive_on(odometry, 0.0, 0.0, 2010 * MS, 0.0)
    stopped = odometry.pose(2010 * MS)
    for number in range(200):
        now_ns = (2020 + number * 10) * MS
        odometry.steered(now_ns, 0.3 * (-1) ** number)
        odometry.rolled(now_ns, 0.0)
    assert replace(odometry.pose(now_ns), time_ns=stopped.time_ns) == stopped


@pytest.mark.parametrize(
    ("source", "across"),
    [("wheel_radius_ratio", False), ("rounded_speed_ratio", False), ("curvature_ratio", True),
     ("steering_zero_ratio", True)],
)  # fmt: skip
def test_the_error_by_each_constant_is_what_a_car_that_is_off_by_it_would_do(
    source: str, across: bool
) -> None:
    size = 0.002
    sources = replace(NO_ERRORS, **{source: size})
    straight, wheel_rad = 0.0, 3.0
    sure = driven(5.0, wheel_rad if source == "curvature_ratio" else straight, 4.0, sources)
    pose = sure.pose(4000 * MS)
    zero_rad = size * 9.25
    off = {
        "wheel_radius_ratio": lambda: driven(5.0 * (1.0 + size), straight, 4.0),
        "rounded_speed_ratio": lambda: driven(5.0 + size * 0.1 * RADIUS_M, straight, 4.0),
        "curvature_ratio": lambda: driven(
            5.0, 40.0 * math.atan((1.0 + size) * math.tan(wheel_rad / 40.0)), 4.0
        ),
        "steering_zero_ratio": lambda: driven(5.0, zero_rad, 4.0),
    }[source]().pose(4000 * MS)
    strayed_m = math.hypot(off.x_m - pose.x_m, off.y_m - pose.y_m)
    assert pose.position_sigma_m == pytest.approx(strayed_m, rel=0.02)
    turned_rad = off.heading_rad - pose.heading_rad
    assert pose.heading_sigma_rad == pytest.approx(abs(turned_rad), rel=0.02, abs=1e-9)
    assert (turned_rad > 0.0) is across


def test_delays_cost_what_the_speed_has_changed_by_and_the_curvature_has_swung_by() -> None:
    late = replace(NO_ERRORS, speed_delay_s=0.02)
    odometry = driven(0.0, 0.0, 0.1, late)
    drive_on(odometry, 5.0, 0.0, 110 * MS, 2.0)
    assert odometry.pose(2110 * MS).position_sigma_m == pytest.approx(0.02 * 5.0, rel=0.01)
    late = replace(NO_ERRORS, curvature_delay_s=0.05)
    odometry = driven(5.0, 0.0, 1.0, late)
    drive_on(odometry, 5.0, 4.0, 1010 * MS, 1.0)
    turn_rad = 0.05 * 5.0 * math.tan(0.1) / 2.36
    assert odometry.pose(2010 * MS).heading_sigma_rad == pytest.approx(turn_rad, rel=0.02)


def test_walks_grow_with_the_root_of_the_way_and_constants_with_the_way() -> None:
    walk = replace(NO_ERRORS, position_walk_m=0.01)
    short, long = (driven(5.0, 0.0, span, walk) for span in (4.0, 16.0))
    assert short.pose(4000 * MS).position_sigma_m == pytest.approx(0.01 * math.sqrt(20.0))
    assert long.pose(16000 * MS).position_sigma_m == pytest.approx(0.02 * math.sqrt(20.0))
    scale = replace(NO_ERRORS, wheel_radius_ratio=0.01)
    short, long = (driven(5.0, 0.0, span, scale) for span in (4.0, 16.0))
    assert short.pose(4000 * MS).position_sigma_m == pytest.approx(0.2)
    assert long.pose(16000 * MS).position_sigma_m == pytest.approx(0.8)


def test_a_walk_of_the_heading_and_a_given_error_swing_the_way_across() -> None:
    walk = replace(NO_ERRORS, heading_walk_rad=0.001)
    pose = driven(5.0, 0.0, 4.0, walk).pose(4000 * MS)
    # a random walk of the heading after s metres: variances q s, and q s3 / 3 across
    assert pose.heading_sigma_rad == pytest.approx(0.001 * math.sqrt(20.0))
    assert pose.position_sigma_m == pytest.approx(0.001 * math.sqrt(20.0**3 / 3.0), rel=0.01)
    odometry = Odometry(TABBY, NO_ERRORS)
    odometry.give(GivenPose(x_m=0.0, y_m=0.0, heading_rad=0.0, position_sigma_m=0.3,
                            heading_sigma_rad=0.02))  # fmt: skip
    drive_on(odometry, 5.0, 0.0, 0, 4.0)
    pose = odometry.pose(4000 * MS)
    assert pose.covariance[0] == pytest.approx(0.3**2, rel=0.01)
    assert pose.covariance[2] == pytest.approx(0.3**2 + 0.4**2, rel=0.01)
    assert pose.covariance[4] == pytest.approx(20.0 * 0.02**2)


def test_the_covariance_is_that_of_many_cars_with_errors_of_their_own() -> None:
    rng = np.random.default_rng(5)
    sources = replace(NO_ERRORS, wheel_radius_ratio=0.01, steering_zero_ratio=0.004,
                      curvature_ratio=0.03)  # fmt: skip

    def way(radius: float, zero_rad: float, scale: float) -> OdometryPose:
        """A straight, a bend to the left and a straight."""
        odometry, now_ns = Odometry(TABBY, sources), 0
        for wheel_rad, span_s in ((0.0, 4.0), (5.0, 5.0), (0.0, 4.0)):
            true_rad = 40.0 * math.atan(scale * math.tan((wheel_rad + zero_rad) / 40.0))
            now_ns = 10 * MS + drive_on(odometry, 5.0 * radius, true_rad, now_ns, span_s)
        return odometry.pose(now_ns)

    cars = [way(1.0 + 0.01 * a, 0.004 * 9.25 * b, 1.0 + 0.03 * c)
            for a, b, c in rng.standard_normal((300, 3)).tolist()]  # fmt: skip
    spread = np.cov([(car.x_m, car.y_m, car.heading_rad) for car in cars], rowvar=False)
    xx, xy, yy, xh, yh, hh = way(1.0, 0.0, 1.0).covariance
    found = np.array([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]])
    scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    np.testing.assert_allclose(found / scale, spread / scale, atol=0.25)


def assert_unknown(pose: OdometryPose) -> None:
    assert all(math.isnan(value) for value in (pose.x_m, pose.y_m, pose.heading_rad, pose.way_m))
    assert math.isnan(pose.position_sigma_m) and math.isnan(pose.heading_sigma_rad)


def test_without_frames_and_while_they_are_late_the_pose_is_not_known() -> None:
    assert_unknown(Odometry(TABBY).pose(0))
    odometry = driven(5.0, 0.0, 1.0)
    assert odometry.pose(1000 * MS + ROLLED_NS_MAX).x_m == pytest.approx(5.0)
    late = odometry.pose(1000 * MS + ROLLED_NS_MAX + 1)
    assert_unknown(late)
    assert math.isnan(late.speed_mps)


@pytest.mark.parametrize("missing", ["gap", "speed", "angle", "late angle"])
def test_after_a_gap_the_pose_is_unknown_until_it_is_given_again(missing: str) -> None:
    odometry = driven(5.0, 0.0, 1.0)
    now_ns = 1010 * MS
    if missing == "gap":
        now_ns = 1000 * MS + ROLLED_NS_MAX + 10 * MS
    elif missing == "speed":
        odometry.rolled(now_ns, math.nan)
    elif missing == "angle":
        odometry.steered(now_ns, math.nan)
        odometry.rolled(now_ns, 5.0 / RADIUS_M)
    else:
        for late_ns in range(now_ns, now_ns + 200 * MS, 10 * MS):
            odometry.rolled(late_ns, 5.0 / RADIUS_M)
        now_ns += 200 * MS
    now_ns = drive_on(odometry, 5.0, 0.0, now_ns + 10 * MS, 0.5)
    lost = odometry.pose(now_ns)
    assert_unknown(lost)
    assert lost.speed_mps == pytest.approx(5.0) and lost.time_ns == now_ns
    odometry.give(GivenPose(x_m=50.0, y_m=2.0, heading_rad=0.0))
    now_ns = drive_on(odometry, 5.0, 0.0, now_ns + 10 * MS, 1.0)
    assert odometry.pose(now_ns).x_m == pytest.approx(55.05)
    assert odometry.pose(now_ns).y_m == pytest.approx(2.0)


def test_a_lost_frame_costs_nothing_at_a_steady_speed() -> None:
    odometry = driven(5.0, 0.0, 1.0)
    now_ns = drive_on(odometry, 5.0, 0.0, 1030 * MS, 1.0)
    assert odometry.pose(now_ns).x_m == pytest.approx(10.15)


def test_the_speeds_resolution_is_that_of_the_dbc() -> None:
    message = load(VEHICLE_DBC).get_message_by_name("BRAKE_STATUS")
    assert message.get_signal_by_name("rear_wheel_speed_radps").scale == SPEED_STEP_RADPS


def test_the_state_has_the_pose_by_the_frames_and_a_planner_gives_another() -> None:
    rig = Rig().start()
    rig.set("BRAKE_STATUS", rear_wheel_speed_radps=20.0)
    rig.set("STEER_STATUS", steering_wheel_angle_rad=0.0)
    rig.run(1000)
    pose = rig.state().odometry
    assert pose.x_m == pytest.approx(20.0 * RADIUS_M, rel=0.01)
    assert pose.time_ns == rig.now_ns - MS
    with Car(RigLink(rig)) as car:
        car.give_pose(x_m=7.0, y_m=8.0, heading_rad=1.0, position_sigma_m=0.02)
        given = car.state.odometry
        assert (given.x_m, given.y_m, given.heading_rad, given.way_m) == (7.0, 8.0, 1.0, 0.0)
        assert given.position_sigma_m == pytest.approx(0.02)
        with pytest.raises(CommandError, match="x_m = nan: allowed"):
            car.give_pose(x_m=math.nan, y_m=0.0, heading_rad=0.0)
        with pytest.raises(CommandError, match=r"heading_sigma_rad = 4\.0: allowed 0 to 3\.14159"):
            car.give_pose(x_m=0.0, y_m=0.0, heading_rad=0.0, heading_sigma_rad=4.0)
        with pytest.raises(TypeError, match="y_m = 'a': a number is wanted"):
            car.give_pose(x_m=0.0, y_m="a", heading_rad=0.0)  # type: ignore[arg-type]
        assert car.state.odometry == given


def test_a_wheel_that_is_not_measured_loses_the_pose_in_the_state() -> None:
    rig = Rig().start()
    rig.set("BRAKE_STATUS", rear_wheel_speed_radps=20.0)
    rig.run(100)
    rig.muted.add("BrakeServo")
    rig.run(100)
    assert math.isnan(rig.state().odometry.speed_mps)
    rig.muted.clear()
    rig.run(100)
    assert_unknown(rig.state().odometry)
    rig.core.step(rig.now_ns, [], PlannerInputs(pose=GivenPose(x_m=1.0, y_m=2.0, heading_rad=0.0)))
    assert rig.state().odometry.y_m == 2.0
