"""Rows, goals, names and the report."""

from __future__ import annotations

import json
import math
import pickle
from pathlib import Path

import pytest

from dbw.main import main
from experiments.docs import table_of, written_table
from experiments.page import figure, json_of, page_of
from experiments.result import (
    Experiment,
    Goal,
    Outcome,
    Row,
    Setting,
    baseline_at_most,
    baseline_at_most_paper,
    baseline_within,
    ours_at_most,
    ours_at_most_share,
    ours_near_baseline,
    ours_within,
    settled,
)
from experiments.table import (
    PAPERS,
    Finished,
    UnknownPaper,
    experiments_of,
    run_experiments,
    run_one,
)
from tests.experiments.running import FAST, once

pytestmark = pytest.mark.whole_car

Capture = pytest.CaptureFixture[str]
ALLOWED = ", ".join([*PAPERS, "all"])
KEYS = [
    "id", "paper", "quantity", "unit", "paper_value", "baseline_value", "ours_value", "tolerance",
    "pass",
]


def row(goal: Goal, paper: float, baseline: float, ours: float) -> Row:
    return Row(
        id="a.b", paper="uah", quantity="q", unit="s", paper_value=paper,
        baseline_value=baseline, ours_value=ours, goals=(goal,),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("goal", "met", "missed"),
    [
        (baseline_within(0.1), (1.0, 1.1 - 1e-9, 0.0), (1.0, 0.89, 0.0)),
        (baseline_at_most_paper(), (4.0, -4.0, 0.0), (4.0, 4.1, 0.0)),
        (baseline_at_most(2.0, "s"), (0.0, 2.0, 9.0), (0.0, 2.1, 0.0)),
        (ours_at_most(2.0, "s"), (0.0, 0.0, 2.0), (0.0, 0.0, 2.1)),
        (ours_at_most_share(0.5), (4.0, 0.0, 2.0), (4.0, 9.0, 2.1)),
        (ours_at_most_share(0.5, "baseline"), (0.0, 4.0, 2.0), (9.0, 4.0, 2.1)),
        (ours_within(0.1), (2.0, 0.0, 1.81), (2.0, 0.0, 2.21)),
        (ours_near_baseline(0.1), (0.0, 2.0, 1.81), (0.0, 2.0, 2.21)),
    ],
)  # fmt: skip
def test_a_goal_is_met_up_to_its_limit_and_missed_beyond_and_without_a_number(
    goal: Goal, met: tuple[float, float, float], missed: tuple[float, float, float]
) -> None:
    assert row(goal, *met).passed
    assert not row(goal, *missed).passed
    assert not row(goal, math.nan, math.nan, math.nan).passed


def test_the_json_has_the_stable_keys_and_null_for_no_number() -> None:
    shown = row(ours_at_most(1.0), math.nan, 2.0, 0.5)
    (entry,) = json.loads(json_of([finished_with(shown)]))["experiments"]
    assert list(entry) == KEYS
    assert entry["paper_value"] is None and entry["pass"] is True
    assert entry["tolerance"] == "ours <= 1"


def finished_with(shown: Row) -> Finished:
    def run(setting: Setting, file: Path) -> Outcome:
        raise AssertionError

    experiment = Experiment(id="x", title="X <1>", source="s", run=run)
    return Finished(experiment=experiment, outcome=Outcome(rows=(shown,)), picture=Path(__file__))


def test_a_page_loads_nothing_and_tells_what_is_missed() -> None:
    page = page_of([finished_with(row(ours_at_most(1.0), 1.0, 2.0, 3.0))], seed=0)
    assert "http" not in page and "X &lt;1&gt;" in page
    assert "0 of 1" in page and "missed" in page


@pytest.mark.parametrize(
    ("value", "text"),
    [(math.nan, "-"), (0.6545, "0.6545"), (12345.0, "12,345"), (1.8e-7, "1.8e-07"), (0.0, "0")],
)
def test_a_figure_has_four_digits_and_no_number_a_dash(value: float, text: str) -> None:
    assert figure(value) == text


def test_papers_are_chosen_by_name_and_an_unknown_name_is_refused_with_the_list() -> None:
    every = [experiment for found in PAPERS.values() for experiment in found]
    assert list(experiments_of(())) == list(experiments_of(("all",))) == every
    assert list(experiments_of(("uah", "uah"))) == list(PAPERS["uah"])
    with pytest.raises(UnknownPaper, match=f"no paper 'uha': allowed {ALLOWED}"):
        experiments_of(("uha",))


def test_the_command_refuses_a_name_and_an_unwritable_folder_in_one_line(
    tmp_path: Path, capsys: Capture
) -> None:
    assert main(["reproduce", "uha", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == f"dbw: error: no paper 'uha': allowed {ALLOWED}\n"
    (tmp_path / "file").touch()
    assert main(["reproduce", "uah", "--out", str(tmp_path / "file")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_processes_find_what_one_would_in_the_order_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = [one for one in experiments_of(()) if one.id in FAST[:3]]
    begun: list[str] = []

    def found() -> list[tuple[str, list[dict[str, object]], bool]]:
        finished = run_experiments(chosen, 0, tmp_path, lambda one: begun.append(one.id))
        return [
            (one.experiment.id, [shown.to_plain() for shown in one.outcome.rows],
             one.picture.exists())
            for one in finished
        ]  # fmt: skip

    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    by_two = found()
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0})
    assert repr(by_two) == repr(found())
    assert begun == [one.id for one in chosen] * 2


@pytest.mark.parametrize("ours", [0.5, 1.5])
def test_a_settled_row_crosses_processes_with_its_verdict(ours: float) -> None:
    first = row(ours_at_most(1.0), 1.0, 2.0, ours)
    again = pickle.loads(pickle.dumps(settled(first)))
    assert again.to_plain() == first.to_plain()
    assert again.passed is (ours < 1.0)


def test_every_experiment_has_rows_of_its_own_name() -> None:
    experiments = experiments_of(())
    assert len({experiment.id for experiment in experiments}) == len(experiments)
    for experiment in experiments:
        assert experiment.id.split("-")[0] in PAPERS


@pytest.mark.parametrize("name", FAST)
def test_a_quick_experiment_meets_every_goal_and_is_in_the_docs(name: str) -> None:
    finished = once(name)
    assert [row.id for row in finished.outcome.rows if not row.passed] == []
    assert table_of(finished.outcome.rows) == written_table(finished.experiment)


def test_a_seed_gives_the_same_outcome_twice(tmp_path: Path) -> None:
    finished = once(FAST[0])
    again = run_one(finished.experiment, 0, tmp_path)
    assert again.outcome.tables == finished.outcome.tables
    assert again.picture.read_bytes().startswith(b"\x89PNG")
    other = run_one(finished.experiment, 1, tmp_path)
    assert other.outcome.tables != finished.outcome.tables
