"""Every measure runs in a tiny size and answers numbers that can be true; none is timed here."""

from __future__ import annotations

import math

import pytest

from bench import codec, demo, lap, reproduce, speed
from bench.table import Table
from canbus.frame import Frame
from dbc.codec import encode
from dbc.spec import MessageSpec

pytestmark = pytest.mark.whole_car

FOUR_FILES = ("drive.log", "path.png", "report.json", "signals.png")


def assert_well_formed(tables: list[Table]) -> None:
    """Each table has a title, a command, a machine, and rows as wide as its head."""
    assert tables
    for table in tables:
        assert table.rows
        assert all(len(row) == len(table.headers) for row in table.rows)
        text = table.markdown()
        assert f"### {table.title}" in text
        assert f"`{table.command}` on " in text and "Python 3." in text
        assert "nan" not in text and "inf" not in text


def test_the_codecs_agree_and_both_take_some_time() -> None:
    result = codec.measure(quick=True)
    assert result.contents_compared == codec.QUICK_CONTENTS * result.messages
    assert 15 <= result.messages_timed < result.messages
    assert len(result.costs) == len(codec.PAIRS)
    for cost in result.costs:
        assert 0.0 < cost.ours_us < 1000.0 and 0.0 < cost.cantools_us < 1000.0
        assert cost.ratio < 5.0 and cost.worst_ratio > 0.0
    assert_well_formed(result.tables())


def test_a_codec_that_disagrees_is_found_before_it_is_timed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def wrong(spec: MessageSpec, content: object, counter: int) -> Frame:
        data = encode(spec, content, counter).data
        return Frame(spec.can_id, bytes([*data[:-1], data[-1] ^ 1]))

    monkeypatch.setattr("bench.codec.encode", wrong)
    with pytest.raises(AssertionError):
        codec.measure(quick=True)


@pytest.mark.slow
def test_the_stack_runs_at_some_speed_and_its_shares_add_up() -> None:
    result = speed.measure_distance(6.0, world_s=0.3, runs=1, quick=True)
    for run in (*result.drives, *result.parked, *result.watched):
        assert 0.0 < run.factor < 1e4
        assert run.reference_s > 0.0
    parts = dict(result.shares)
    assert math.isclose(sum(parts.values()), 1.0)
    assert {"plant", "wire", "codec and protection", "kernel and world"} <= parts.keys()
    assert parts.get("other", 0.0) < 0.05  # everything has an owner
    assert_well_formed(result.tables())


def test_a_part_of_a_lap_is_driven_near_its_line_and_claims_nothing_about_laps() -> None:
    result = lap.measure_runs([lap.Run(track="campus", seed=0, distance_m=12.0)], quick=True)
    (report,) = result.reports
    assert 0.0 < report.rmse_m <= report.max_error_m < 0.3
    assert not report.lap_completed and report.emergency_brakes == 0
    assert [table.title for table in result.tables()] == ["Drives"]
    assert_well_formed(result.tables())


@pytest.mark.slow
def test_the_demo_is_measured_as_a_process_and_names_its_files() -> None:
    result = demo.measure_demo(("--distance-m", "6"), quick=True)
    assert result.cpu_s > 0.0
    assert result.wall_s > 0.0
    assert 30.0 < result.memory_mb < 2000.0
    assert result.files == FOUR_FILES
    assert_well_formed(result.tables())


def test_a_demo_that_fails_is_no_measure() -> None:
    with pytest.raises(RuntimeError, match="exit code 2"):
        demo.measure_demo(("--distance-m", "-1"), quick=True)


@pytest.mark.slow
def test_a_papers_experiments_are_timed_with_all_their_figures() -> None:
    result = reproduce.measure(quick=True)
    assert result.cpu_s > 0.0 and 0.0 < result.wall_s < 3600.0
    assert result.figures_count > 10
    assert_well_formed(result.tables())
