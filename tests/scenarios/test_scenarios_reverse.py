"""Backwards through the gateway, in the whole stack: all three cars."""

from __future__ import annotations

import math

import pytest

from dbc.messages import ErrorCode, Mode, Reason, Request
from oracle.judge import Oracle
from simulation.observer import Observer
from tests.scenarios.driving import Drive, held_on_a_slope
from vehicles import known_vehicles, load_vehicle

pytestmark = pytest.mark.whole_car

NAMES = pytest.mark.parametrize("name", known_vehicles())
BACK_MPS = -0.9
"""Each car's own limit is 1 m/s or more."""


def reversing(name: str = "tabby_evo", speed_mps: float = BACK_MPS) -> Drive:
    """Drives backwards."""
    drive = Drive(vehicle=load_vehicle(name)).start()
    drive.press_button()
    drive.engage()
    drive.speed_mps = speed_mps
    drive.run(5.0)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert drive.speed == pytest.approx(speed_mps, abs=0.1)
    return drive


@NAMES
def test_forwards_stop_backwards_stop_and_forwards_again(name: str) -> None:
    drive = Drive(vehicle=load_vehicle(name))
    oracle = Oracle(drive.world.vehicle)
    Observer(drive.world, oracle)
    drive.go(2.0)
    for wanted_mps, span_s in ((0.0, 4.0), (BACK_MPS, 5.0), (0.0, 4.0), (1.5, 5.0), (-0.5, 8.0)):
        drive.speed_mps = wanted_mps
        drive.run(span_s)
        assert drive.is_in(Mode.AUTOMATIC), drive.log()
        assert drive.speed == pytest.approx(wanted_mps, abs=0.1)
        assert drive.state.speed_mps == pytest.approx(drive.speed, abs=0.15)  # signed
    drive.request(Request.DISENGAGE, 3.0)
    assert drive.is_in(Mode.READY) and abs(drive.speed) < 0.02
    report = oracle.finish(drive.world.now_ns)
    assert not report.violations, str(report)


@NAMES
@pytest.mark.parametrize("share", [0.5, -0.5])
def test_a_curvature_is_the_paths_whichever_way_the_car_goes(name: str, share: float) -> None:
    drive = reversing(name)
    curvature = share * drive.world.vehicle.curvature_per_m_max
    drive.curvature_per_m = curvature
    drive.run(4.0)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert drive.car.truth.column_angle_rad * share > 0.0  # the wheel goes where it went forwards
    yaw_rate = drive.car.truth.yaw_rate_radps
    assert yaw_rate == pytest.approx(drive.speed * curvature, rel=0.1)
    assert drive.state.yaw_rate_radps == pytest.approx(yaw_rate, rel=0.15)


@NAMES
def test_between_the_directions_the_car_stands_for_600_ms(name: str) -> None:
    drive = Drive(vehicle=load_vehicle(name)).go(2.0)
    drive.speed_mps = BACK_MPS
    stood_ns = None
    for _ in range(400):
        drive.run(0.02)
        if drive.speed < -0.02:
            break
        if drive.speed > 0.02:
            stood_ns = None
        elif stood_ns is None:
            stood_ns = drive.world.now_ns
    assert drive.speed < -0.02 and drive.is_in(Mode.AUTOMATIC), drive.log()
    assert stood_ns is not None and drive.world.now_ns - stood_ns >= 580_000_000


@NAMES
def test_emergency_brake_backwards(name: str) -> None:
    drive = reversing(name)
    began_m = drive.car.truth.distance_m
    drive.request(Request.EMERGENCY_STOP, 0.02)
    assert drive.brakes_to_standstill(within_s=2.0)
    brake = drive.world.vehicle.brake
    way_m = 0.3 * 1.0 + 0.5 * 1.0**2 / (0.8 * brake.deceleration_mps2_full) + 0.2
    assert drive.car.truth.distance_m - began_m < way_m
    drive.run(1.0)
    drive.request(Request.RESET, 0.5)
    assert drive.is_in(Mode.MANUAL) and not drive.car.parts.hardware.reverse_selected


def test_a_silent_planner_backwards_ends_braked() -> None:
    drive = reversing()
    drive.is_planner_silent = True
    drive.run(0.15)
    assert drive.first_emergency()[0] is ErrorCode.ER5
    assert drive.brakes_to_standstill()


def test_the_driver_takes_over_backwards() -> None:
    drive = reversing()
    drive.car.driver.steering_torque_nm = 6.0
    drive.run(0.15)
    assert drive.is_in(Mode.MANUAL) and not drive.car.parts.hardware.reverse_selected


def test_a_controlled_stop_backwards_ends_in_ready() -> None:
    drive = reversing()
    drive.request(Request.DISENGAGE, 0.1)
    assert drive.is_in(Mode.STOPPING)
    assert drive.run(4.0, until=lambda: drive.mode is Mode.READY)
    assert abs(drive.speed) < 0.05 and not drive.emergencies


