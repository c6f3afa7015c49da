"""Pose estimate and satellite receiver."""

import math

import numpy as np
import pytest

from planner.gnss import GnssFix, GnssReceiver
from planner.localisation import Localiser
from planner.pose import Pose, move_along_arc

MS = 1_000_000
ORIGIN = Pose(x_m=0.0, y_m=0.0, heading_rad=0.0)


def drive(
    localiser: Localiser,
    receiver: GnssReceiver | None,
    seconds: float,
    start: Pose = ORIGIN,
    curvature_per_m: float = 0.05,
    measured_share: float = 1.0,
) -> tuple[list[float], list[float]]:
    """Drive a bend at 5 m/s; return the position errors and heading errors at every 20 ms."""
    truth, errors, headings = start, [], []
    localiser.odometry(1, 5.0, curvature_per_m * measured_share)
    for tick in range(round(seconds * 50.0)):
        now_ns = tick * 20 * MS
        if tick:
            truth = move_along_arc(truth, 0.1, curvature_per_m)
            localiser.odometry(now_ns, 5.0, curvature_per_m * measured_share)
        if receiver is not None:
            for fix in receiver.step(now_ns, truth.x_m, truth.y_m):
                localiser.fix(fix)
        pose = localiser.pose(now_ns)
        errors.append(math.hypot(pose.x_m - truth.x_m, pose.y_m - truth.y_m))
        headings.append(pose.heading_rad - truth.heading_rad)
    return errors, headings


