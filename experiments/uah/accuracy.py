"""How errors of sensors and dimensions reach curvature and speed (UAH 4.6, Eq. 15-20).

Eq. 13 and 14 solved for curvature and speed, a the steering wheel's angle, n = 40 the ratio:
k = tan(a/n)/S and v = w cos(a/n) r. Hence

    dk/da = 1/(n S cos2(a/n))    dk/dS = -tan(a/n)/S2
    dv/da = -w r sin(a/n)/n      dv/dw = r cos(a/n)      dv/dr = w cos(a/n)

The paper's Eq. 17 is the same; its Eq. 18 has w below the fraction line, as if v were r/w.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.random import Generator

from experiments.drawing import BASELINE, OURS, picture
from experiments.response import FloatArray
from experiments.result import (
    Goal,
    Outcome,
    Row,
    Setting,
    TableOfWords,
    baseline_within,
)
from vehicles import load_vehicle

RATIO = 40.0
ANGLE_RAD_MAX = 9.25
"""The steering column's range."""
SPEED_MPS = 1.0
SAMPLES = 1_000_000
"""The variance of so many has a standard deviation of 0.14 %."""
MONTE_CARLO_SHARE = 0.01
SIGMA_SHARE = 1e-3
"""Of the quantity's size: small enough for the first derivatives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """Where the errors are looked at."""

    angle_rad: float
    wheelbase_m: float
    wheel_speed_radps: float
    wheel_radius_m: float

    @property
    def curvature_per_m(self) -> float:
        """Eq. 13 solved for it."""
        return math.tan(self.angle_rad / RATIO) / self.wheelbase_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Squares:
    """Squared derivatives: what the squared errors are multiplied with (Eq. 15 and 16)."""

    curvature_angle: float
    curvature_wheelbase: float
    speed_angle: float
    speed_wheel: float
    speed_radius: float


LABELS = {
    "curvature_angle": ("curvature error by steering-wheel angle", "1/m2"),
    "curvature_wheelbase": ("curvature error by wheelbase", "1/m4"),
    "speed_angle": ("speed error by steering-wheel angle", "m2/s2"),
    "speed_wheel": ("speed error by wheel speed", "m2"),
    "speed_radius": ("speed error by wheel radius", "1/s2"),
}
"""Per coefficient what it is, and its unit (angles in radians)."""

PRINTED = Squares(
    curvature_angle=0.364e-3,
    curvature_wheelbase=29.1e-3,
    speed_angle=1.8e-7,
    speed_wheel=5.8e-3,
    speed_radius=74.6e-3,
)
"""Eq. 19 and 20 as printed."""

PAPER_POINT = Point(
    angle_rad=ANGLE_RAD_MAX,
    wheelbase_m=1.31,
    wheel_speed_radps=SPEED_MPS / (math.cos(ANGLE_RAD_MAX / RATIO) * 0.28),
    wheel_radius_m=0.28,
)
"""1 m/s at full lock, with the paper's S = 1.31 m (the track of its Table 1) and r = 0.28 m."""


def printed_formula(point: Point) -> Squares:
    """Eq. 19 and 20: Eq. 17 and 18 with sec2 = cos2 = 1 and tan2 = sin2 = 1/20, as printed."""
    s2, r2, w2 = point.wheelbase_m**2, point.wheel_radius_m**2, point.wheel_speed_radps**2
    return Squares(
        curvature_angle=1.0 / (RATIO**2 * s2),
        curvature_wheelbase=1.0 / (20.0 * s2**2),
        speed_angle=r2 / (20.0 * RATIO**2 * w2),
        speed_wheel=r2 / w2**2,
        speed_radius=1.0 / w2,
    )


def as_evaluated(point: Point) -> Squares:
    """What gives the printed numbers: the two fourth powers taken as squares."""
    s2, r2, w2 = point.wheelbase_m**2, point.wheel_radius_m**2, point.wheel_speed_radps**2
    return replace(
        printed_formula(point), curvature_wheelbase=1.0 / (20.0 * s2), speed_wheel=r2 / w2
    )


def derived(point: Point) -> Squares:
    """The squared derivatives of Eq. 13 and 14."""
    theta_rad = point.angle_rad / RATIO
    sine, cosine, tangent = math.sin(theta_rad), math.cos(theta_rad), math.tan(theta_rad)
    return Squares(
        curvature_angle=(1.0 / (RATIO * point.wheelbase_m * cosine**2)) ** 2,
        curvature_wheelbase=(tangent / point.wheelbase_m**2) ** 2,
        speed_angle=(point.wheel_speed_radps * point.wheel_radius_m * sine / RATIO) ** 2,
        speed_wheel=(point.wheel_radius_m * cosine) ** 2,
        speed_radius=(point.wheel_speed_radps * cosine) ** 2,
    )


def monte_carlo(point: Point, rng: Generator) -> Squares:
    """The same by chance: the spread of Eq. 13 and 14 when one input alone is disturbed."""

    def curvature(angle: FloatArray | float, wheelbase: FloatArray | float) -> FloatArray:
        return np.asarray(np.tan(np.asarray(angle) / RATIO) / wheelbase)

    def speed(
        angle: FloatArray | float, wheel: FloatArray | float, radius: FloatArray | float
    ) -> FloatArray:
        return np.asarray(wheel * np.cos(np.asarray(angle) / RATIO) * radius)

    def square(of: Callable[[FloatArray], FloatArray], mean: float) -> float:
        sigma = SIGMA_SHARE * mean
        return float(of(mean + sigma * rng.standard_normal(SAMPLES)).var()) / sigma**2

    angle, wheel, radius = point.angle_rad, point.wheel_speed_radps, point.wheel_radius_m
    return Squares(
        curvature_angle=square(lambda a: curvature(a, point.wheelbase_m), angle),
        curvature_wheelbase=square(lambda s: curvature(angle, s), point.wheelbase_m),
        speed_angle=square(lambda a: speed(a, wheel, radius), angle),
        speed_wheel=square(lambda w: speed(angle, w, radius), wheel),
        speed_radius=square(lambda r: speed(angle, wheel, r), radius),
    )