@pytest.mark.parametrize(
    ("stuck", "first_mps", "then_mps"), [(False, 0.0, -1.0), (True, -0.5, 1.0)]
)
def test_a_reverse_contact_that_sticks_is_found_before_the_car_is_fast(
    stuck: bool, first_mps: float, then_mps: float
) -> None:
    drive = Drive().start()
    drive.press_button()
    drive.engage()
    drive.speed_mps = first_mps
    drive.run(4.0)
    drive.car.faults.reverse_contact_stuck = stuck
    drive.speed_mps = then_mps
    fastest_mps = 0.0
    for _ in range(300):
        drive.run(0.02)
        fastest_mps = max(fastest_mps, -math.copysign(1.0, then_mps) * drive.speed)
    assert drive.first_emergency() == (ErrorCode.ER1, Reason.VERDICT_BRAKE)
    assert 0.25 < fastest_mps < 1.0 and abs(drive.speed) < 0.02


def test_a_throttle_ecu_that_dies_backwards_opens_the_contact_without_torque() -> None:
    drive = Drive()
    oracle = Oracle(drive.world.vehicle)
    Observer(drive.world, oracle)
    drive.start()
    drive.press_button()
    drive.engage()
    drive.speed_mps = BACK_MPS
    drive.run(5.0)
    assert drive.speed < -0.8
    drive.stop_node("Throttle")
    drive.run(0.08)
    assert not drive.car.parts.hardware.reverse_selected
    assert drive.brakes_to_standstill()
    named = {violation.property for violation in oracle.finish(drive.world.now_ns).violations}
    assert "the drive turns round at standstill" not in named


@NAMES
def test_a_throttle_ecu_that_restarts_backwards_replaces_a_dead_servo(name: str) -> None:
    drive = reversing(name)
    drive.car.faults.servo_dead = True
    drive.world.stations["Throttle"].restart()
    drive.run(1.2)
    assert drive.is_in(Mode.EMERGENCY) and drive.brake < 0.05
    assert drive.speed > -0.4


@NAMES
@pytest.mark.parametrize("slope_rad", [0.14, -0.14], ids=["up", "down"])
def test_backwards_a_car_sets_off_from_a_hill_without_rolling_away(
    name: str, slope_rad: float
) -> None:
    drive = held_on_a_slope(name, slope_rad)
    began_m = farthest_m = drive.car.pose.x_m
    drive.speed_mps = -0.7
    for _ in range(400):
        drive.run(0.02)
        farthest_m = max(farthest_m, drive.car.pose.x_m)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert farthest_m - began_m < 0.002
    # downhill regeneration fades, and the servo leaves half a metre a second to it
    assert drive.speed == pytest.approx(-0.7, abs=0.6)


@NAMES
@pytest.mark.parametrize("slope_rad", [0.14, -0.14], ids=["up", "down"])
@pytest.mark.parametrize("back_mps", [BACK_MPS, -0.3])
def test_engaging_backwards_on_a_hill_never_rolls_the_other_way(
    name: str, slope_rad: float, back_mps: float
) -> None:
    drive = Drive(vehicle=load_vehicle(name)).start()
    drive.speed_mps = back_mps
    drive.press_button()
    drive.run(0.5)
    drive.engage()
    drive.car.faults.slope_rad = slope_rad  # what held the car has let it go
    began_m = farthest_m = drive.car.pose.x_m
    for _ in range(400):
        drive.run(0.02)
        farthest_m = max(farthest_m, drive.car.pose.x_m)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert farthest_m - began_m < 0.02  # until the brake is there
    # downhill regeneration fades, and the servo leaves half a metre a second to it
    assert back_mps - 0.75 < drive.speed < 0.5 * back_mps


@NAMES
@pytest.mark.parametrize("slope_rad", [0.14, -0.14], ids=["up", "down"])
@pytest.mark.parametrize("first_mps", [BACK_MPS, -BACK_MPS])
def test_turning_round_on_a_hill_rolls_no_further_than_a_start(
    name: str, slope_rad: float, first_mps: float
) -> None:
    drive = held_on_a_slope(name, slope_rad)
    drive.speed_mps = first_mps
    drive.run(5.0)
    drive.speed_mps = -first_mps
    way = math.copysign(1.0, -first_mps)
    assert drive.run(4.0, until=lambda: drive.speed == 0.0), drive.log()
    stood_m = least_m = way * drive.car.pose.x_m
    for _ in range(300):
        drive.run(0.02)
        least_m = min(least_m, way * drive.car.pose.x_m)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert stood_m - least_m < 0.002
    assert way * drive.speed > 0.3
