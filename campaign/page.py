"""The HTML page of a report: one file, nothing loaded from elsewhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from campaign.plots import bars_path, lateness_picture
from campaign.settings import S_PER_H
from campaign.statistics import Estimate, mean_time_between_failures
from campaign.summary import SHARE_STEPS, CampaignTally, Latencies
from simulation.fault_kinds import KINDS, FaultKind
from telemetry.pages import page_template

if TYPE_CHECKING:
    from campaign.report import CampaignReport, FaultReport, RoadBaseline

BAR_HEIGHT = 20.0
NONE = "-"


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """One kind's latencies, as drawn in its row."""

    within: str
    late: str
    """The bar behind the interval's end."""
    text: str


def page_of(report: CampaignReport, tally: CampaignTally, road: RoadBaseline) -> str:
    """The page as text."""
    filters: dict[str, Callable[..., str]] = {
        "count": count,
        "interval": interval,
        "seconds": seconds,
        "number": number,
        "ms": milliseconds,
        "percent": percent,
        "bounds": bounds,
        "percent_bounds": percent_bounds,
    }
    page = page_template("campaign", "report.html.j2", filters)
    return page.render(
        report=report,
        road=road,
        road_mtbf_h=mean_time_between_failures(road.failures, road.operating_hours),
        picture=_picture(fault.latencies for fault in tally.faults.values()),
        drawings={kind: _drawing(fault.latencies) for kind, fault in tally.faults.items()},
        nan=math.nan,
        does={str(kind): KINDS[kind].does.replace("{value}", "…") for kind in FaultKind},
        bar_height=BAR_HEIGHT,
        share_steps=SHARE_STEPS,
    )


def _picture(latencies: Iterable[Latencies]) -> str:
    """All kinds together; empty if no answer was due."""
    within, late, never = [0] * SHARE_STEPS, 0, 0
    for kind in latencies:
        kind_within, kind_late = kind.distribution()
        within = [sum(pair) for pair in zip(within, kind_within, strict=True)]
        late += kind_late
        never += kind.never
    return lateness_picture(within, late, never) if sum(within) + late + never else ""


def _drawing(latencies: Latencies) -> Drawing | None:
    if not latencies.answered:
        return None
    within, late = latencies.distribution()
    highest = max(*within, late)
    return Drawing(
        within=bars_path(within, BAR_HEIGHT, highest=highest),
        late=bars_path([late], BAR_HEIGHT, highest=highest),
        text=f"{latencies.answered:,} answers; the longest took {latencies.max_ms:.1f} ms, "
        f"{percent(latencies.share_max)} of its interval",
    )


def count(value: int) -> str:
    """A whole number with its thousands apart."""
    return f"{value:,}"


def number(value: float, digits: int = 3) -> str:
    """So many significant digits, with a power of ten only for the tiny and the huge."""
    if math.isnan(value):
        return NONE
    if math.isinf(value):
        return "∞"
    if not value:
        return "0"
    text = f"{value:.{digits - 1}e}"
    exponent = int(text.partition("e")[2])
    return f"{value:,.{max(digits - 1 - exponent, 0)}f}" if -4 <= exponent <= 7 else text


def milliseconds(value: float) -> str:
    """A latency to 0.1 ms; infinite: never."""
    if math.isinf(value):
        return "never"
    return NONE if math.isnan(value) else f"{value:,.1f}"


def interval(fault: FaultReport) -> str:
    """From the shortest to the longest."""
    if math.isnan(fault.budget_ms):
        return NONE
    shortest = f"{fault.budget_ms_min:g} to " if fault.budget_ms_min < fault.budget_ms else ""
    return f"{shortest}{fault.budget_ms:g}"


def seconds(hours: float) -> str:
    """Hours that are too few to picture, in seconds; else nothing."""
    return f"({number(hours * S_PER_H)} s)" if 0.0 < hours < 0.1 else ""


def percent(value: float, digits: int = 3) -> str:
    """A share in per cent."""
    return NONE if math.isnan(value) else f"{number(100.0 * value, digits)} %"


def bounds(estimate: Estimate, digits: int = 3) -> str:
    """Low and high, as one range."""
    return f"{number(estimate.low, digits)} to {number(estimate.high, digits)}"


def percent_bounds(estimate: Estimate, digits: int = 4) -> str:
    """The same in per cent."""
    return f"{percent(estimate.low, digits)} to {percent(estimate.high, digits)}"
