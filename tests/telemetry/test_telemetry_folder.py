"""All files or none."""

from __future__ import annotations

from pathlib import Path

import pytest

from telemetry.folder import FolderError, ResultFolder


def test_files_appear_at_commit_and_not_before(tmp_path: Path) -> None:
    destination = tmp_path / "a" / "b"
    with ResultFolder(destination) as folder:
        (folder.path / "report.json").write_text("{}")
        assert not destination.exists()
        assert folder.commit() == [destination / "report.json"]
    assert (destination / "report.json").read_text() == "{}"
    assert [item.name for item in destination.parent.iterdir()] == ["b"]


def test_without_commit_nothing_remains_not_even_new_parents(tmp_path: Path) -> None:
    def fail() -> None:
        with ResultFolder(tmp_path / "a" / "b" / "c") as folder:
            (folder.path / "report.json").write_text("{}")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_files_of_an_earlier_drive_are_replaced_and_others_left_alone(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    with ResultFolder(tmp_path) as folder:
        (folder.path / "report.json").write_text("new")
        folder.commit()
    assert (tmp_path / "report.json").read_text() == "new"
    assert sorted(item.name for item in tmp_path.iterdir()) == ["notes.txt", "report.json"]


def test_unfinished_drive_leaves_the_earlier_ones_files(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text("old")
    with ResultFolder(tmp_path) as folder:
        (folder.path / "report.json").write_text("new")
    assert (tmp_path / "report.json").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_destination_that_is_a_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "out"
    file.write_text("x")
    with pytest.raises(FolderError, match="is a file: a folder is wanted"):
        ResultFolder(file).__enter__()
    assert file.read_text() == "x"


def test_destination_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("")
    with pytest.raises(FolderError, match="cannot be written"):
        ResultFolder(tmp_path / "x" / "out").__enter__()


def test_file_in_the_way_of_a_result_is_reported(tmp_path: Path) -> None:
    (tmp_path / "report.json").mkdir()
    with ResultFolder(tmp_path) as folder:
        (folder.path / "report.json").write_text("new")
        with pytest.raises(FolderError, match="cannot be written"):
            folder.commit()
    assert [item.name for item in tmp_path.iterdir()] == ["report.json"]


def test_folder_is_readable_by_others_as_the_umask_says(tmp_path: Path) -> None:
    with ResultFolder(tmp_path / "out") as folder:
        folder.commit()
    reference = tmp_path / "reference"
    reference.mkdir()
    assert (tmp_path / "out").stat().st_mode == reference.stat().st_mode
