"""`dbw vehicle check`: every problem of a vehicle file, or what follows from it."""

from __future__ import annotations

from pathlib import Path

import pytest

from dbw.main import main
from vehicles import load_vehicle

Capture = pytest.CaptureFixture[str]
TEXT = load_vehicle("tabby_evo").text


def test_a_good_file_is_told_with_what_follows_from_it(capsys: Capture) -> None:
    assert main(["vehicle", "check", "tabby_evo"]) == 0
    first, *rest = capsys.readouterr().out.splitlines()
    assert first == "tabby_evo: tabby_evo can be used"
    told = dict(line.strip().split("  ", 1) for line in rest)
    told = {name: value.strip() for name, value in told.items()}
    assert told["smallest radius"] == "10.02 m"  # UAH Eq. 13 at 9.25 rad of steering wheel
    assert told["longest emergency stop"] == "3.29 s"
    assert told["top speed backwards"] == "5.4 km/h"
    assert told["steepest slope held at a stop"] == "12.4 deg"  # sin = 0.3 * 7 / 9.81
    assert told["entries"].startswith(f"{TEXT.count('{ value')}, ")


def test_each_problem_has_a_line_with_file_place_and_range(
    tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / "my_car.toml"
    path.write_text(TEXT.replace("value = 40.0", "value = 400.0").replace("mass_kg", "weight_kg"))
    assert main(["vehicle", "check", str(path)]) == 2
    shown = capsys.readouterr()
    lines = TEXT.splitlines()
    mass = 1 + next(n for n, line in enumerate(lines) if line.startswith("mass_kg"))
    ratio = 1 + next(n for n, line in enumerate(lines) if line.startswith("ratio"))
    told = shown.out.splitlines()
    assert f"{path}:{ratio}: steering.ratio = 400.0: allowed 0.5 to 100" in told
    assert any(line.startswith(f"{path}:{mass}: geometry.weight_kg is not known") for line in told)
    assert len(told) == 3 and shown.err == f"dbw: error: {path}: 3 problems\n"


def test_a_file_that_is_not_there_is_named(capsys: Capture) -> None:
    assert main(["vehicle", "check", "beetle"]) == 2
    assert "allowed baja_5b, fsae_electric, tabby_evo, or a path" in capsys.readouterr().err
