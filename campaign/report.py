"""What a campaign tells people: `report.json` for programs, `report.html` for engineers."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from campaign.page import page_of
from campaign.result import SeedResult
from campaign.settings import S_PER_H, CampaignSettings
from campaign.statistics import (
    Estimate,
    availability,
    mean_duration,
    mean_time_between_failures,
    poisson_rate,
    proportion,
    proportion_high,
)
from campaign.summary import CampaignTally, FailingSeed, FaultTally, summarise
from simulation.fault_kinds import FaultKind
from telemetry.folder import ResultFolder
from telemetry.report import without_nan
from vehicles import DEFAULT

CRC8_UNSEEN_SHARE = 1.0 / 256.0
"""Of changes at random, how many leave eight check bits as they must be."""
SWARM = "drawn by each seed"


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultReport:
    """One kind of fault; NaN and infinity, written as null, as in `Latencies`."""

    kind: str
    injections: int
    clean: int
    due: int
    detected: int
    handled: int
    missed: int
    clean_trials: int
    clean_missed: int
    miss_probability_bound: float
    answers_never: int
    latency_ms_p50: float
    latency_ms_p99: float
    latency_ms_p999: float
    latency_ms_max: float
    budget_ms: float
    """The longest interval, if targets have different ones; NaN if nothing was due."""
    budget_ms_min: float
    budget_share_max: float
    """Of the longest answer, in its own interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A failing seed, how to repeat it and why."""

    seed: int
    replay: str
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """A property that broke."""

    seed: int
    property: str
    at_s: float
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadBaseline:
    """A car on the road, for comparison (UAH: Arango et al., Sensors 2020, reliability)."""

    hours: float = 812.0
    operating_hours: float = 788.0
    failures: int = 29
    mtbf_h: float = 27.17
    mttr_h: float = 0.8275
    availability: float = 0.9704


UAH = RoadBaseline()


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignReport:
    """A campaign in numbers; the keys are explained in `docs/campaign.md`."""

    vehicle: str
    faults_from: str
    seed_s: float
    settings_sha256: str
    seed_first: int | None
    seed_last: int | None
    hours: float
    engaged_hours: float
    calm_hours: float
    seeds: int
    injections: int
    clean_injections: int
    detected: int
    handled: int
    missed: int
    clean_trials: int
    clean_missed: int
    miss_probability_bound: float
    property_violations: int
    excused: int
    stops: int
    repairs: int
    false_trips: int
    false_trips_per_h: Estimate
    mtbf_h: Estimate
    mttr_h: Estimate
    availability: Estimate
    corruptions: int
    corruptions_unseen: int
    corruptions_unseen_expected: float
    corruptions_unseen_share: Estimate
    real_time_factor: float
    wall_s: float
    cpu_s: float
    trace_sha256: str
    faults: tuple[FaultReport, ...]
    kinds_not_injected: tuple[str, ...]
    failing_seeds: tuple[int, ...]
    failures: tuple[Failure, ...]
    violations: tuple[Violation, ...]

    def to_json(self) -> str:
        """The report as JSON text, two blanks indented, NaN and infinity as null."""
        return json.dumps(without_nan(asdict(self)), indent=2, allow_nan=False) + "\n"


def write_report(
    results: Callable[[], Iterator[SeedResult]],
    settings: CampaignSettings,
    out: Path,
    *,
    wall_s: float,
) -> Path:
    """Writes `report.json` and `report.html`, both or none.

    Args:
        results: Begins the seeds' results anew, in order of seed; read once, none is kept.
        settings: That they were made with.
        out: Folder; other files in it are left alone.
        wall_s: How long the campaign took.

    Returns:
        The HTML file.

    Raises:
        ValueError: The results are not in order of seed.
        FolderError: The folder cannot be written.
    """
    tally = summarise(results())
    report = report_of(tally, settings, out, wall_s=wall_s)
    with ResultFolder(out) as folder:
        (folder.path / "report.json").write_text(report.to_json(), encoding="utf-8")
        page = page_of(report, tally, UAH)
        (folder.path / "report.html").write_text(page, encoding="utf-8")
        folder.commit()
    return out / "report.html"


def report_of(
    tally: CampaignTally, settings: CampaignSettings, out: Path, *, wall_s: float
) -> CampaignReport:
    """A campaign in numbers."""
    faults = tuple(_fault(fault) for fault in sorted(tally.faults.values(), key=_place))
    trials = sum(fault.clean_trials for fault in faults)
    trials_missed = sum(fault.clean_missed for fault in faults)
    engaged_h, calm_h = tally.engaged_s / S_PER_H, tally.calm_s / S_PER_H
    return CampaignReport(
        vehicle=settings.vehicle,
        faults_from=SWARM if settings.faults_text is None else settings.faults_name,
        seed_s=settings.seed_s,
        settings_sha256=settings.sha256,
        seed_first=tally.seed_first,
        seed_last=tally.seed_last,
        hours=tally.simulated_s / S_PER_H,
        engaged_hours=engaged_h,
        calm_hours=calm_h,
        seeds=tally.seeds,
        injections=sum(fault.injections for fault in faults),
        clean_injections=sum(fault.clean for fault in faults),
        detected=sum(fault.detected for fault in faults),
        handled=sum(fault.handled for fault in faults),
        missed=sum(fault.missed for fault in faults),
        clean_trials=trials,
        clean_missed=trials_missed,
        miss_probability_bound=proportion_high(trials_missed, trials),
        property_violations=tally.property_violations,
        excused=tally.excused,
        stops=tally.stops,
        repairs=tally.repairs_h.count,
        false_trips=tally.false_trips,
        false_trips_per_h=poisson_rate(tally.false_trips, calm_h),
        mtbf_h=mean_time_between_failures(tally.stops, engaged_h),
        mttr_h=mean_duration(tally.repairs_h),
        availability=availability(tally.stops, engaged_h, tally.repairs_h),
        corruptions=tally.corruptions,
        corruptions_unseen=tally.corruptions_unseen,
        corruptions_unseen_expected=tally.corruptions * CRC8_UNSEEN_SHARE,
        corruptions_unseen_share=proportion(tally.corruptions_unseen, tally.corruptions),
        real_time_factor=tally.simulated_s / wall_s if wall_s > 0.0 else math.nan,
        wall_s=wall_s,
        cpu_s=tally.cpu_s,
        trace_sha256=tally.trace_sha256,
        faults=faults,
        kinds_not_injected=tuple(kind for kind in FaultKind if kind not in tally.faults),
        failing_seeds=tuple(tally.failing_seeds),
        failures=tuple(_failure(failing, settings, out) for failing in tally.failures),
        violations=tuple(
            Violation(
                seed=found.seed,
                property=found.violation.property,
                at_s=found.violation.at_s,
                text=found.violation.text,
            )
            for found in tally.violations
        ),
    )


def _place(tally: FaultTally) -> tuple[int, str]:
    """Kinds in the order of their table."""
    kinds = [str(kind) for kind in FaultKind]
    return (kinds.index(tally.kind) if tally.kind in kinds else len(kinds), tally.kind)


def _fault(tally: FaultTally) -> FaultReport:
    latencies = tally.latencies
    return FaultReport(
        kind=tally.kind,
        injections=tally.injections,
        clean=tally.clean,
        due=tally.due,
        detected=tally.detected,
        handled=tally.handled,
        missed=tally.missed,
        clean_trials=tally.trials,
        clean_missed=tally.trials_missed,
        miss_probability_bound=proportion_high(tally.trials_missed, tally.trials),
        answers_never=latencies.never,
        latency_ms_p50=latencies.percentile_ms(50.0),
        latency_ms_p99=latencies.percentile_ms(99.0),
        latency_ms_p999=latencies.percentile_ms(99.9),
        latency_ms_max=latencies.max_ms,
        budget_ms=max(tally.budgets_ms, default=math.nan),
        budget_ms_min=min(tally.budgets_ms, default=math.nan),
        budget_share_max=latencies.share_max,
    )


def _failure(failing: FailingSeed, settings: CampaignSettings, out: Path) -> Failure:
    return Failure(
        seed=failing.seed,
        replay=replay_command(settings, failing.seed, out),
        reasons=failing.reasons,
    )


def replay_command(settings: CampaignSettings, seed: int, out: Path) -> str:
    """The line that repeats a seed."""
    parts = ["dbw", "campaign", "--replay", str(seed), "--out", str(out)]
    if settings.vehicle != DEFAULT:
        parts += ["--vehicle", settings.vehicle]
    if settings.faults_text is not None:
        parts += ["--faults", settings.faults_name]
    return shlex.join(parts)