def true_point(angle_rad: float = ANGLE_RAD_MAX) -> Point:
    """1 m/s with the vehicle's own dimensions."""
    geometry = load_vehicle("tabby_evo").geometry
    radius_m = geometry.wheel_radius_m
    return Point(
        angle_rad=angle_rad,
        wheelbase_m=geometry.wheelbase_m,
        wheel_speed_radps=SPEED_MPS / (math.cos(angle_rad / RATIO) * radius_m),
        wheel_radius_m=radius_m,
    )


def run(setting: Setting, file: Path) -> Outcome:
    """Each coefficient of Eq. 19 and 20: printed, as the paper evaluated it, and derived."""
    point = true_point()
    columns = {
        "printed": PRINTED,
        "own formula": printed_formula(PAPER_POINT),
        "as evaluated": as_evaluated(PAPER_POINT),
        "derived, S = 1.31 m": derived(PAPER_POINT),
        "derived, S = 2.36 m": derived(point),
        "Monte Carlo": monte_carlo(point, setting.rng),
    }
    _draw(file, setting.rng)
    rows = tuple(_row(name, columns) for name in LABELS)
    table = TableOfWords(
        title="Coefficients of the squared errors at 1 m/s and full lock",
        headers=("", *columns),
        rows=tuple(
            (label, *(f"{getattr(squares, name):.4g}" for squares in columns.values()))
            for name, (label, _) in LABELS.items()
        ),
    )
    return Outcome(rows=rows, notes=_NOTES, tables=(table,))


_NOTES = (
    "Eq. 19 prints 29.1e-3 for the wheelbase where its own 1/(20 S^4) gives 17.0e-3: the printed "
    "number is 1/(20 S^2). Eq. 20 prints 5.8e-3 for the wheel's speed where its own r^2/w^4 gives "
    "0.43e-3: the printed number is r^2/w^2. The baseline column repeats both slips, since it is "
    "to give the printed figures.",
    "Eq. 18 divides by powers of the wheel's speed, which Eq. 14 (v = w cos(theta) r) does not "
    "give: the errors by angle and by radius grow with the speed, and that by the wheel's speed "
    "does not depend on it. So the paper's conclusion that the speed is least accurate at low "
    "speed does not follow.",
    "S = 1.31 m is the track of the paper's Table 1; the wheelbase there, which Eq. 10 defines S "
    "as, is 2.360 m. The ours column has 2.360 m and the tyre's 0.287 m.",
)


def _row(name: str, columns: dict[str, Squares]) -> Row:
    chance = float(getattr(columns["Monte Carlo"], name))
    agrees = Goal(
        f"ours within {100.0 * MONTE_CARLO_SHARE:g} % of {SAMPLES:,} random draws",
        lambda row: abs(row.ours_value - chance) <= MONTE_CARLO_SHARE * chance,
    )
    return Row(
        id=f"uah.accuracy.{name}",
        paper="uah",
        quantity=f"{LABELS[name][0]}, squared",
        unit=LABELS[name][1],
        paper_value=getattr(PRINTED, name),
        baseline_value=getattr(columns["as evaluated"], name),
        ours_value=getattr(columns["derived, S = 2.36 m"], name),
        goals=(baseline_within(0.10), agrees),
    )


def _draw(file: Path, rng: Generator) -> None:
    """Both errors over the steering angle, for the steady-state errors of UAH 5.1."""
    angle_error_rad, wheel_error_radps = math.radians(4.0), math.radians(20.0)
    angles = np.linspace(0.0, ANGLE_RAD_MAX, 40)
    curvature, speed, drawn = [], [], []
    for angle in angles:
        squares = derived(true_point(float(angle)))
        curvature.append(math.sqrt(squares.curvature_angle) * angle_error_rad)
        speed.append(math.hypot(math.sqrt(squares.speed_angle) * angle_error_rad,
                                math.sqrt(squares.speed_wheel) * wheel_error_radps))
    for angle in angles[::6]:
        point = true_point(float(angle))
        noise = rng.standard_normal((2, SAMPLES // 10))
        disturbed = angle + angle_error_rad * noise[0]
        wheel = point.wheel_speed_radps + wheel_error_radps * noise[1]
        drawn.append(
            (
                float((np.tan(disturbed / RATIO) / point.wheelbase_m).std()),
                float((wheel * np.cos(disturbed / RATIO) * point.wheel_radius_m).std()),
            )
        )
    paper = (
        math.sqrt(PRINTED.curvature_angle) * angle_error_rad,
        math.sqrt(PRINTED.speed_angle * angle_error_rad**2
                  + PRINTED.speed_wheel * wheel_error_radps**2),
    )  # fmt: skip
    with picture(file, 3.8, columns=2) as axes:
        labels = ("curvature error, 1/m", "speed error at 1 m/s, m/s")
        for index, (axis, ours, label) in enumerate(
            zip(axes, (curvature, speed), labels, strict=True)
        ):
            axis.plot(angles, ours, color=OURS, label="derived")
            axis.plot(angles[::6], [pair[index] for pair in drawn], "o", color=OURS,
                      label="Monte Carlo")  # fmt: skip
            axis.axhline(paper[index], color=BASELINE, label="printed, at full lock")
            axis.set_xlabel("steering wheel, rad (errors of 4 deg and 20 deg/s)")
            axis.set_ylabel(label)
            axis.set_ylim(0.0, None)
            axis.legend()
