"""The brake setpoint that follows from a speed."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gateway.brake import brake_position_ratio
from gateway.commands import Decision
from vehicles import load_vehicle

TABBY = load_vehicle("tabby_evo")
RADIUS_M = TABBY.geometry.wheel_radius_m


def ratio(speed_mps: float, measured_mps: float, applied_mps: float) -> float:
    decision = Decision(speed_mps=speed_mps, curvature_per_m=0.0)
    return brake_position_ratio(TABBY, decision, measured_mps / RADIUS_M, applied_mps / RADIUS_M)


@pytest.mark.parametrize("measured_mps", [0.0, 0.49, -0.49])
def test_car_told_to_stand_is_held(measured_mps: float) -> None:
    assert ratio(0.0, measured_mps, 0.0) == TABBY.brake.hold_ratio


def test_car_told_to_stand_while_rolling_brakes_only_what_regeneration_cannot() -> None:
    assert ratio(0.0, 0.5, 0.0) == 0.0
    assert ratio(0.0, 5.0, 4.6) == 0.0


def test_car_told_to_move_is_not_held() -> None:
    assert ratio(0.1, 0.0, 0.0) == 0.0


def test_excess_beyond_the_margin_brakes_in_proportion() -> None:
    # 6.0 - 4.5 - 0.5 = 1.0 m/s; 2.0 /s x 1.0 m/s = 2.0 m/s2 of 7.0 m/s2
    assert ratio(4.0, 6.0, 4.5) == pytest.approx(2.0 / 7.0)
    assert ratio(4.0, 5.0, 4.5) == pytest.approx(0.0, abs=1e-9)


def test_planners_braking_ends_at_six_tenths() -> None:
    assert ratio(0.0, 7.5, 0.0) == 0.6


@pytest.mark.parametrize(("measured_mps", "applied_mps"), [(math.nan, 0.0), (5.0, math.nan)])
def test_missing_measurement_or_echo_asks_for_no_brake(
    measured_mps: float, applied_mps: float
) -> None:
    assert ratio(0.0, measured_mps, applied_mps) == 0.0


def test_stronger_brakes_get_a_smaller_setpoint() -> None:
    strong = replace(TABBY, brake=replace(TABBY.brake, deceleration_mps2_full=10.0))
    decision = Decision(speed_mps=4.0, curvature_per_m=0.0)
    assert brake_position_ratio(strong, decision, 6.0 / RADIUS_M, 4.5 / RADIUS_M) == pytest.approx(
        0.2
    )
