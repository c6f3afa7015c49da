"""Runs without a fault break nothing, whatever planner and driver do; and looking changes nothing.

The driver's and the planner's acts come at times drawn from a seed.
"""

from __future__ import annotations

from itertools import pairwise
from random import Random

import pytest

from dbc.messages import Mode, Request
from oracle.sample import Sample
from tests.oracle.watched import Watched, is_reset
from tests.scenarios.driving import Drive

pytestmark = pytest.mark.whole_car

SEEDS = range(6)
TOUCHES: tuple[dict[str, float], ...] = (
    {"steering_torque_nm": 6.0}, {"steering_torque_nm": -5.0}, {"throttle_pedal_ratio": 0.4},
    {"brake_pedal_ratio": 0.5},
)
UNTOUCHED = dict.fromkeys(("steering_torque_nm", "throttle_pedal_ratio", "brake_pedal_ratio"), 0.0)


def wait(drive: Watched, random: Random, longest_s: float = 0.8) -> None:
    """Lets an odd span of time pass, the planner deciding meanwhile."""
    drive.run(random.uniform(0.05, longest_s))
    drive.world.run_until(drive.world.now_ns + random.randrange(19_000_000))


def bend(drive: Watched, random: Random) -> None:
    """The planner steers and changes its speed."""
    for _ in range(3):
        drive.speed_mps = random.uniform(2.0, 5.0)
        drive.curvature_per_m = random.uniform(-0.05, 0.05)
        wait(drive, random)


def again(drive: Watched) -> None:
    """From MANUAL to AUTOMATIC."""
    drive.run(1.2)
    drive.push()
    drive.engage(0.2)
    assert drive.is_in(Mode.AUTOMATIC), drive.state.why_not_engaged


@pytest.mark.parametrize("seed", SEEDS)
def test_a_day_without_faults_breaks_nothing(seed: int) -> None:
    drive, random = Watched(seed), Random(seed)
    drive.away(4.0)
    bend(drive, random)
    drive.touch(**random.choice(TOUCHES))  # the driver takes the car
    drive.run(0.3)
    assert drive.is_in(Mode.MANUAL), drive.log()
    wait(drive, random)
    drive.touch(**UNTOUCHED)
    again(drive)
    bend(drive, random)
    drive.request(Request.DISENGAGE)
    assert drive.run(6.0, until=lambda: drive.is_in(Mode.READY)), drive.log()
    drive.run(0.5)
    drive.engage(0.2)
    drive.run(1.5)
    wait(drive, random)
    drive.touch(emergency_stop_pressed=True)  # and an emergency, in which he steers
    wait(drive, random, 0.3)
    drive.touch(steering_torque_nm=6.0)
    drive.run(3.0)
    drive.touch(emergency_stop_pressed=False, **UNTOUCHED)
    drive.run(1.5)
    assert is_reset(drive), drive.log()
    again(drive)
    drive.run(1.0)
    drive.stop()
    drive.run(3.0)
    drive.push()  # the button resets as well
    drive.run(0.5)
    report = drive.report()
    assert str(report) == "no violation"
    assert report.counts == {} and report.strangers == 0
    assert [reaction.kind for reaction in report.reactions] == ["emergency stop", "FAILSAFE"]
    for reaction in report.reactions:
        assert reaction.emergency_ms is not None and reaction.emergency_ms <= 21.0
        assert reaction.brake_ms is not None and reaction.standstill_ms is not None


def test_an_emergency_in_ready_and_a_time_out_break_nothing() -> None:
    drive = Watched(3).to_ready()
    drive.touch(emergency_stop_pressed=True)
    drive.run(1.0)
    drive.touch(emergency_stop_pressed=False)
    drive.run(1.5)
    assert is_reset(drive)
    drive.run(1.0)
    drive.push()
    drive.touch(throttle_pedal_ratio=0.2)
    drive.run(2.0)
    assert str(drive.report()) == "no violation"


def test_looking_at_a_world_changes_nothing_in_it() -> None:
    watched, unwatched = Watched(5), Drive(5)
    for drive in (watched, unwatched):
        drive.go(4.0, 0.03)
        drive.request(Request.DISENGAGE, 1.0)
    assert watched.world.trace.sha256 == unwatched.world.trace.sha256
    assert watched.car.truth == unwatched.car.truth


def test_an_observer_tells_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = Watched(2)
    samples: list[Sample] = []
    monkeypatch.setattr(drive.oracle, "on_truth", samples.append)
    drive.away(3.0)
    drive.is_on_path = True
    drive.touch(throttle_pedal_ratio=0.25, button_pressed=True)
    sample, truth = samples[-1], drive.car.truth
    assert sample.true_ns == drive.world.now_ns
    for name in ("speed_mps", "yaw_rate_radps", "column_angle_rad", "column_rate_radps",
                 "servo_position_ratio", "brake_ratio", "motor_torque_nm", "relay_closed",
                 "longitudinal_acceleration_mps2"):
        assert getattr(sample, name) == getattr(truth, name), name
    assert sample.drive_torque_nm == drive.car.parts.traction.drive_nm
    assert (sample.throttle_pedal_ratio, sample.button_pressed) == (0.25, True)
    assert sample.path_error_m == truth.pose.y_m
    assert sample.steering_motor_powered and sample.relay_closed
    assert max(b.true_ns - a.true_ns for a, b in pairwise(samples)) == 10_000_000
