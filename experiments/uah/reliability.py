"""Reliability arithmetic (UAH 5.4, Eq. 21-25), and how sure 29 failures make it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from experiments.drawing import BASELINE, OURS, picture
from experiments.result import Outcome, Row, Setting, baseline_within

TOTAL_H = 812.0
OPERATION_H = 788.0
FAILURES = 29
PRINTED = {"mtbf": 27.17, "rate": 0.0368, "mttr": 0.8275, "availability": 97.04}
"""Eq. 21, 22, 24 and 25 as printed."""
ROUNDING = 0.0005
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Reliability:
    """Of a system that is repaired after each failure."""

    mtbf_h: float
    failures_per_h: float
    mttr_h: float
    availability_percent: float

    def survival(self, hours: float) -> float:
        """Probability of no failure for so long (Eq. 23)."""
        return math.exp(-self.failures_per_h * hours)


def reliability(total_h: float, operation_h: float, failures: int) -> Reliability:
    """Eq. 21, 22, 24 and 25."""
    mtbf_h = operation_h / failures
    mttr_h = (total_h - operation_h) / failures
    return Reliability(
        mtbf_h=mtbf_h,
        failures_per_h=1.0 / mtbf_h,
        mttr_h=mttr_h,
        availability_percent=100.0 * mtbf_h / (mtbf_h + mttr_h),
    )


def mtbf_interval_h(
    operation_h: float, failures: int, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Exact interval of the mean time between failures, for a test that was ended at a time."""
    rest = 1.0 - confidence
    low = 2.0 * operation_h / float(chi2.ppf(1.0 - rest / 2.0, 2 * failures + 2))
    high = 2.0 * operation_h / float(chi2.ppf(rest / 2.0, 2 * failures))
    return low, high


def run(setting: Setting, file: Path) -> Outcome:
    """The four figures again, and the interval that the paper leaves out."""
    found = reliability(TOTAL_H, OPERATION_H, FAILURES)
    low_h, high_h = mtbf_interval_h(OPERATION_H, FAILURES)
    _draw(file, found, low_h, high_h)
    figures = (
        ("mtbf", "mean time between failures", "h", found.mtbf_h),
        ("rate", "failure rate", "1/h", found.failures_per_h),
        ("mttr", "mean time to repair", "h", found.mttr_h),
        ("availability", "availability", "%", found.availability_percent),
    )
    return Outcome(
        rows=tuple(
            Row(
                id=f"uah.reliability.{name}",
                paper="uah",
                quantity=quantity,
                unit=unit,
                paper_value=PRINTED[name],
                baseline_value=value,
                goals=(baseline_within(ROUNDING),),
            )
            for name, quantity, unit, value in figures
        ),
        notes=(
            f"29 failures leave the mean time between {low_h:.1f} and {high_h:.1f} h with "
            f"{100.0 * CONFIDENCE:.0f} % confidence; the paper gives the estimate alone. A drive "
            f"of 8 h passes without a failure in {100.0 * found.survival(8.0):.0f} % of all cases.",
            "There is no column of ours: this stack has no hours on a road. What it has are "
            "simulated hours under faults (dbw campaign), which are something else.",
        ),
    )


def _draw(file: Path, found: Reliability, low_h: float, high_h: float) -> None:
    hours = np.linspace(0.0, 100.0, 201)
    with picture(file, 3.6) as (axes,):
        axes.fill_between(
            hours, 100.0 * np.exp(-hours / low_h), 100.0 * np.exp(-hours / high_h),
            color=OURS, alpha=0.2, linewidth=0.0, label="95 % interval of 29 failures",
        )  # fmt: skip
        axes.plot(
            hours, 100.0 * np.exp(-found.failures_per_h * hours), color=BASELINE,
            label="paper, Eq. 23",
        )  # fmt: skip
        axes.set_xlabel("operation, h")
        axes.set_ylabel("no failure so far, %")
        axes.set_xlim(0.0, 100.0)
        axes.set_ylim(0.0, 100.0)
        axes.legend()
