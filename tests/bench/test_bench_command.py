"""`python -m bench`: what it prints, and what it refuses."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.__main__ import NAMES, main
from bench.machine import reference_loop_s, this_machine
from bench.profile_split import ROOT, part_of
from bench.table import Table, met


def test_a_measure_is_printed_as_markdown_with_command_and_machine() -> None:
    answer = CliRunner().invoke(main, ["codec", "--quick"])
    assert answer.exit_code == 0, answer.output
    assert "`python -m bench codec --quick` on " in answer.stdout
    assert str(this_machine()) in answer.stdout
    assert "| encode the payload |" in answer.stdout
    assert "measuring" not in answer.stdout  # standard output can go into a document


def test_an_unknown_measure_is_refused_with_the_names_there_are() -> None:
    answer = CliRunner().invoke(main, ["nonsense"])
    assert answer.exit_code == 2
    assert all(name in answer.stderr for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_a_measure_that_knows_its_name(name: str) -> None:
    module = import_module(f"bench.{name}")
    assert name == module.NAME
    assert callable(module.measure)


def test_a_table_is_markdown() -> None:
    table = Table(title="T", command="c", headers=("a", "b"), rows=[("1", "2")], notes=("n",))
    lines = table.markdown().splitlines()
    assert lines[0] == "### T"
    assert lines[2].startswith("`c` on ")
    assert lines[4:7] == ["| a | b |", "|---|---|", "| 1 | 2 |"]
    assert lines[-1] == "n"


def test_a_missed_goal_stands_out() -> None:
    assert met(True) == "met"
    assert "MISSED" in met(False)


def test_the_machine_names_itself() -> None:
    machine = this_machine()
    assert machine.cpu and machine.cores >= 1 and machine.python.startswith("3.")
    assert 0.0 < reference_loop_s() < 60.0


@pytest.mark.parametrize(
    ("path", "part"),
    [
        (ROOT / "simulation/plant/car.py", "plant"),
        (ROOT / "simulation/kernel.py", "kernel and world"),
        (ROOT / "canbus/timing.py", "wire"),
        (Path("/x/site-packages/e2e/p01.py"), "codec and protection"),
        (Path("/usr/lib/python3.11/heapq.py"), None),
    ],
    ids=str,
)
def test_a_file_belongs_to_a_part(path: Path, part: str | None) -> None:
    assert part_of(str(path)) == part
