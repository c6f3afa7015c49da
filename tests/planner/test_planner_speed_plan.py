"""Speed plan against hand-worked values."""

import math

import numpy as np
import pytest

from planner.line import Line, drivable_line
from planner.road import FloatArray, open_road
from planner.speed_plan import speed_plan


def circle(radius_m: float) -> Line:
    length_m = math.tau * radius_m
    count = round(length_m / 0.5)
    s_m: FloatArray = np.arange(count, dtype=np.float64) * (length_m / count)
    return Line(
        s_m=s_m,
        x_m=radius_m * np.sin(s_m / radius_m),
        y_m=radius_m - radius_m * np.cos(s_m / radius_m),
        heading_rad=s_m / radius_m,
        curvature_per_m=np.full(count, 1.0 / radius_m),
        length_m=length_m,
    )


def test_bend_of_12_5_m_is_driven_at_5_mps() -> None:
    plan = speed_plan(circle(12.5), from_standstill=False, to_standstill=False)
    assert plan == pytest.approx(np.full(len(plan), 5.0))


def test_wide_bend_is_driven_at_25_kmh() -> None:
    plan = speed_plan(circle(200.0), from_standstill=False, to_standstill=False)
    assert plan == pytest.approx(np.full(len(plan), 25.0 / 3.6))


def test_start_rises_and_end_falls_with_the_given_accelerations() -> None:
    line = circle(200.0)
    plan = speed_plan(line, acceleration_mps2=0.8, deceleration_mps2=1.0)
    assert plan[0] == 0.0
    assert plan[10] == pytest.approx(math.sqrt(2.0 * 0.8 * line.s_m[10]))
    remaining_m = line.length_m - line.s_m[-10]
    assert plan[-10] == pytest.approx(math.sqrt(2.0 * 1.0 * remaining_m))


def test_campus_plan_keeps_every_limit() -> None:
    line = drivable_line(open_road("campus"))
    plan = speed_plan(line)
    assert plan.max() <= 25.0 / 3.6 + 1e-9
    assert (plan**2 * np.abs(line.curvature_per_m)).max() <= 2.0 + 1e-9
    along = np.diff(plan**2) / (2.0 * line.step_m)
    assert along.max() <= 0.8 + 1e-9 and along.min() >= -1.0 - 1e-9
    assert plan.max() == pytest.approx(25.0 / 3.6)  # and it does use the limit


def test_periodic_plan_keeps_the_limits_over_the_joint() -> None:
    line = drivable_line(open_road("campus"))
    for start in (0, 230, 700, 1400):
        turned = Line(
            s_m=line.s_m,
            x_m=line.x_m,
            y_m=line.y_m,
            heading_rad=line.heading_rad,
            curvature_per_m=np.roll(line.curvature_per_m, start),
            length_m=line.length_m,
        )
        plan = speed_plan(turned, from_standstill=False, to_standstill=False)
        along = np.diff(plan**2, append=plan[:1] ** 2) / (2.0 * line.step_m)
        assert along.max() <= 0.8 + 1e-9 and along.min() >= -1.0 - 1e-9
        assert plan.min() > 4.0


@pytest.mark.parametrize(
    "name",
    ["speed_mps_max", "lateral_acceleration_mps2", "acceleration_mps2", "deceleration_mps2"],
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_senseless_limit_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        speed_plan(circle(30.0), **{name: value})  # type: ignore[arg-type]
