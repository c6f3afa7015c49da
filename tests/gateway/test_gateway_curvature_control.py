"""Curvature held by the yaw rate: sign, limits, standstill, and an IMU that lies or is lost."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.commands import Decision
from gateway.curvature_control import CurvatureControl, CurvatureTuning, Feedback, YawReading
from vehicles import load_vehicle

MS = 1_000_000
BAJA = load_vehicle("baja_5b")
CURVATURE_MAX = BAJA.curvature_per_m_max
TUNING = CurvatureTuning(
    proportional_ratio=0.3, integral_per_s=2.0, derivative_s=0.01, filter_s=0.05, lag_s=0.1,
    correction_per_m_max=0.25,
)  # fmt: skip
RATE_MAX = 6.0 / (3.0 * 0.570)
"""Steering-wheel rate over ratio and wheelbase, 1/m each second (baja_5b.toml)."""


class Toy:
    """A car that turns by what it is told less a play, at once; every 10 ms."""

    def __init__(self, tuning: CurvatureTuning = TUNING, *, play_per_m: float = 0.0) -> None:
        self.control = CurvatureControl(BAJA, tuning)
        self.play_per_m = play_per_m
        self.bias_radps = 0.0
        self.speed_mps = 0.4
        self.imu_lag_ns: int | None = 0
        self.now_ns = 0
        self.curvature = 0.0
        self.told: list[float] = []

    def run(self, span_s: float, wanted_per_m: float, wanted_mps: float = 0.4) -> None:
        for _ in range(round(span_s * 100)):
            self.now_ns += 10 * MS
            rate = self.speed_mps * self.curvature + self.bias_radps
            yaw = None
            if self.imu_lag_ns is not None:
                yaw = YawReading(time_ns=self.now_ns - self.imu_lag_ns, yaw_rate_radps=rate)
            wanted = Decision(speed_mps=wanted_mps, curvature_per_m=wanted_per_m)
            decided = self.control.update(self.now_ns, wanted, self.speed_mps, yaw)
            assert decided.speed_mps == wanted_mps
            self.told.append(decided.curvature_per_m)
            moved = max(0.0, abs(self.told[-1]) - self.play_per_m)
            self.curvature = math.copysign(moved, self.told[-1])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_play_is_taken_out_in_turns_to_either_side(side: float) -> None:
    toy = Toy(play_per_m=0.08)
    toy.run(8.0, side * 0.5)
    assert toy.curvature == pytest.approx(side * 0.5, rel=0.002)
    assert toy.told[-1] == pytest.approx(side * 0.58, rel=0.002)
    assert toy.control.feedback is Feedback.MEASURED


def test_a_perfect_car_gets_its_setpoint_without_a_correction() -> None:
    toy = Toy(replace(TUNING, lag_s=0.0, filter_s=0.0, derivative_s=0.0))
    toy.run(2.0, 0.5)
    # one cycle between command and reading is all that differs
    assert max(toy.told) < 0.5 + RATE_MAX * 0.010 + 0.02
    assert toy.told[-1] == pytest.approx(0.5, abs=1e-3)


def test_what_was_learned_in_left_turns_is_there_again_and_not_used_in_right_ones() -> None:
    toy = Toy(play_per_m=0.08)
    toy.run(8.0, 0.5)
    before = len(toy.told)
    toy.run(8.0, -0.5)
    first = toy.told[before + 60]  # rate limit over, little learned
    assert -0.56 < first < -0.45
    before = len(toy.told)
    toy.run(1.0, 0.5)
    assert toy.told[before + 60] == pytest.approx(0.58, abs=0.02)


def test_the_setpoint_moves_no_faster_than_the_steering_and_stays_within_its_range() -> None:
    toy = Toy(play_per_m=0.5)
    toy.run(6.0, CURVATURE_MAX)
    toy.run(6.0, -CURVATURE_MAX)
    steps = [abs(after - before) for before, after in zip(toy.told, toy.told[1:], strict=False)]
    assert max(steps) <= RATE_MAX * 0.010 + 1e-12
    assert max(map(abs, toy.told)) <= CURVATURE_MAX


@pytest.mark.parametrize("play_per_m", [0.6, -0.6])
def test_the_correction_is_bounded_and_comes_back_at_once(play_per_m: float) -> None:
    toy = Toy(play_per_m=play_per_m)
    toy.run(30.0, 0.3)
    assert abs(toy.control.correction_per_m) == TUNING.correction_per_m_max
    assert toy.told[-1] == pytest.approx(0.3 + math.copysign(0.25, play_per_m))
    toy.play_per_m = 0.0
    toy.run(4.0, 0.3)
    assert toy.told[-1] == pytest.approx(0.3, abs=0.01)


def test_at_the_end_of_the_range_nothing_winds_up() -> None:
    toy = Toy(play_per_m=0.1)
    toy.run(30.0, CURVATURE_MAX)
    assert toy.told[-1] == CURVATURE_MAX
    before = len(toy.told)
    toy.play_per_m = 0.0
    toy.run(1.0, 0.4)
    assert min(toy.told[before:]) > 0.35 and toy.told[-1] == pytest.approx(0.4, abs=0.06)


def test_at_standstill_the_correction_is_held_and_nothing_is_learned() -> None:
    toy = Toy(play_per_m=0.08)
    toy.run(8.0, 0.5)
    held = toy.told[-1]
    toy.speed_mps, toy.bias_radps = 0.05, 0.3
    toy.run(20.0, 0.5)
    assert toy.control.feedback is Feedback.STANDING
    assert toy.told[-1] == pytest.approx(held, abs=0.03)
    toy.speed_mps, toy.bias_radps = 0.4, 0.0
    toy.run(0.5, 0.5)
    assert toy.curvature == pytest.approx(0.5, rel=0.05)


def test_a_car_that_never_moved_gets_the_plain_setpoint() -> None:
    toy = Toy(play_per_m=0.08)
    toy.speed_mps = 0.0
    toy.run(2.0, 0.5)
    assert toy.told[-1] == 0.5


@pytest.mark.parametrize("lost", ["none", "stale", "future", "nan", "inf", "speed"])
def test_without_yaw_rate_or_speed_the_feed_forward_is_left(lost: str) -> None:
    toy = Toy(play_per_m=0.08)
    toy.run(8.0, 0.5)
    toy.imu_lag_ns = {"none": None, "stale": 101 * MS, "future": -1}.get(lost, 0)
    toy.bias_radps = {"nan": math.nan, "inf": math.inf}.get(lost, 0.0)
    before = len(toy.told)
    if lost == "speed":
        toy.speed_mps = math.nan
    toy.run(1.0, 0.5)
    assert toy.control.feedback is Feedback.LOST
    assert toy.told[-1] == 0.5
    assert toy.told[before] > 0.57, "it fades, without a jerk"
    toy.imu_lag_ns, toy.bias_radps, toy.speed_mps = 0, 0.0, 0.4
    toy.curvature = 0.42
    toy.run(1.0, 0.5)
    assert toy.curvature == pytest.approx(0.5, rel=0.02), "what was learned is not forgotten"


def test_a_reading_of_100_ms_still_counts() -> None:
    toy = Toy()
    toy.imu_lag_ns = 100 * MS
    toy.run(0.1, 0.2)
    assert toy.control.feedback is Feedback.MEASURED


def test_the_bias_is_learned_at_standstill_and_taken_off() -> None:
    toy = Toy()
    toy.speed_mps, toy.bias_radps = 0.0, 0.01
    toy.run(2.0, 0.0, wanted_mps=0.0)
    assert toy.control.bias_radps == pytest.approx(0.01)
    toy.speed_mps = 0.4
    toy.run(8.0, 0.5)
    assert toy.curvature == pytest.approx(0.5, rel=0.002)
    toy.control.start(0.0)
    assert toy.control.bias_radps == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("bias_radps", "wanted_mps", "speed_mps", "span_s"),
    [
        (0.03, 0.0, 0.0, 3.0),  # carried about
        (0.01, 0.4, 0.0, 3.0),  # about to move
        (0.01, 0.0, 0.03, 3.0),  # still rolling
        (0.01, 0.0, 0.0, 0.3),  # just come to a halt
    ],
)
def test_no_bias_is_learned_of_a_car_that_may_be_moving(
    bias_radps: float, wanted_mps: float, speed_mps: float, span_s: float
) -> None:
    toy = Toy()
    toy.bias_radps, toy.speed_mps = bias_radps, speed_mps
    toy.run(span_s, 0.0, wanted_mps=wanted_mps)
    assert toy.control.bias_radps == 0.0


def test_a_reading_is_learned_once_however_often_it_is_shown() -> None:
    control = CurvatureControl(BAJA, TUNING)
    parked = Decision(speed_mps=0.0, curvature_per_m=0.0)
    for index in range(100):
        age_ns = index % 10 * 10 * MS  # ten times the same reading
        reading = YawReading(
            time_ns=index * 10 * MS - age_ns, yaw_rate_radps=0.01 if index < 50 else 0.0
        )
        control.update(index * 10 * MS, parked, 0.0, reading)
    # of ten readings the first three come before the car counts as settled
    assert control.bias_radps == pytest.approx(0.01 * 2 / 7)


def test_a_pause_is_no_time_in_which_anything_is_learned() -> None:
    toy = Toy(play_per_m=0.08)
    toy.run(8.0, 0.5)
    toy.curvature = -0.5
    toy.now_ns += 10_000 * MS
    before = len(toy.told)
    toy.run(0.01, 0.5)
    assert toy.told[before] == toy.told[before - 1]


def test_time_that_goes_back_is_the_callers_error() -> None:
    toy = Toy()
    toy.run(0.1, 0.1)
    toy.now_ns -= 50 * MS
    with pytest.raises(AssertionError, match="time goes on"):
        toy.run(0.01, 0.1)


def test_two_updates_of_one_instant_are_one() -> None:
    toy = Toy(play_per_m=0.08)
    toy.run(2.0, 0.5)
    yaw = YawReading(time_ns=toy.now_ns, yaw_rate_radps=0.0)
    wanted = Decision(speed_mps=0.4, curvature_per_m=0.5)
    assert toy.control.update(toy.now_ns, wanted, 0.4, yaw).curvature_per_m == toy.told[-1]


def test_it_begins_at_the_curvature_it_is_given() -> None:
    control = CurvatureControl(BAJA, TUNING)
    control.start(0.4)
    decided = control.update(0, Decision(speed_mps=0.4, curvature_per_m=-0.4), 0.4, None)
    assert decided.curvature_per_m == 0.4


@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_a_tuning_that_is_no_number_is_refused_by_name(value: float) -> None:
    with pytest.raises(ValueError, match=r"integral_per_s = .*allowed 0 and more, finite"):
        replace(TUNING, integral_per_s=value)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    rates=st.lists(st.floats(), min_size=1, max_size=40),
    speeds=st.lists(st.floats(), min_size=1, max_size=40),
    wanted=st.floats(-CURVATURE_MAX, CURVATURE_MAX),
)
def test_whatever_the_sensors_say_the_setpoint_stays_near_the_wanted_one(
    rates: list[float], speeds: list[float], wanted: float
) -> None:
    control = CurvatureControl(BAJA, TUNING)
    control.start(wanted)
    for index, rate in enumerate(rates * 5):
        now_ns = index * 20 * MS
        yaw = YawReading(time_ns=now_ns, yaw_rate_radps=rate)
        speed = speeds[index % len(speeds)]
        decision = Decision(speed_mps=0.4, curvature_per_m=wanted)
        decided = control.update(now_ns, decision, speed, yaw).curvature_per_m
        assert abs(decided) <= CURVATURE_MAX
        assert abs(decided - wanted) <= TUNING.correction_per_m_max + 1e-9


@pytest.mark.parametrize(("derivative_s", "told_per_m"), [(0.0, 0.3), (0.02, 0.28)])
def test_the_derivative_works_against_a_car_that_turns_in(
    derivative_s: float, told_per_m: float
) -> None:
    tuning = replace(TUNING, proportional_ratio=0.0, integral_per_s=0.0,
                     derivative_s=derivative_s, filter_s=0.0)  # fmt: skip
    control = CurvatureControl(BAJA, tuning)
    control.start(0.3)
    decided = wanted = Decision(speed_mps=0.4, curvature_per_m=0.3)
    for index in range(60):
        measured_per_m = 0.3 + 0.01 * max(0, index - 57)  # 1/m each second, at the end
        yaw = YawReading(time_ns=index * 10 * MS, yaw_rate_radps=0.4 * measured_per_m)
        decided = control.update(index * 10 * MS, wanted, 0.4, yaw)
    assert decided.curvature_per_m == pytest.approx(told_per_m)
