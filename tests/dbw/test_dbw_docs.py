"""`dbw docs`: pages for our own DBCs and for others."""

from __future__ import annotations

from pathlib import Path

import pytest

from dbw.main import main
from tests.telemetry.test_telemetry_bus_docs import FOREIGN

Capture = pytest.CaptureFixture[str]


def test_without_a_file_it_renders_both_buses(tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"
    assert main(["docs", "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"written to {out}/: vehicle.html, harness.html\n"
    assert sorted(path.name for path in out.iterdir()) == ["harness.html", "vehicle.html"]


def test_a_foreign_file_gets_a_page_without_our_words(tmp_path: Path) -> None:
    file = tmp_path / "tank.dbc"
    file.write_text(FOREIGN)
    assert main(["docs", str(file), "--bitrate", "250000", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "tank.html").read_text()
    assert "250 kbit/s" in page and "parameters by SDO" not in page


def test_a_broken_file_is_named_with_its_line_and_may_be_relaxed(
    tmp_path: Path, capsys: Capture
) -> None:
    file = tmp_path / "tank.dbc"
    file.write_text(FOREIGN.replace("BO_ 101 Empty: 0", "BO_ 101 Empty 0"))
    out = tmp_path / "out"
    assert main(["docs", str(file), "--out", str(out)]) == 2
    told = capsys.readouterr().err
    assert f"{file}: line " in told and "--relaxed" in told and not out.exists()
    assert main(["docs", "--relaxed", str(file), "--out", str(out)]) == 0
    assert "Tolerated: " in (out / "tank.html").read_text()


def test_two_files_of_one_name_are_refused(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "a").mkdir()
    for folder in (tmp_path, tmp_path / "a"):
        (folder / "tank.dbc").write_text(FOREIGN)
    files = [str(tmp_path / "tank.dbc"), str(tmp_path / "a" / "tank.dbc")]
    assert main(["docs", *files, "--out", str(tmp_path / "out")]) == 2
    assert "the same page" in capsys.readouterr().err