def test_receiver_samples_at_10_hz_and_delivers_100_ms_late() -> None:
    receiver = GnssReceiver(np.random.default_rng(0), sigma_m=0.0)
    arrivals = []
    for now_ms in range(0, 1000, 5):
        for fix in receiver.step(now_ms * MS, float(now_ms), 0.0):
            arrivals.append((now_ms, fix.taken_ns // MS, fix.x_m))
    assert arrivals == [(t + 100, t, float(t)) for t in range(0, 900, 100)]


def test_receiver_noise_is_2_cm_per_axis_and_repeats_with_its_seed() -> None:
    def fixes(seed: int) -> list[tuple[float, float]]:
        receiver = GnssReceiver(np.random.default_rng(seed))
        result: list[tuple[float, float]] = []
        for index in range(2000):
            arrived = receiver.step(index * 100 * MS, 10.0, -3.0)
            result.extend((fix.x_m, fix.y_m) for fix in arrived)
        return result

    noise = np.array(fixes(7)) - [10.0, -3.0]
    assert noise.std(axis=0) == pytest.approx([0.02, 0.02], rel=0.06)
    assert np.abs(noise.mean(axis=0)).max() < 0.002
    assert fixes(7) == fixes(7)
    assert fixes(7) != fixes(8)


def test_exact_odometry_alone_keeps_the_pose() -> None:
    errors, headings = drive(Localiser(ORIGIN, 0), None, 20.0)
    assert max(errors) < 0.01 and max(map(abs, headings)) < 1e-3


def test_old_fix_corrects_the_time_it_was_taken_and_not_now() -> None:
    localiser = Localiser(ORIGIN, 0)
    receiver = GnssReceiver(np.random.default_rng(0), sigma_m=0.0)
    errors, _ = drive(localiser, receiver, 10.0)
    # A fix 100 ms old, taken as of now, would pull the pose back by up to 0.5 m.
    assert max(errors) < 0.01
    assert localiser.fixes_used == 99 and localiser.fixes_rejected == 0


def test_noisy_fixes_give_a_pose_within_a_few_centimetres() -> None:
    errors, headings = drive(Localiser(ORIGIN, 0), GnssReceiver(np.random.default_rng(4)), 120.0)
    assert np.sqrt(np.mean(np.square(errors))) < 0.02
    assert max(errors) < 0.06
    assert np.sqrt(np.mean(np.square(headings))) < math.radians(0.4)


def test_wrong_start_heading_is_learned_from_the_fixes() -> None:
    wrong = Pose(x_m=0.0, y_m=0.0, heading_rad=math.radians(2.0))
    receiver = GnssReceiver(np.random.default_rng(5))
    _, headings = drive(Localiser(wrong, 0), receiver, 20.0)
    assert headings[0] == pytest.approx(math.radians(2.0))
    assert max(map(abs, headings[500:])) < math.radians(0.8)


def test_curvature_measured_5_percent_wrong_does_not_carry_the_pose_away() -> None:
    receiver = GnssReceiver(np.random.default_rng(6))
    errors, headings = drive(Localiser(ORIGIN, 0), receiver, 60.0, measured_share=1.05)
    assert max(errors) < 0.08 and max(map(abs, headings)) < math.radians(2.0)
    drifting, _ = drive(Localiser(ORIGIN, 0), None, 60.0, measured_share=1.05)
    assert max(drifting) > 1.0


def weave(
    localiser: Localiser, seed: int, slip_s: float = 0.0
) -> tuple[list[float], list[float], list[float]]:
    """Drive 120 s of bends and straights at 6 m/s with biased odometry.

    Measured speed is 1 % high, the curvature 3e-4 1/m and a tenth too far left; the tyres follow
    the steering after `slip_s`. Returns errors along, across, and in course, every 20 ms.
    """
    receiver = GnssReceiver(np.random.default_rng(seed))
    truth, driven = ORIGIN, 0.0
    along, across, course = [], [], []
    for tick in range(6000):
        now_ns = tick * 20 * MS
        steered = 0.06 * math.sin(tick / 150.0) if (tick // 942) % 2 else 0.0
        if tick:
            driven += (steered - driven) * min(1.0, 0.02 / max(slip_s, 0.02))
            truth = move_along_arc(truth, 0.12, driven)
        for fix in receiver.step(now_ns, truth.x_m, truth.y_m):
            localiser.fix(fix)
        localiser.odometry(now_ns, 6.0 * 1.01, 1.05 * steered + 3e-4)
        pose = localiser.pose(now_ns)
        cos, sin = math.cos(truth.heading_rad), math.sin(truth.heading_rad)
        dx, dy = pose.x_m - truth.x_m, pose.y_m - truth.y_m
        along.append(cos * dx + sin * dy)
        across.append(cos * dy - sin * dx)
        course.append(pose.heading_rad - truth.heading_rad)
    return along, across, course


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_biased_odometry_is_learned_and_leaves_no_lag(seed: int) -> None:
    localiser = Localiser(ORIGIN, 0)
    along, across, course = weave(localiser, seed)
    learned = localiser.odometry_correction
    assert learned.speed_scale == pytest.approx(1.0 / 1.01, abs=0.004)
    assert learned.curvature_scale == pytest.approx(1.01 / 1.05, abs=0.02)
    assert learned.curvature_offset_per_m == pytest.approx(-3e-4, abs=2e-4)
    assert abs(np.mean(along[500:])) < 0.005
    assert np.sqrt(np.mean(np.square(along[500:]) + np.square(across[500:]))) < 0.025
    assert np.sqrt(np.mean(np.square(course[500:]))) < math.radians(0.25)
    assert localiser.fixes_rejected == 0


def test_side_slip_that_builds_up_is_learned_as_a_lag() -> None:
    localiser = Localiser(ORIGIN, 0)
    _, _, course = weave(localiser, 4, slip_s=0.1)
    # A first-order lag of 0.1 s in steps of 20 ms, of which the filter sees the mean of two.
    assert localiser.odometry_correction.curvature_lag_s == pytest.approx(0.08, abs=0.03)
    assert np.sqrt(np.mean(np.square(course[3000:]))) < math.radians(0.25)


def test_corrections_fade_on_a_long_straight_without_fixes() -> None:
    localiser = Localiser(ORIGIN, 0)
    weave(localiser, 5)
    learned = localiser.odometry_correction
    for tick in range(6000, 36_000):
        localiser.odometry(tick * 20 * MS, 6.0, 0.0)
    faded = localiser.odometry_correction
    assert abs(faded.speed_scale - 1.0) < 0.1 * abs(learned.speed_scale - 1.0)
    assert abs(faded.curvature_scale - 1.0) < 0.1 * abs(learned.curvature_scale - 1.0)


def test_fixes_out_of_order_are_refused() -> None:
    localiser = Localiser(ORIGIN, 0)
    drive(localiser, None, 5.0)
    here = GnssFix(taken_ns=4_900 * MS, x_m=localiser.pose(0).x_m, y_m=localiser.pose(0).y_m)
    assert localiser.fix(here)
    assert not localiser.fix(GnssFix(taken_ns=4_800 * MS, x_m=here.x_m, y_m=here.y_m))


def test_single_outlier_is_refused_and_a_lasting_jump_believed() -> None:
    localiser = Localiser(ORIGIN, 0)
    drive(localiser, GnssReceiver(np.random.default_rng(1)), 5.0)
    here = localiser.pose(4_980 * MS)

    def far(now_ms: int) -> GnssFix:
        return GnssFix(taken_ns=now_ms * MS, x_m=here.x_m + 3.0, y_m=here.y_m)

    assert not localiser.fix(far(4_980))
    assert localiser.pose(4_980 * MS) == here
    results = [localiser.fix(far(4_980)) for _ in range(4)]
    assert results == [False, False, False, True]
    assert localiser.pose(4_980 * MS).x_m > here.x_m + 0.3


def test_fix_older_than_the_history_is_refused() -> None:
    localiser = Localiser(ORIGIN, 0)
    drive(localiser, None, 5.0)
    assert not localiser.fix(GnssFix(taken_ns=1_000 * MS, x_m=0.0, y_m=0.0))
    assert localiser.fixes_rejected == 1


def test_pose_runs_on_between_measurements_for_half_a_second_at_most() -> None:
    localiser = Localiser(ORIGIN, 0)
    localiser.odometry(10 * MS, 5.0, 0.0)
    x_m = localiser.pose(10 * MS).x_m
    assert localiser.pose(30 * MS).x_m == pytest.approx(x_m + 0.1)
    assert localiser.pose(9_000 * MS).x_m == pytest.approx(x_m + 2.5)


def test_measurement_from_the_past_is_ignored() -> None:
    localiser = Localiser(ORIGIN, 0)
    localiser.odometry(100 * MS, 5.0, 0.0)
    before = localiser.pose(100 * MS)
    localiser.odometry(100 * MS, 9.0, 0.1)
    localiser.odometry(50 * MS, 9.0, 0.1)
    assert localiser.pose(100 * MS) == before


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_are_refused(bad: float) -> None:
    localiser = Localiser(ORIGIN, 0)
    with pytest.raises(ValueError, match="speed_mps"):
        localiser.odometry(MS, bad, 0.0)
    with pytest.raises(ValueError, match="curvature_per_m"):
        localiser.odometry(MS, 0.0, bad)
    with pytest.raises(ValueError, match="fix x_m"):
        localiser.fix(GnssFix(taken_ns=0, x_m=bad, y_m=0.0))
    assert localiser.pose(0) == ORIGIN
