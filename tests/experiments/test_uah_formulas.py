"""UAH's arithmetic: the angle sensor, the propagation of errors, reliability, a step's figures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from experiments.response import step_figures
from experiments.uah.accuracy import (
    PAPER_POINT,
    PRINTED,
    as_evaluated,
    derived,
    printed_formula,
    true_point,
)
from experiments.uah.reliability import mtbf_interval_h, reliability
from experiments.uah.vernier import ADC_STEP_V, GEARS, Vernier, measured_deg, speed_errors_degps


def test_the_angle_comes_back_exactly_over_the_whole_range() -> None:
    truth = np.arange(0.5, 1080.0, 0.5)
    first, second = GEARS.small_angles_deg(truth)
    assert GEARS.range_deg == GEARS.unambiguous_deg == 1080.0
    np.testing.assert_allclose(GEARS.coarse_deg(first, second), truth, atol=1e-9)
    np.testing.assert_allclose(GEARS.fine_deg(first, second), truth, atol=1e-9)


@pytest.mark.parametrize(
    ("first", "second", "eq3_deg", "true_deg"),
    [(24, 25, 1080.0, 1080.0), (24, 26, 561.6, 561.6), (24, 29, 1252.8, 250.56)],
)
def test_eq_3_is_the_range_only_for_gears_that_differ_by_their_divisor(
    first: int, second: int, eq3_deg: float, true_deg: float
) -> None:
    gears = Vernier(main_teeth=100, first_teeth=first, second_teeth=second)
    assert gears.range_deg == pytest.approx(eq3_deg)
    assert gears.unambiguous_deg == pytest.approx(true_deg)


def test_the_adc_alone_leaves_half_a_step_of_the_sine() -> None:
    truth = np.linspace(0.0, 179.9, 5000)
    read = measured_deg(truth, 0.0, np.random.default_rng(0))
    error = np.abs((read - truth + 90.0) % 180.0 - 90.0)
    step_deg = math.degrees(ADC_STEP_V / 0.080) / 2.0
    assert 0.3 * step_deg < error.max() <= step_deg / math.sqrt(2.0) * 1.001


def test_counted_pulses_are_off_by_up_to_a_pulse_and_timed_edges_are_not() -> None:
    counted, timed = speed_errors_degps(700.0)
    pulse_degps = 360.0 / (64 * 5.8) / 0.1
    assert 0.5 * pulse_degps < counted <= pulse_degps
    assert timed < 0.05


def test_the_derivatives_are_those_of_a_small_difference() -> None:
    point, step = true_point(), 1e-6
    theta = point.angle_rad / 40.0
    found = derived(point)

    def speed(angle: float, wheel: float, radius: float) -> float:
        return wheel * math.cos(angle / 40.0) * radius

    here = (point.angle_rad, point.wheel_speed_radps, point.wheel_radius_m)
    by_angle, by_wheel, by_radius = (
        (speed(*(v + step * (n == k) for n, v in enumerate(here))) - speed(*here)) / step
        for k in range(3)
    )
    assert found.speed_angle == pytest.approx(by_angle**2, rel=1e-4)
    assert found.speed_wheel == pytest.approx(by_wheel**2, rel=1e-4)
    assert found.speed_radius == pytest.approx(by_radius**2, rel=1e-4)
    by_wheelbase = (math.tan(theta) / (point.wheelbase_m + step) - point.curvature_per_m) / step
    assert found.curvature_wheelbase == pytest.approx(by_wheelbase**2, rel=1e-4)


def test_the_printed_coefficients_come_of_two_powers_taken_as_squares() -> None:
    formula, slipped = printed_formula(PAPER_POINT), as_evaluated(PAPER_POINT)
    assert formula.curvature_wheelbase == pytest.approx(17.0e-3, rel=0.01)
    assert formula.speed_wheel == pytest.approx(0.43e-3, rel=0.02)
    for name in ("curvature_angle", "curvature_wheelbase", "speed_angle", "speed_wheel",
                 "speed_radius"):  # fmt: skip
        assert getattr(slipped, name) == pytest.approx(getattr(PRINTED, name), rel=0.02), name


def test_reliability_is_the_papers_arithmetic() -> None:
    found = reliability(812.0, 788.0, 29)
    assert (found.mtbf_h, found.mttr_h) == (788.0 / 29.0, 24.0 / 29.0)
    assert found.failures_per_h * found.mtbf_h == pytest.approx(1.0)
    assert found.availability_percent == pytest.approx(100.0 * 788.0 / 812.0)
    assert found.survival(found.mtbf_h) == pytest.approx(math.exp(-1.0))


def test_the_interval_of_the_mtbf_is_that_of_poisson_counts() -> None:
    low_h, high_h = mtbf_interval_h(788.0, 29)
    # Poisson, 29 events: exact 95 % limits 19.42 and 41.65 (Garwood 1936)
    assert 788.0 / low_h == pytest.approx(41.65, abs=0.01)
    assert 788.0 / high_h == pytest.approx(19.42, abs=0.01)


def test_a_second_order_step_has_the_figures_of_the_textbook() -> None:
    zeta, omega, dead_s = 0.6, 4.0, 0.1
    time = np.arange(0.0, 12.0, 0.001)
    damped = omega * math.sqrt(1.0 - zeta**2)
    t = np.maximum(time - dead_s, 0.0)
    wave = np.cos(damped * t) + zeta / math.sqrt(1.0 - zeta**2) * np.sin(damped * t)
    value = 3.0 * (1.0 - np.exp(-zeta * omega * t) * wave)
    found = step_figures(time, value, 3.0, 0.05)
    assert found.overshoot_percent == pytest.approx(
        100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)), abs=0.01
    )
    assert found.dead_time_s == pytest.approx(dead_s + math.sqrt(2.0 * 0.02) / omega, abs=0.005)
    inside = np.abs(value / 3.0 - 1.0) <= 0.05
    assert inside[time >= found.settling_s + 0.001].all()
    assert not inside[(time < found.settling_s - 0.001)][-1]
    assert found.steady_error == pytest.approx(0.0, abs=1e-6)


def test_what_ends_on_the_other_side_is_no_step_response() -> None:
    time = np.arange(0.0, 5.0, 0.01)
    with pytest.raises(ValueError, match="no step response"):
        step_figures(time, -time, 1.0, 0.05)
