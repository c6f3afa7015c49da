"""Standing on a slope of 8 degrees and setting off from it, through the gateway: all three cars.

Not held by anybody: the time between the driver's foot and AUTOMATIC, and READY after a controlled
stop, where the relay is open. There a hand brake holds the car, or its driver.
"""

from __future__ import annotations

import math

import pytest

from dbc.messages import Mode, Request
from ecus.brake_servo.control import HillHold
from gateway.direction import Rolling, TurningRound
from oracle.judge import Oracle
from simulation.observer import Observer
from tests.scenarios.driving import Drive, held_on_a_slope
from vehicles import known_vehicles, load_vehicle

pytestmark = pytest.mark.whole_car

NAMES = pytest.mark.parametrize("name", known_vehicles())
SLOPE_RAD = math.radians(8.0)
SLOPES = pytest.mark.parametrize("slope_rad", [SLOPE_RAD, -SLOPE_RAD], ids=["up", "down"])
ROLLED_BACK_M_MAX = 0.002
SPEED_MPS = 1.0
ABOVE_MPS_MAX = 0.75
"""Downhill the setpoint is exceeded: regeneration fades at walking pace, and half a metre a
second is left to it before the servo helps (`gateway/brake.py`)."""
FASTER_MPS_MAX = 0.3
"""The torque that beat the brake fades within the drive's dead time and lag."""


def way_m(drive: Drive) -> float:
    """Forwards along x."""
    return drive.car.pose.x_m


@NAMES
@SLOPES
def test_a_held_car_neither_rolls_nor_heats_its_servo(name: str, slope_rad: float) -> None:
    drive = held_on_a_slope(name, slope_rad)
    began_m = way_m(drive)
    drive.run(1.1 * drive.world.vehicle.brake.on_time_s_max)
    assert drive.is_in(Mode.AUTOMATIC) and drive.codes == ()  # no ER3
    assert abs(way_m(drive) - began_m) < 0.001


@NAMES
@SLOPES
def test_a_car_sets_off_without_rolling_back(name: str, slope_rad: float) -> None:
    drive = held_on_a_slope(name, slope_rad)
    began_m = least_m = way_m(drive)
    fastest_mps = 0.0
    drive.speed_mps = SPEED_MPS
    for _ in range(400):
        drive.run(0.02)
        least_m = min(least_m, way_m(drive))
        fastest_mps = max(fastest_mps, drive.speed)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert began_m - least_m <= ROLLED_BACK_M_MAX
    assert drive.speed == pytest.approx(SPEED_MPS, abs=0.2)
    assert fastest_mps < SPEED_MPS + ABOVE_MPS_MAX


@NAMES
def test_without_its_inclinometer_a_car_would_roll_back_unless_drives_hold_it(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the hill start is for; the same slope, taken for the level."""
    monkeypatch.setattr("ecus.brake_servo.control.SLOPE_RAD_MIN", math.inf)
    drive = held_on_a_slope(name, SLOPE_RAD)
    began_m = least_m = way_m(drive)
    drive.speed_mps = SPEED_MPS
    for _ in range(100):
        drive.run(0.02)
        least_m = min(least_m, way_m(drive))
    has_drives = drive.world.vehicle.drives is not None  # with velocity loops of their own
    assert (began_m - least_m > 5.0 * ROLLED_BACK_M_MAX) is not has_drives


@NAMES
def test_a_planner_that_changes_its_mind_is_held_again(name: str) -> None:
    drive = held_on_a_slope(name, SLOPE_RAD)
    began_m = way_m(drive)
    for wait_s in (0.1, 0.3, 0.5, 0.7):
        drive.speed_mps = SPEED_MPS
        drive.run(wait_s)
        drive.speed_mps = 0.0
        drive.run(1.0)
        assert drive.is_in(Mode.AUTOMATIC) and abs(drive.speed) < 0.01, wait_s
        assert way_m(drive) >= began_m - ROLLED_BACK_M_MAX


@NAMES
def test_the_brake_of_each_car_holds_a_slope_of_8_degrees_within_its_continuous_rating(
    name: str,
) -> None:
    brake = load_vehicle(name).brake
    assert brake.hold_ratio * brake.deceleration_mps2_full > 9.80665 * math.sin(SLOPE_RAD)


def test_no_torque_is_kept_when_an_emergency_comes_during_a_hill_start() -> None:
    drive = held_on_a_slope("tabby_evo", SLOPE_RAD)
    began_m = way_m(drive)
    drive.speed_mps = SPEED_MPS
    drive.run(0.6)
    assert drive.car.truth.motor_torque_nm > 20.0  # pushing against the brake
    drive.request(Request.EMERGENCY_STOP, 0.4)
    assert abs(drive.car.truth.motor_torque_nm) < 1.0 and drive.brake > 0.9
    drive.run(2.0)
    assert abs(way_m(drive) - began_m) < 0.05 and drive.speed == 0.0


@NAMES
def test_a_broken_inclinometer_on_the_level_does_not_make_the_car_faster_than_told(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The brake is held against no hill: what makes the car faster is not taken for one."""
    sense = HillHold.sense

    def broken(self: HillHold, now_ns: int, dt_s: float, speed_mps: float, _: float) -> None:
        sense(self, now_ns, dt_s, speed_mps, math.nan)

    monkeypatch.setattr(HillHold, "sense", broken)
    drive = held_on_a_slope(name, 0.0)
    drive.speed_mps = 0.3
    fastest_mps = 0.0
    for _ in range(200):
        drive.run(0.02)
        fastest_mps = max(fastest_mps, drive.speed)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert fastest_mps < 0.3 + FASTER_MPS_MAX
    assert drive.speed == pytest.approx(0.3, abs=0.1)


@NAMES
@pytest.mark.parametrize("wait_s", [0.5, 0.9])
@SLOPES
@pytest.mark.parametrize("does_gateway_wait", [True, False])
def test_a_planner_that_turns_round_during_a_hill_start_waits_for_no_torque(
    name: str,
    slope_rad: float,
    wait_s: float,
    does_gateway_wait: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no_wait(self: TurningRound, now_ns: int, wanted_mps: float, rolling: Rolling) -> float:
        return wanted_mps

    if not does_gateway_wait:
        monkeypatch.setattr(TurningRound, "commanded_mps", no_wait)
    drive = Drive(vehicle=load_vehicle(name))
    oracle = Oracle(drive.world.vehicle)
    Observer(drive.world, oracle)
    drive.start()
    drive.press_button()
    drive.engage()
    drive.run(1.0)
    drive.car.faults.slope_rad = slope_rad
    drive.run(1.0)
    drive.speed_mps = SPEED_MPS
    drive.run(wait_s)
    drive.speed_mps = -0.9
    drive.run(6.0)
    report = oracle.finish(drive.world.now_ns)
    named = {violation.property for violation in report.violations}
    assert "the drive turns round at standstill" not in named, str(report)
    if does_gateway_wait:  # else the car rolls, and the safety monitor may find it
        assert not named, str(report)
        assert drive.is_in(Mode.AUTOMATIC), drive.log()
        assert drive.speed < -0.4
