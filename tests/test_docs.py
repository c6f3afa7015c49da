"""The documents say what the code does."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import click
import pytest

from dbc.messages import SPECS, Mode
from ecus.supervisor.mode import MODE_AFTER, ModeEvent
from tests.dbw.command_lines import in_blocks, options
from vehicles import load_vehicle

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
SAFETY = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))


def mode_rows() -> list[str]:
    """The transitions that change the mode, as the document lists them."""
    return [
        f"| {mode.name} | {event.name} | {MODE_AFTER[mode][event].name} |"
        for mode in Mode
        for event in ModeEvent
        if MODE_AFTER[mode][event] is not mode
    ]


def test_the_mode_table_in_the_docs_is_the_table_in_the_code() -> None:
    block = ARCHITECTURE.split("<!-- modes -->")[1].split("<!-- /modes -->")[0]
    rows = [line for line in block.strip().splitlines()[2:] if line]
    assert rows == mode_rows()


def test_every_folder_in_the_docs_exists() -> None:
    table = ARCHITECTURE.split("## Folders")[1].split("Imports go one way")[0]
    names = re.findall(r"^\| `([a-z_]+)/`", table, flags=re.MULTILINE)
    assert len(names) > 8
    for name in names:
        assert (ROOT / name).is_dir(), name


@pytest.mark.parametrize("path", PAGES, ids=str)
def test_every_link_leads_somewhere(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        if not target.startswith("http"):
            assert (path.parent / target).exists(), target


COMMANDS = [(path.name, line) for path in PAGES for line in in_blocks(path.read_text("utf-8"))]


@pytest.mark.parametrize(("page", "line"), COMMANDS)
def test_every_command_in_the_docs_is_one(page: str, line: str) -> None:
    options(line)


def test_pages_with_commands_are_read() -> None:
    pages = {page for page, _ in COMMANDS}
    assert pages >= {"README.md", "campaign.md", "hardware.md", "my-car.md", "telemetry.md",
                     "virtual-machine.md"}
    assert len(COMMANDS) > 45


@pytest.mark.parametrize("line", ["dbw up --chanel can0", "dbw replay a.log --speed fast"])
def test_a_command_that_is_none_is_found(line: str) -> None:
    with pytest.raises(click.UsageError):
        options(line)


def test_the_identifiers_in_the_docs_are_those_of_the_dbc() -> None:
    for line in ARCHITECTURE.split("## Identifiers")[1].splitlines():
        found = re.match(r"\| (0x[0-9A-F]{3}) \| ([A-Z_]+)", line)
        if found:
            assert SPECS[int(found[1], 16)].name == found[2], line


def test_the_planner_in_the_readme_is_python_that_calls_the_public_api() -> None:
    code = README.split("```python")[1].split("```")[0]
    names = {node.attr for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Attribute)}
    from gateway.api import Car

    public = {"engage", "command", "ticks", "disengage"}
    assert public <= names
    assert all(hasattr(Car, name) for name in public)


def test_the_readme_names_make_targets_that_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make ([a-z-]+)", README, flags=re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target


def test_the_85_ms_of_the_readme_are_the_limit_of_a_20_ms_planner() -> None:
    from dbc.timing import decision_age_limit_ms

    assert "after 85 ms (at a 20 ms period)" in README
    assert decision_age_limit_ms(20) == 85


def test_every_number_of_the_vehicle_has_a_source() -> None:
    text = load_vehicle("tabby_evo").text
    assert text.count("value =") == text.count("source =") > 40
