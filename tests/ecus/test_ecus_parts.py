"""The ECUs' small parts: encoder, debouncing, limits, codes, the servo's rest."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbc.messages import ErrorCode
from ecus.brake_servo.control import RestInputs, ServoRest, approach
from ecus.common.codes import CodeLatch, code_bits, code_flags
from ecus.common.driver_input import Debounce
from ecus.common.encoder import READING_AGE_S_MAX, EncoderSpeed
from ecus.common.limits import clamp, readable_ratio, towards
from tests.ecus.ecus_fakes import EncoderFake

RADIUS_M = 0.287
GEAR = 5.8
DT_S = 0.01
MS = 1_000_000
NODES = ("Steering", "Throttle", "BrakeServo", "SafetyMonitor", "Gateway")





# Encoder -------------------------------------------------------------------------------------


def _run(encoder: EncoderSpeed, fake: EncoderFake, radps: float, steps: int, t0: int = 0) -> float:
    speed = 0.0
    for step in range(1, steps + 1):
        count, age_s = fake.advance(radps, DT_S)
        speed = encoder.update(t0 + step * 10 * MS, count, age_s)
    return speed


@pytest.mark.parametrize(("pulses", "gear"), [(64.0, GEAR), (360.0, 1.0)])
@pytest.mark.parametrize("speed_mps", [0.05, 0.1, 0.3, 1.0, 2.5, 5.0, 8.0, -0.05, -1.0, -8.0])
def test_encoder_speed_is_right_within_half_a_per_cent(
    pulses: float, gear: float, speed_mps: float
) -> None:
    encoder, fake = EncoderSpeed(pulses), EncoderFake(pulses)
    shaft_radps = speed_mps / RADIUS_M * gear
    speed = _run(encoder, fake, shaft_radps, 100)
    assert speed == pytest.approx(shaft_radps, rel=0.005)


def test_encoder_starts_at_zero_whatever_the_count() -> None:
    encoder = EncoderSpeed(64.0)
    assert encoder.update(5_000 * MS, 1_234_567, 0.003) == 0.0
    assert encoder.update(5_010 * MS, 1_234_567, 0.013) == 0.0


@pytest.mark.parametrize("speed_mps", [0.3, 8.0])
def test_encoder_tells_standstill_a_quarter_second_after_the_last_edge(speed_mps: float) -> None:
    encoder, fake = EncoderSpeed(64.0), EncoderFake(64.0)
    _run(encoder, fake, speed_mps / RADIUS_M * GEAR, 100)
    before = math.inf
    for step in range(1, 27):
        count, age_s = fake.advance(0.0, DT_S)
        speed = encoder.update((100 + step) * 10 * MS, count, age_s)
        assert 0.0 <= speed <= before
        if age_s > READING_AGE_S_MAX:
            assert speed <= 2.0 * math.pi / 64.0 / (age_s - READING_AGE_S_MAX) + 1e-9
        before = speed
    assert speed == 0.0


def test_a_reading_that_comes_a_cycle_late_is_no_wheel_that_slows_down() -> None:
    encoder, fake = EncoderSpeed(64.0), EncoderFake(64.0)
    shaft_radps = 3.0 / RADIUS_M * GEAR
    _run(encoder, fake, shaft_radps, 99)
    count, age_s = fake.advance(shaft_radps, DT_S)
    for step in range(1, 51):
        if step % 2:  # no new reading: the old one's edge is a cycle older
            age_s += DT_S
        else:
            count, age_s = fake.advance(shaft_radps, 2 * DT_S)
        speed = encoder.update((100 + step) * 10 * MS, count, age_s)
        assert speed == pytest.approx(shaft_radps, rel=0.01)


def test_encoder_follows_a_reversal() -> None:
    encoder, fake = EncoderSpeed(64.0), EncoderFake(64.0)
    _run(encoder, fake, 20.0, 50)
    for step in range(1, 31):
        count, age_s = fake.advance(-20.0, DT_S)
        speed = encoder.update((50 + step) * 10 * MS, count, age_s)
        assert abs(speed) <= 20.0 * 1.1  # an edge is crossed twice
    assert speed == pytest.approx(-20.0, rel=0.005)


def test_shaft_that_trembles_around_one_edge_stands() -> None:
    encoder = EncoderSpeed(64.0)
    encoder.update(0, 0, 0.0)
    encoder.update(30 * MS, 10, 0.001)
    assert encoder.speed_radps > 10.0
    for step in range(1, 20):  # back and forth over the same edge, always just now
        encoder.update((30 + 20 * step) * MS, 10 + step % 2, 0.001)
    encoder.update(450 * MS, 10, 0.001)
    encoder.update(480 * MS, 10, 0.001)
    assert encoder.speed_radps == 0.0


def test_encoder_follows_a_ramp_within_a_few_hundredths() -> None:
    encoder, fake = EncoderSpeed(64.0), EncoderFake(64.0)
    for step in range(1, 500):
        speed_mps = step * 0.015
        count, age_s = fake.advance(speed_mps / RADIUS_M * GEAR, DT_S)
        measured = encoder.update(step * 10 * MS, count, age_s) * RADIUS_M / GEAR
        if step > 50:
            assert measured == pytest.approx(speed_mps, abs=0.05)


# Small ones ----------------------------------------------------------------------------------


def test_debounce_needs_its_time_without_a_gap() -> None:
    debounce = Debounce(50 * MS)
    assert debounce.since_ns is None
    assert [debounce.update(True, t * MS) for t in (3, 13, 33, 52)] == [False] * 4
    assert debounce.since_ns == 3 * MS
    assert debounce.update(True, 53 * MS)
    assert not debounce.update(False, 54 * MS)
    assert not debounce.update(True, 55 * MS) and not debounce.update(True, 104 * MS)
    assert debounce.update(True, 105 * MS)


def test_debounce_of_nothing_is_immediate() -> None:
    assert Debounce(0).update(True, 7)


@given(st.floats(), st.floats(-5, 5), st.floats(0, 5))
def test_clamp_stays_within_its_limits_for_every_float(
    value: float, low: float, span: float
) -> None:
    assert low <= clamp(value, low, low + span) <= low + span


def test_clamp_of_nan_is_the_lower_limit_and_inside_nothing_changes() -> None:
    assert clamp(math.nan, -1.0, 2.0) == -1.0
    assert clamp(0.3, -1.0, 2.0) == 0.3


@pytest.mark.parametrize("reading", [-0.04, 0.0, 0.5, 1.0, 1.04])
def test_a_reading_within_its_range_or_its_noise_is_taken(reading: float) -> None:
    assert readable_ratio(reading) == reading


@pytest.mark.parametrize("reading", [-9.0, -0.041, 1.041, 1e9, math.inf, -math.inf, math.nan])
def test_a_reading_out_of_bounds_is_none(reading: float) -> None:
    assert math.isnan(readable_ratio(reading))


@given(st.floats(-10, 10), st.floats(-10, 10), st.floats(0, 3))
def test_towards_moves_by_at_most_the_step_and_never_past_the_target(
    value: float, target: float, step: float
) -> None:
    result = towards(value, target, step)
    assert abs(result - value) <= step + 1e-12
    assert min(value, target) - 1e-12 <= result <= max(value, target) + 1e-12


def test_approach_of_nan_releases_and_ratios_are_bounded() -> None:
    assert approach(0.5, math.nan, 1.0, 0.1) == 0.4
    assert approach(0.95, 7.0, 1.0, 0.1) == 1.0
    assert approach(0.05, -3.0, 1.0, 0.1) == 0.0


# Codes ---------------------------------------------------------------------------------------


def test_code_is_new_once_present_in_its_step_and_reported_for_a_second() -> None:
    codes = CodeLatch()
    assert codes.reported(0) == frozenset()
    assert codes.raise_code(ErrorCode.ER2, 100, latch=False)
    assert not codes.raise_code(ErrorCode.ER2, 200, latch=False)
    assert codes.present(200) == {ErrorCode.ER2} and codes.present(201) == frozenset()
    assert codes.reported(200 + 1000 * MS) == {ErrorCode.ER2}
    assert codes.reported(201 + 1000 * MS) == frozenset()
    assert codes.raise_code(ErrorCode.ER2, 202 + 1000 * MS, latch=False)


def test_latched_code_stays_until_reset() -> None:
    codes = CodeLatch()
    codes.raise_code(ErrorCode.ER4, 0, latch=True)
    assert codes.reported(10**12) == {ErrorCode.ER4}
    codes.reset()
    assert codes.reported(0) == frozenset()


def test_code_bits_and_flags() -> None:
    codes = frozenset({ErrorCode.ER0, ErrorCode.ER6})
    assert code_bits(codes) == 0b1000001
    assert code_flags(codes) == (True, False, False, False, False, False, True)


# Servo's rest --------------------------------------------------------------------------------


def _rest(
    rest: ServoRest, seconds: float, speed_mps: float = 0.0, *, t0_s: float = 0.0,
    loaded: bool = True, inhibited: bool = True,
) -> bool:
    exceeded = False
    for step in range(round(seconds * 100)):
        inputs = RestInputs(
            is_loaded=loaded, speed_mps=speed_mps, is_traction_inhibited=inhibited
        )
        exceeded = rest.update(round((t0_s + step * DT_S) * 1e9), 10 * MS, inputs, 10.0)
    return exceeded


def test_servo_rests_after_its_on_time_standing_with_traction_inhibited() -> None:
    rest = ServoRest()
    assert not _rest(rest, 10.0) and not rest.is_resting
    assert _rest(rest, 0.02, t0_s=10.0) and rest.is_resting
    assert _rest(rest, 100.0, t0_s=11.0) and rest.is_resting


@pytest.mark.parametrize(("speed_mps", "inhibited"), [(0.06, True), (-0.06, True), (0.0, False)])
def test_servo_never_rests_moving_or_with_traction(speed_mps: float, inhibited: bool) -> None:
    rest = ServoRest()
    assert _rest(rest, 20.0, speed_mps, inhibited=inhibited) and not rest.is_resting


@pytest.mark.parametrize(
    ("speed_mps", "loaded", "inhibited", "rests"),
    [
        (0.2, True, True, True),
        (0.21, True, True, False),
        (-0.21, True, True, False),
        (0.0, False, True, False),
        (0.0, True, False, False),
    ],
)
def test_rest_ends_rolling_or_with_traction_or_unwanted(
    speed_mps: float, loaded: bool, inhibited: bool, rests: bool
) -> None:
    rest = ServoRest()
    _rest(rest, 11.0)
    assert rest.is_resting
    _rest(rest, 0.01, speed_mps, t0_s=11.0, loaded=loaded, inhibited=inhibited)
    assert rest.is_resting is rests


def test_unloaded_servo_cools_as_fast_as_it_warms() -> None:
    rest = ServoRest()
    _rest(rest, 9.0)
    _rest(rest, 5.0, t0_s=9.0, loaded=False)
    assert not _rest(rest, 6.0, t0_s=14.0)
    assert _rest(rest, 0.02, t0_s=20.0)
    _rest(rest, 50.0, t0_s=21.0, loaded=False)
    assert not _rest(rest, 10.0, t0_s=71.0)
