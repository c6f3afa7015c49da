"""How much a count proves: exact confidence bounds, none from a normal approximation of a count.

Everything is two-sided at 95 % unless it says otherwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.stats import beta, chi2, t

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A figure between its confidence bounds.

    Attributes:
        value: NaN when there was nothing to tell from; infinite for the mean time between
            failures that never came.
        low, high: As wide as what is known allows, up to 0 and infinity.
    """

    value: float
    low: float
    high: float


@dataclass(slots=True)
class Moments:
    """Count, mean and spread of numbers that need not be kept (Welford 1962)."""

    count: int = 0
    mean: float = math.nan
    squares: float = 0.0
    """Sum of squared distances from the mean."""

    def add(self, value: float) -> None:
        """Takes one more number in."""
        self.count += 1
        if self.count == 1:
            self.mean = value
            return
        step = value - self.mean
        self.mean += step / self.count
        self.squares += step * (value - self.mean)


def poisson_rate(events: int, exposure: float, *, confidence: float = CONFIDENCE) -> Estimate:
    """Events per unit of exposure (Garwood 1936), for events that come independently.

    Args:
        events: How many came.
        exposure: In how many hours, or kilometres.
    """
    assert events >= 0 and 0.0 <= exposure < math.inf, f"{events} in {exposure}"
    if exposure == 0.0:
        return Estimate(value=math.nan, low=0.0, high=math.inf)
    tail = (1.0 - confidence) / 2.0
    low = float(chi2.ppf(tail, 2 * events)) / 2.0 if events else 0.0
    high = float(chi2.ppf(1.0 - tail, 2 * events + 2)) / 2.0
    return Estimate(value=events / exposure, low=low / exposure, high=high / exposure)


def proportion(events: int, trials: int) -> Estimate:
    """The probability behind so many events in so many trials (Clopper and Pearson 1934)."""
    assert 0 <= events <= trials, f"{events} of {trials}"
    if trials == 0:
        return Estimate(value=math.nan, low=0.0, high=1.0)
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(beta.ppf(tail, events, trials - events + 1)) if events else 0.0
    high = _clopper_pearson_high(events, trials, tail)
    return Estimate(value=events / trials, low=low, high=high)


def proportion_high(events: int, trials: int) -> float:
    """The one-sided 95 % upper bound of the same: what an absence of events proves.

    Without events it is 1 - 0.05 ** (1 / trials): 2,995 trials bound it at 0.1 %.
    """
    assert 0 <= events <= trials, f"{events} of {trials}"
    return _clopper_pearson_high(events, trials, 1.0 - CONFIDENCE)


def _clopper_pearson_high(events: int, trials: int, tail: float) -> float:
    if events >= trials:  # also for no trials at all
        return 1.0
    return float(beta.ppf(1.0 - tail, events + 1, trials - events))


def mean_time_between_failures(failures: int, hours: float) -> Estimate:
    """Hours per failure, in a test that ends after its time (chi-square, as in MIL-HDBK-781A)."""
    rate = poisson_rate(failures, hours)
    return Estimate(
        value=_reciprocal(rate.value), low=_reciprocal(rate.high), high=_reciprocal(rate.low)
    )


def mean_duration(durations: Moments, *, confidence: float = CONFIDENCE) -> Estimate:
    """The mean of durations, with Student's t.

    Not by bootstrap: t needs no chance and none of the numbers kept, and the means of hundreds of
    repairs, each shorter than its seed, are close to normal. With fewer than ten, or a few very
    long ones, the bounds are too narrow.
    """
    if durations.count < 2:
        return Estimate(value=durations.mean, low=0.0, high=math.inf)
    freedom = durations.count - 1
    error = math.sqrt(durations.squares / freedom / durations.count)
    reach = float(t.ppf(1.0 - (1.0 - confidence) / 2.0, freedom)) * error
    return Estimate(
        value=durations.mean, low=max(durations.mean - reach, 0.0), high=durations.mean + reach
    )


def availability(failures: int, hours: float, repairs_h: Moments) -> Estimate:
    """MTBF / (MTBF + MTTR), written as 1 / (1 + failure rate * MTTR).

    It falls with either, so the bounds are those of both at once; each is taken at 97.5 %, which
    leaves at least 95 % for the two (Bonferroni).
    """
    confidence = 1.0 - (1.0 - CONFIDENCE) / 2.0
    rate = poisson_rate(failures, hours, confidence=confidence)
    repair = mean_duration(repairs_h, confidence=confidence)
    return Estimate(
        value=1.0 / (1.0 + rate.value * repair.value),
        low=1.0 / (1.0 + rate.high * repair.high),
        high=1.0 / (1.0 + rate.low * repair.low),
    )


def _reciprocal(value: float) -> float:
    return 1.0 / value if value else math.inf
