"""Confidence bounds against published tables and figures worked by hand."""

from __future__ import annotations

import math

import pytest

from campaign.statistics import (
    Estimate,
    Moments,
    availability,
    mean_duration,
    mean_time_between_failures,
    poisson_rate,
    proportion,
    proportion_high,
)


def moments(*values: float) -> Moments:
    found = Moments()
    for value in values:
        found.add(value)
    return found


@pytest.mark.parametrize(
    ("events", "low", "high"),
    [
        (0, 0.0, 3.689), (1, 0.0253, 5.572), (2, 0.242, 7.225), (3, 0.619, 8.767),
        (5, 1.623, 11.668), (10, 4.795, 18.390), (20, 12.217, 30.888), (50, 37.111, 65.919),
    ],
)  # fmt: skip
def test_poisson_bounds_are_those_of_the_printed_table(
    events: int, low: float, high: float
) -> None:
    """Pearson and Hartley, Biometrika Tables for Statisticians, table 40."""
    found = poisson_rate(events, 1.0)
    assert found.low == pytest.approx(low, abs=1e-3)
    assert found.high == pytest.approx(high, abs=1e-3)


def test_a_rate_is_per_unit_of_exposure() -> None:
    whole, quarter = poisson_rate(5, 1.0), poisson_rate(5, 4.0)
    assert quarter.value == 1.25
    assert (quarter.low, quarter.high) == pytest.approx((whole.low / 4, whole.high / 4))


@pytest.mark.parametrize(
    ("events", "trials", "low", "high"),
    [
        (0, 10, 0.0, 0.3085), (1, 20, 0.0013, 0.2487), (5, 10, 0.1871, 0.8129),
        (10, 10, 0.6915, 1.0), (4, 20, 0.0573, 0.4366),
    ],
)  # fmt: skip
def test_proportions_lie_between_the_bounds_of_clopper_and_pearson(
    events: int, trials: int, low: float, high: float
) -> None:
    found = proportion(events, trials)
    assert found.value == events / trials
    assert (found.low, found.high) == pytest.approx((low, high), abs=1e-4)


def test_2995_clean_injections_are_the_fewest_that_bound_misses_at_a_thousandth() -> None:
    assert proportion_high(0, 2995) <= 0.001 < proportion_high(0, 2994)


@pytest.mark.parametrize("trials", [1, 59, 299, 2995, 10**6])
def test_without_misses_the_bound_is_the_closed_form(trials: int) -> None:
    assert proportion_high(0, trials) == pytest.approx(1.0 - 0.05 ** (1.0 / trials), rel=1e-9)


def test_one_miss_needs_4742_injections_for_the_same_bound() -> None:
    """Of a Poisson count with mean 4.744, one or none comes in 5 % of cases."""
    assert proportion_high(1, 4742) <= 0.001 < proportion_high(1, 4741)


def test_without_trials_nothing_is_known_of_a_probability() -> None:
    assert proportion_high(0, 0) == 1.0
    found = proportion(0, 0)
    assert math.isnan(found.value)
    assert (found.low, found.high) == (0.0, 1.0)


def test_29_failures_in_788_hours_are_uahs_mean_time_between_failures() -> None:
    """Chi-square table: 83.298 (60 degrees, 97.5 %), 38.844 (58 degrees, 2.5 %)."""
    found = mean_time_between_failures(29, 788.0)
    assert found.value == pytest.approx(27.17, abs=0.005)
    assert found.low == pytest.approx(2 * 788 / 83.298, rel=1e-4)
    assert found.high == pytest.approx(2 * 788 / 38.844, rel=1e-4)


def test_without_failures_only_the_lower_bound_is_known() -> None:
    found = mean_time_between_failures(0, 100.0)
    assert found.value == found.high == math.inf
    assert found.low == pytest.approx(100.0 / 3.689, rel=1e-3)


def test_the_mean_of_repairs_lies_between_students_bounds() -> None:
    """Mean 3, deviation sqrt(2.5), t = 2.776 with 4 degrees of freedom."""
    found = mean_duration(moments(1.0, 2.0, 3.0, 4.0, 5.0))
    reach = 2.776 * math.sqrt(2.5 / 5)
    assert found.value == 3.0
    assert (found.low, found.high) == pytest.approx((3.0 - reach, 3.0 + reach), abs=1e-3)


def test_a_mean_duration_is_never_below_nothing() -> None:
    found = mean_duration(moments(0.1, 10.0))
    assert found.low == 0.0 < found.value < found.high


def test_moments_do_not_lose_the_spread_beside_a_large_mean() -> None:
    found = moments(*(1e9 + value for value in (4.0, 7.0, 13.0, 16.0)))
    assert found.mean == 1e9 + 10.0
    assert found.squares == pytest.approx(90.0)


def test_one_repair_says_how_long_and_no_more() -> None:
    assert mean_duration(moments(7.0)) == Estimate(value=7.0, low=0.0, high=math.inf)


def test_availability_of_uahs_car_is_what_the_paper_prints() -> None:
    found = availability(29, 788.0, moments(*[0.8275] * 29))
    assert found.value == pytest.approx(0.9704, abs=5e-5)


def test_availability_takes_both_bounds_at_once() -> None:
    """Each at 97.5 %: t = 3.495 with 4 degrees of freedom."""
    found = availability(8, 80.0, moments(1.0, 2.0, 3.0, 4.0, 5.0))
    rate = poisson_rate(8, 80.0, confidence=0.975)
    reach = 3.4954 * math.sqrt(2.5 / 5)
    assert found.value == pytest.approx(10.0 / 13.0)
    assert found.low == pytest.approx(1.0 / (1.0 + rate.high * (3.0 + reach)), rel=1e-4)
    assert found.high == pytest.approx(1.0 / (1.0 + rate.low * (3.0 - reach)), rel=1e-4)
    assert rate.low < poisson_rate(8, 80.0).low and rate.high > poisson_rate(8, 80.0).high


@pytest.mark.parametrize(("failures", "hours"), [(0, 0.0), (0, 10.0), (1, 10.0)])
def test_availability_without_repairs_is_anything(failures: int, hours: float) -> None:
    found = availability(failures, hours, Moments())
    assert math.isnan(found.value)
    assert (found.low, found.high) == (0.0, 1.0)
