"""What a campaign tells: figures from results built by hand, stable keys, one safe page."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from campaign.page import bounds, milliseconds, number, percent
from campaign.plots import bars_path
from campaign.report import replay_command, report_of, write_report
from campaign.result import Demand, SeedResult, ViolationResult
from campaign.settings import CampaignSettings
from campaign.statistics import Estimate, proportion_high
from campaign.summary import LISTED_MAX, SHARE_STEPS, Latencies, is_handled, summarise
from simulation.fault_kinds import FaultKind
from tests.campaign.results import BROKEN, CRASH, GOOD, LOST, SHA256, crash

SETTINGS = CampaignSettings()
DOC = Path(__file__).parents[2] / "docs" / "campaign.md"
PROMISED = [
    "hours", "seeds", "injections", "detected", "handled", "missed", "property_violations",
    "false_trips", "real_time_factor", "trace_sha256", "faults",
]  # fmt: skip
PROMISED_OF_A_FAULT = [
    "kind", "injections", "missed", "latency_ms_p50", "latency_ms_p999", "latency_ms_max",
    "budget_ms",
]  # fmt: skip
HOSTILE = "<script>alert('1')</script> & \"2\" 'onload=3"


def written(
    out: Path, results: Iterable[SeedResult], settings: CampaignSettings = SETTINGS
) -> tuple[dict[str, Any], str]:
    """`report.json` and `report.html`."""
    page = write_report(lambda: iter(results), settings, out, wall_s=10.0)
    assert page == out / "report.html"
    text = (out / "report.json").read_text(encoding="utf-8")
    return json.loads(text, parse_constant=pytest.fail), page.read_text(encoding="utf-8")


def three_seeds() -> Iterator[SeedResult]:
    """One good, one with a miss and a violation, one with a false trip."""
    yield replace(GOOD, injections=(CRASH, LOST), corruptions=200, excused=1)
    yield replace(
        GOOD, seed=1, trace_sha256=SHA256[1], injections=(crash(None, missed=True), crash(99.96)),
        violations=(BROKEN,), corruptions=312, corruptions_unseen=3, stops=2, repairs_s=(8.0,),
    )  # fmt: skip
    yield replace(
        GOOD, seed=7, trace_sha256=SHA256[2], injections=(), false_trips=1, repairs_s=(10.0,)
    )


def text_of(page: str) -> str:
    """What a reader sees, blanks made one."""

    class Reader(HTMLParser):
        def __init__(self) -> None:
            super().__init__()
            self.seen: list[str] = []

        def handle_data(self, data: str) -> None:
            self.seen.append(data)

    reader = Reader()
    reader.feed(page)
    return re.sub(r"\s+", " ", " ".join(reader.seen).replace("\u2011", "-"))


def test_the_figures_are_those_of_the_results(tmp_path: Path) -> None:
    report, _ = written(tmp_path, three_seeds())
    expected = {
        "seeds": 3, "seed_first": 0, "seed_last": 7, "hours": 0.1, "engaged_hours": 0.075,
        "injections": 4, "clean_injections": 4, "detected": 3, "handled": 3, "missed": 1,
        "clean_trials": 4, "clean_missed": 1, "property_violations": 1, "excused": 1, "stops": 4,
        "repairs": 3, "false_trips": 1, "corruptions": 512, "corruptions_unseen": 3,
        "corruptions_unseen_expected": 2.0, "real_time_factor": 36.0, "cpu_s": 12.0,
    }  # fmt: skip
    assert report["failing_seeds"] == [1, 7]
    assert {key: report[key] for key in expected} == pytest.approx(expected)
    assert report["false_trips_per_h"]["value"] == pytest.approx(1.0 / 0.03)
    assert report["mtbf_h"]["value"] == pytest.approx(0.075 / 4)
    assert report["mttr_h"]["value"] == pytest.approx(8.0 / 3600.0)
    assert report["availability"]["value"] == pytest.approx(67.5 / 75.5)
    assert report["miss_probability_bound"] == pytest.approx(proportion_high(1, 4))


def test_the_hash_is_of_the_seeds_hashes_in_order(tmp_path: Path) -> None:
    report, _ = written(tmp_path, three_seeds())
    assert report["trace_sha256"] == hashlib.sha256("".join(SHA256).encode()).hexdigest()


@pytest.mark.parametrize("second", [2, 3])
def test_results_out_of_order_or_twice_are_refused_and_nothing_is_written(
    tmp_path: Path, second: int
) -> None:
    results = [replace(GOOD, seed=3), replace(GOOD, seed=second)]
    with pytest.raises(ValueError, match=f"seed {second} after 3"):
        written(tmp_path / "out", results)
    assert not (tmp_path / "out").exists()


def test_a_kind_has_its_latencies_beside_its_interval(tmp_path: Path) -> None:
    report, _ = written(tmp_path, three_seeds())
    drop, crashed = report["faults"]
    assert (drop["kind"], drop["injections"], drop["budget_ms"]) == ("drop", 1, None)
    assert (drop["latency_ms_p50"], drop["handled"], drop["detected"]) == (None, 1, 0)
    assert (crashed["injections"], crashed["due"], crashed["missed"]) == (3, 3, 1)
    assert (crashed["latency_ms_p50"], crashed["latency_ms_max"]) == (99.96, 99.96)
    assert crashed["latency_ms_p999"] is None  # one of three never came
    assert (crashed["answers_never"], crashed["budget_ms"]) == (1, 100.0)
    assert "crash" not in report["kinds_not_injected"]
    assert len(report["kinds_not_injected"]) == len(FaultKind) - 2


def test_each_percentile_and_both_intervals_of_a_kind_are_told_apart(tmp_path: Path) -> None:
    """2,000 answers after 0.05, 0.1 ... 100 ms, half of them with another interval."""
    injections = tuple(
        replace(crash(half_tenth / 20.0), budget_ms=120.0 + 180.0 * (half_tenth % 2))
        for half_tenth in range(1, 2001)
    )
    report, page = written(tmp_path, [replace(GOOD, injections=injections)])
    (fault,) = report["faults"]
    keys = ("latency_ms_p50", "latency_ms_p99", "latency_ms_p999", "latency_ms_max")
    assert [fault[key] for key in keys] == [50.0, 99.0, 99.9, 100.0]
    assert (fault["budget_ms_min"], fault["budget_ms"]) == (120.0, 300.0)
    assert fault["budget_share_max"] == pytest.approx(100.0 / 120.0)
    assert "50.0 99.0 99.9 100.0 120 to 300" in text_of(page)


def test_the_promised_keys_are_there_and_every_key_is_documented(tmp_path: Path) -> None:
    report, _ = written(tmp_path, three_seeds())
    table = DOC.read_text(encoding="utf-8").split("<!-- report keys -->")[1]
    documented = re.findall(r"^\| `([^`]+)` \|", table.split("<!-- /report keys")[0], re.MULTILINE)
    found = list(report)
    for name in ("faults", "failures", "violations"):
        assert report[name]
        found += [f"{name}[].{key}" for key in report[name][0]]
    assert found == documented
    assert set(PROMISED) <= report.keys()
    assert set(PROMISED_OF_A_FAULT) <= report["faults"][0].keys()


def test_a_campaign_of_nothing_has_a_report_without_numbers_that_do_not_exist(
    tmp_path: Path,
) -> None:
    report, page = written(tmp_path, [])
    assert (report["seeds"], report["injections"], report["faults"]) == (0, 0, [])
    assert report["seed_first"] is None
    assert report["false_trips_per_h"] == {"value": None, "low": 0.0, "high": None}
    assert report["availability"] == {"value": None, "low": 0.0, "high": 1.0}
    assert report["miss_probability_bound"] == 1.0
    seen = text_of(page)
    assert "this campaign shows nothing about faults" in seen
    assert "No fault was missed" not in seen
    assert not re.search(r"\b(nan|inf|None)\b", seen)


def test_a_campaign_without_failures_says_so_and_lists_none(tmp_path: Path) -> None:
    report, page = written(tmp_path, [GOOD])
    assert report["failing_seeds"] == report["failures"] == report["violations"] == []
    assert "No fault was missed, no property broke" in page
    assert "--replay" not in page


def test_a_failing_seed_is_one_line_that_repeats_it_with_its_reasons(tmp_path: Path) -> None:
    report, page = written(tmp_path, three_seeds())
    assert [failure["replay"] for failure in report["failures"]] == [
        f"dbw campaign --replay 1 --out {tmp_path}", f"dbw campaign --replay 7 --out {tmp_path}",
    ]  # fmt: skip
    assert report["failures"][0]["reasons"] == [
        "broken at 50.000 s: braking stays: 0.2 at 3.1 m/s",
        "missed: crash of Steering at 10.000 s: brake wanted within 100 ms, never came",
    ]
    assert report["failures"][1]["reasons"] == ["stopped once without a cause"]
    seen = text_of(page)
    assert "2 seeds failed: 1 fault missed, 1 property violation, 1 false trip." in seen
    assert "dbw campaign --replay 1 " in seen and "dbw campaign --replay 7 " in seen
    assert "No fault was missed" not in seen


def test_a_seed_with_a_file_of_faults_is_repeated_with_that_file() -> None:
    settings = CampaignSettings(faults_text="x", faults_name="my storm.toml")
    line = "dbw campaign --replay 5 --out o --faults 'my storm.toml'"
    assert replay_command(settings, 5, Path("o")) == line


def test_a_seed_of_another_car_is_repeated_with_that_car() -> None:
    settings = CampaignSettings(vehicle="my car.toml", vehicle_text="x")
    line = "dbw campaign --replay 5 --out o --vehicle 'my car.toml'"
    assert replay_command(settings, 5, Path("o")) == line


def test_of_many_failing_seeds_all_are_told_and_some_in_words(tmp_path: Path) -> None:
    results = [replace(GOOD, seed=seed, violations=(BROKEN,) * 9) for seed in range(300)]
    report, page = written(tmp_path, results)
    assert report["failing_seeds"] == list(range(300))
    assert report["property_violations"] == 2700
    assert len(report["failures"]) == len(report["violations"]) == LISTED_MAX
    assert report["failures"][0]["reasons"][-1] == "and 4 more"
    assert "All 300" in text_of(page)


def test_hostile_text_stays_text(tmp_path: Path) -> None:
    miss = replace(crash(150.0, missed=True), kind=HOSTILE, target=HOSTILE)
    bad = ViolationResult(property=HOSTILE, at_s=1.0, text=HOSTILE)
    settings = CampaignSettings(vehicle=HOSTILE, faults_text="x", faults_name=HOSTILE)
    report, page = written(
        tmp_path, [replace(GOOD, injections=(miss,), violations=(bad,))], settings
    )
    assert report["faults"][0]["kind"] == report["violations"][0]["text"] == HOSTILE
    assert "<script" not in page
    assert text_of(page).count("<script>alert(") >= 6
    assert not re.search(r"<[^>]*onload", page)


def test_the_page_needs_nothing_from_elsewhere(tmp_path: Path) -> None:
    _, page = written(tmp_path, three_seeds())
    linked = re.findall(r"(?:src|href)=\"([^\"]*)\"", page)
    assert linked
    assert all(link.startswith(("data:image/svg+xml;base64,", "#")) for link in linked)
    assert "@import" not in page and "url(" not in page


def test_the_page_puts_the_campaign_beside_the_car_on_the_road(tmp_path: Path) -> None:
    _, page = written(tmp_path, three_seeds())
    seen = text_of(page)
    for figure in ("812.0", "788.0", "27.17", "0.8275", "97.04 %", "18.9 to 40.6"):
        assert figure in seen
    assert "Our hours are simulated and our faults are injected, far more densely" in seen
    assert "(53.3 in each hour of driving)" in seen


def test_the_same_results_make_the_same_files(tmp_path: Path) -> None:
    assert written(tmp_path, three_seeds()) == written(tmp_path, three_seeds())


def test_other_files_of_the_folder_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "seeds.parquet").write_text("mine")
    written(tmp_path, three_seeds())
    written(tmp_path, [GOOD])
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "report.html", "report.json", "seeds.parquet",
    ]  # fmt: skip


def test_a_traceback_is_told_by_its_last_line() -> None:
    text = "Traceback (most recent call last):\n  File x\nValueError: no such thing\n"
    bad = ViolationResult(property="no exception", at_s=0.0, text=text)
    tally = summarise([replace(GOOD, violations=(bad,))])
    assert tally.failures[0].reasons == (
        "broken at 0.000 s: no exception: ValueError: no such thing",
    )


def test_a_fault_that_was_not_due_is_handled_unless_a_property_breaks_after_it() -> None:
    early, late = replace(BROKEN, at_s=9.0), replace(BROKEN, at_s=11.0)
    assert is_handled(LOST, [])
    assert is_handled(LOST, [early])
    assert not is_handled(LOST, [early, late])
    assert not is_handled(replace(LOST, is_missed=True), [])


def test_a_fault_that_was_due_is_handled_when_answered_in_time() -> None:
    assert is_handled(CRASH, [replace(BROKEN, at_s=11.0)])
    assert not is_handled(crash(150.0, missed=True), [])


def test_only_clean_faults_that_can_be_missed_bound_the_misses() -> None:
    injections = (
        CRASH,
        LOST,
        replace(CRASH, is_clean=False),
        replace(CRASH, is_due=False),
        replace(CRASH, demand=Demand.ANY, is_due=False, budget_ms=None),
        replace(CRASH, is_clean=False, is_missed=True),
    )
    tally = summarise([replace(GOOD, injections=injections)])
    report = report_of(tally, SETTINGS, Path(), wall_s=1.0)
    assert (report.clean_trials, report.clean_missed, report.missed) == (2, 0, 1)
    assert report.miss_probability_bound == pytest.approx(1.0 - math.sqrt(0.05))


def test_2995_clean_injections_without_a_miss_bound_it_at_a_thousandth(tmp_path: Path) -> None:
    injections = (CRASH,) * 599
    report, page = written(
        tmp_path, [replace(GOOD, seed=seed, injections=injections) for seed in range(5)]
    )
    assert report["clean_trials"] == 2995
    assert 0.0009995 < report["miss_probability_bound"] <= 0.001
    assert "at most 0.100 %" in text_of(page)


def test_percentiles_are_latencies_that_came() -> None:
    latencies = Latencies()
    for tenth in range(1, 1001):
        latencies.add(tenth / 10.0, 200.0)
    found = [latencies.percentile_ms(percent) for percent in (0.0, 50.0, 99.0, 99.9, 100.0)]
    assert found == [0.1, 50.0, 99.0, 99.9, 100.0]


def test_a_percentile_is_rounded_up_and_never_beyond_the_longest() -> None:
    latencies = Latencies()
    for latency_ms in (10.01, 10.02, 74.26):
        latencies.add(latency_ms, 100.0)
    assert latencies.percentile_ms(50.0) == 10.1
    assert latencies.percentile_ms(99.0) == latencies.max_ms == 74.26


def test_an_answer_that_never_came_is_later_than_all() -> None:
    latencies = Latencies()
    assert math.isnan(latencies.percentile_ms(50.0))
    for _ in range(998):
        latencies.add(20.0, 100.0)
    latencies.add(None, 100.0)
    latencies.add(None, 100.0)
    assert latencies.percentile_ms(99.0) == 20.0
    assert latencies.percentile_ms(99.9) == math.inf


def test_each_answer_is_set_against_its_own_interval() -> None:
    latencies = Latencies()
    latencies.add(60.0, 75.0)  # 80 %
    latencies.add(150.0, 300.0)  # 50 %
    latencies.add(75.0, 75.0)
    latencies.add(75.1, 75.0)
    latencies.add(0.0, 75.0)
    within, late = latencies.distribution()
    counted = {place: count for place, count in enumerate(within) if count}
    assert set(counted.values()) == {1}
    assert [(place + 1) / SHARE_STEPS for place in counted] == [0.02, 0.5, 0.8, 1.0]
    assert late == 1
    assert latencies.share_max == pytest.approx(75.1 / 75.0)


def test_what_is_kept_does_not_grow_with_the_injections() -> None:
    tally = summarise(
        replace(GOOD, seed=seed, injections=tuple(crash(seed % 90 + 0.1) for _ in range(20)))
        for seed in range(500)
    )
    latencies = tally.faults["crash"].latencies
    assert latencies.answered == 10_000
    assert len(latencies._counts) == 90


def test_bars_are_logarithmic_and_one_late_answer_shows() -> None:
    path = bars_path([0, 1, 1_000_000], 20.0, highest=1_000_000)
    heights = [float(height) for height in re.findall(r"v-([\d.]+)h", path)]
    assert len(heights) == 2
    assert 2.0 <= heights[0] < 4.0
    assert heights[1] == 20.0


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (27.172, "27.2"), (812.0, "812"), (1234567.0, "1,234,567"),
        (0.00304, "0.00304"), (0.9997, "1.00"), (3e-5, "3.00e-05"), (math.inf, "∞"),
        (math.nan, "-"),
    ],
)  # fmt: skip
def test_a_number_is_written_for_people(value: float, text: str) -> None:
    assert number(value) == text


def test_what_is_unknown_is_written_so() -> None:
    assert milliseconds(math.inf) == "never"
    assert milliseconds(math.nan) == percent(math.nan) == "-"
    assert percent(0.0009997) == "0.100 %"
    assert bounds(Estimate(value=1.0, low=0.0, high=math.inf)) == "0 to ∞"
