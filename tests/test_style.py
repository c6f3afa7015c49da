"""The habits of this house as tests: sizes, names with units, docstrings, nothing left undone."""

from __future__ import annotations

import ast
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from tests.test_import_rules import EVERY_FILE, FILES, ROOT, tree
from vehicles import load_vehicle
from vehicles.vehicle import Vehicle

LINES_MAX = 400
FUNCTION_LINES_MAX = 70
LONGER = {"canbus/canopen_device.py": 440}  # all that touches the canopen package, in one place
GENERATED = {"dbc/messages.py", "dbc/harness.py", "dbc/byte_commands.py"}
UNITS = {
    "rad", "radps", "radps2", "m", "mps", "mps2", "mps3", "kg", "kgm2", "s", "ns", "ms", "nm",
    "bps", "ratio", "per_s", "per_s2", "per_m", "per_rev",
}
"""Endings that tell a unit, written as `per_` where it is one over something."""
PLAIN_NUMBERS = {"ratio", "gear_ratio", "rate_gain", "foreign_id_min", "foreign_id_max"}
"""Numbers without a unit: quotients, a gain in radians per second each, identifiers."""

TESTS = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (ROOT / "tests").rglob("*.py")
    if "__pycache__" not in path.parts
)
OWN_NAME = Path(__file__).name


@pytest.mark.parametrize("name", FILES)
def test_a_file_can_be_read_in_one_sitting(name: str) -> None:
    if name not in GENERATED:
        lines = (ROOT / name).read_text(encoding="utf-8").count("\n")
        assert lines <= LONGER.get(name, LINES_MAX), f"{name}: {lines} lines"


@EVERY_FILE
def test_a_function_fits_on_a_screen(name: str) -> None:
    if name in GENERATED:
        return
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            lines = node.end_lineno - node.lineno + 1
            assert lines <= FUNCTION_LINES_MAX, f"{name}:{node.lineno}: {node.name} has {lines}"


def undocumented(body: list[ast.stmt], owner: str = "") -> list[str]:
    """Public classes, and functions and methods that no base class documents, without a text."""
    found = []
    for node in body:
        if not isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if node.name.startswith("_"):
            continue
        if ast.get_docstring(node) is None:
            found.append(f"{owner}{node.name} (line {node.lineno})")
        if isinstance(node, ast.ClassDef):
            found += undocumented(node.body, f"{node.name}.")
    return found


@EVERY_FILE
def test_everything_public_says_what_it_is_for(name: str) -> None:
    module = tree(name)
    assert ast.get_docstring(module) is not None or not module.body, name
    assert undocumented(module.body) == []


@pytest.mark.parametrize("name", [*FILES, *TESTS])
def test_nothing_is_left_for_later(name: str) -> None:
    if Path(name).name == OWN_NAME:
        return
    text = (ROOT / name).read_text(encoding="utf-8")
    assert not re.search(r"\b(TODO|FIXME|XXX|HACK)\b", text.replace("Vector__XXX", ""))


def numeric_fields() -> list[str]:
    vehicle: Any = load_vehicle("tabby_evo")
    return [
        f"{section.name}.{field.name}"
        for section in fields(Vehicle)
        if not isinstance(getattr(vehicle, section.name), str | None)
        for field in fields(getattr(vehicle, section.name))
        if isinstance(getattr(getattr(vehicle, section.name), field.name), float)
    ]


@pytest.mark.parametrize("name", numeric_fields())
def test_a_number_of_a_vehicle_carries_its_unit(name: str) -> None:
    field = name.partition(".")[2]
    bare = re.sub(r"_(max|min|full)$", "", field)
    ends = bare in PLAIN_NUMBERS or field in PLAIN_NUMBERS
    assert ends or any(bare.endswith(f"_{unit}") for unit in UNITS), name


def has_final_fields(node: ast.ClassDef) -> bool:
    """What the type checker, and a compiled class at run time, takes for frozen."""
    fields = [field for field in node.body if isinstance(field, ast.AnnAssign)]
    return all(ast.unparse(field.annotation).startswith("Final[") for field in fields)


@EVERY_FILE
def test_a_dataclass_that_crosses_a_boundary_is_frozen(name: str) -> None:
    """Messages, vehicles, limits and findings: nobody changes what another has been given."""
    if not name.startswith(("dbc/", "vehicles/", "safety_monitor/", "canbus/node")):
        return
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.ClassDef):
            for decorator in map(ast.unparse, node.decorator_list):
                if decorator.startswith("dataclass") and "frozen=True" not in decorator:
                    assert has_final_fields(node), f"{name}:{node.lineno}"


@pytest.mark.parametrize("name", TESTS)
def test_the_name_of_a_test_is_a_sentence(name: str) -> None:
    for node in ast.walk(ast.parse((ROOT / name).read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            assert node.name.count("_") >= 2, f"{name}:{node.lineno}: {node.name}"
