"""A number changed in a vehicle file: the rest of its text is untouched, byte for byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from vehicles import VehicleError, known_vehicles, load_vehicle, parse_vehicle
from vehicles.writing import replace_text, with_number


@pytest.mark.parametrize("name", known_vehicles())
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_a_field_is_added_at_the_end_of_its_section(name: str, line_end: str) -> None:
    text = load_vehicle(name).text.replace("\n", line_end)
    changed = with_number(text, "steering", "zero_rad", -0.0123, "measured")
    added = 'zero_rad = { value = -0.0123, source = "measured" }'
    lines = changed.split(line_end)
    place = lines.index(added)
    assert lines[place + 1] == "" and lines[place + 2] == "[traction]"
    assert lines[:place] + lines[place + 1 :] == text.split(line_end)
    assert parse_vehicle(changed, name).steering.zero_rad == -0.0123


def test_a_field_that_is_there_changes_its_entry_and_keeps_the_comment_beside_it() -> None:
    text = load_vehicle("baja_5b").text.replace(
        "\n[traction]", 'zero_rad = { value = 0.1, source = "once" }  # again in May\n\n[traction]'
    )
    changed = with_number(text, "steering", "zero_rad", 0.02, 'with "marks" on C:\\road')
    assert (
        'zero_rad = { value = 0.02, source = "with \\"marks\\" on C:\\\\road" }  # again in May\n'
    ) in changed
    assert len(changed.splitlines()) == len(text.splitlines())
    assert parse_vehicle(changed, "x").steering.zero_rad == 0.02


@pytest.mark.parametrize(
    ("text", "told"),
    [("[steering\n", "not valid TOML"), ("name = 'x'\n", "is missing"),
     ("steering = 3\n", "is missing")],
)  # fmt: skip
def test_a_text_without_the_section_is_refused(text: str, told: str) -> None:
    with pytest.raises(VehicleError, match=told):
        with_number(text, "steering", "zero_rad", 0.0, "measured")


def test_a_file_keeps_its_rights_its_line_ends_and_its_link(tmp_path: Path) -> None:
    place, link = tmp_path / "place.toml", tmp_path / "link.toml"
    place.write_text("old")
    place.chmod(0o640)
    link.symlink_to(place)
    replace_text(link, "new\r\n")
    assert place.read_bytes() == b"new\r\n" and link.is_symlink()
    assert place.stat().st_mode & 0o777 == 0o640
    assert sorted(tmp_path.iterdir()) == [link, place]


def test_a_file_that_is_gone_is_not_made(tmp_path: Path) -> None:
    with pytest.raises(OSError):
        replace_text(tmp_path / "none.toml", "new")
    assert list(tmp_path.iterdir()) == []
