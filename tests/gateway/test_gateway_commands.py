"""What a planner may ask for, and what it is told when it may not."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy
import pytest

from gateway.commands import (
    CommandError,
    Decision,
    checked_period_ns,
    decide,
    decision_age_ns_max,
    planner_period_ns_max,
    promised_period_ms,
)
from vehicles import Vehicle, load_vehicle

TABBY = load_vehicle("tabby_evo")
MS = 1_000_000


def with_timeout(timeout_s: float) -> Vehicle:
    return replace(TABBY, times=replace(TABBY.times, command_timeout_s=timeout_s))


@pytest.mark.parametrize("speed_mps", [0, 0.0, 7.5, 3, Fraction(3, 2), numpy.float32(2.0)])
def test_speeds_within_the_vehicles_range_are_taken(speed_mps: Any) -> None:
    decision = decide(TABBY, speed_mps=speed_mps, curvature_per_m=0.0)
    assert decision == Decision(speed_mps=float(speed_mps), curvature_per_m=0.0)
    assert type(decision.speed_mps) is float


def test_curvature_is_taken_up_to_what_the_steering_reaches_on_both_sides() -> None:
    limit = TABBY.curvature_per_m_max
    for value in (-limit, limit):
        assert decide(TABBY, speed_mps=1.0, curvature_per_m=value).curvature_per_m == value


@pytest.mark.parametrize("value", [-1.501, 7.501, math.nan, math.inf, -math.inf, 10**400])
def test_speed_out_of_range_names_field_value_range_and_unit(value: Any) -> None:
    told = r"^speed_mps = .*: allowed -1\.5 to 7\.5 m/s$"
    with pytest.raises(CommandError, match=told) as raised:
        decide(TABBY, speed_mps=value, curvature_per_m=0.0)
    shown = "inf" if value == 10**400 else repr(float(value))
    assert shown in str(raised.value)


@pytest.mark.parametrize("value", [0.0998, -0.0998, math.nan, math.inf])
def test_curvature_out_of_range_names_field_value_range_and_unit(value: float) -> None:
    with pytest.raises(
        CommandError, match=r"^curvature_per_m = .*: allowed -0\.0997722 to 0\.0997722 1/m$"
    ):
        decide(TABBY, speed_mps=1.0, curvature_per_m=value)


@pytest.mark.parametrize("value", [True, False, "3", None, [1.0], 1j, b"1"])
@pytest.mark.parametrize("field", ["speed_mps", "curvature_per_m"])
def test_wrong_type_is_a_type_error_that_names_the_field(field: str, value: Any) -> None:
    values: dict[str, Any] = {"speed_mps": 1.0, "curvature_per_m": 0.0, field: value}
    with pytest.raises(TypeError, match=f"^{field} = .*a number is wanted, allowed"):
        decide(TABBY, **values)


def test_decision_age_limit_is_85_ms_for_a_planner_of_20_ms() -> None:
    assert decision_age_ns_max(20 * MS) == 85 * MS
    assert decision_age_ns_max(100 * MS) == 205 * MS


def test_longest_period_is_the_one_whose_limit_is_the_command_timeout() -> None:
    # 1.0 s = 1.5 x 630 ms + 55 ms
    assert planner_period_ns_max(TABBY) == 630 * MS
    assert decision_age_ns_max(630 * MS) <= 1_000_000_000 < decision_age_ns_max(631 * MS)
    assert planner_period_ns_max(with_timeout(0.3)) == 163 * MS


@pytest.mark.parametrize("period_s", [0.01, 0.02, 1 / 30, 0.63, 0.07])
def test_periods_within_the_range_are_taken(period_s: float) -> None:
    assert checked_period_ns(TABBY, period_s) == round(period_s * 1e9)


@pytest.mark.parametrize("period_s", [0.0, 0.0099, 0.631, -1.0, math.nan, math.inf])
def test_period_out_of_range_names_the_largest_allowed(period_s: float) -> None:
    with pytest.raises(CommandError, match=r"^planner_period_s = .*: allowed 0\.01 to 0\.63 s$"):
        checked_period_ns(TABBY, period_s)


def test_period_of_the_wrong_type_is_a_type_error() -> None:
    with pytest.raises(TypeError, match="planner_period_s = '20 ms': a number is wanted"):
        checked_period_ns(TABBY, "20 ms")


def test_vehicle_whose_timeout_leaves_no_room_is_refused_by_name() -> None:
    with pytest.raises(CommandError, match=r"command_timeout_s = 0\.06 .*at least 0\.07 s"):
        checked_period_ns(with_timeout(0.06), 0.01)


@pytest.mark.parametrize(
    ("period_ns", "period_ms"), [(20 * MS, 20), (33_333_333, 34), (70_000_000, 70), (10 * MS, 10)]
)
def test_promised_period_is_rounded_up_to_whole_milliseconds(
    period_ns: int, period_ms: int
) -> None:
    assert promised_period_ms(period_ns) == period_ms
