"""Who may import whom (design, imports), read from the syntax trees: nothing is executed.

`canbus.frame <- dbc <- {ecus, gateway, safety_monitor} <- {simulation, runtime} <- the rest`.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = (
    "canbus", "vehicles", "dbc", "ecus", "gateway", "safety_monitor", "oracle", "simulation",
    "runtime", "planner", "telemetry", "campaign", "experiments", "dbw", "bench", "examples",
)

MAY_IMPORT: dict[str, set[str]] = {
    "canbus": set(),
    "vehicles": set(),
    "dbc": {"canbus"},
    "ecus": {"canbus", "dbc", "vehicles"},
    "gateway": {"canbus", "dbc", "vehicles"},
    "safety_monitor": {"canbus", "dbc", "vehicles"},
    "oracle": {"canbus", "dbc", "vehicles"},
    "planner": {"gateway", "vehicles"},
    "simulation": {"canbus", "dbc", "ecus", "gateway", "oracle", "safety_monitor", "vehicles"},
    "runtime": {"canbus", "dbc", "ecus", "gateway", "safety_monitor", "simulation", "vehicles"},
    "telemetry": {"canbus", "dbc", "gateway", "oracle", "planner", "simulation", "vehicles"},
    "campaign": set(PACKAGES) - {"dbw", "experiments", "bench", "examples"},
    "experiments": set(PACKAGES) - {"campaign", "bench", "examples"},
    "dbw": set(PACKAGES) - {"bench", "examples"},
    "bench": set(PACKAGES) - {"examples"},
    "examples": {"gateway", "planner", "runtime", "vehicles"},
}
"""By top-level package: which others it may name at all."""

WAITING = {"time", "threading", "asyncio", "socket", "can", "random"}
"""What a sans-I/O core must not know."""

GATEWAY_IO = {"gateway/api.py", "gateway/connect.py", "gateway/link.py"}
CLOCKS = {"runtime/clock.py", "gateway/connect.py"}
ECUS = ("brake_servo", "steering", "supervisor", "throttle")


def sources(package: str) -> list[str]:
    return sorted(
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / package).rglob("*.py")
        if "__pycache__" not in path.parts
    )


FILES = [name for package in PACKAGES for name in sources(package)]
EVERY_FILE = pytest.mark.parametrize("name", FILES)


@cache
def tree(name: str) -> ast.Module:
    return ast.parse((ROOT / name).read_text(encoding="utf-8"), name)


@cache
def imports(name: str) -> frozenset[str]:
    """Dotted names of every module imported anywhere in the file, also inside functions."""
    found: set[str] = set()
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"{name}:{node.lineno}: relative import"
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def tops(name: str) -> set[str]:
    return {module.partition(".")[0] for module in imports(name)}


def importers(library: str) -> set[str]:
    """Files that import a library, or a part of it."""
    return {name for name in FILES if library in tops(name)}


def test_every_package_is_covered() -> None:
    found = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert found <= set(PACKAGES), "a new package needs its row in MAY_IMPORT"


@EVERY_FILE
def test_a_package_imports_only_what_lies_below_it(name: str) -> None:
    package = name.partition("/")[0]
    others = tops(name) & set(PACKAGES) - {package}
    assert others <= MAY_IMPORT[package]


@EVERY_FILE
def test_product_code_never_imports_tests(name: str) -> None:
    assert not tops(name) & {"tests", "pytest", "hypothesis"}


@pytest.mark.parametrize("name", sources("dbc"))
def test_the_dbc_knows_frames_and_nothing_else_of_the_bus(name: str) -> None:
    ours = {module for module in imports(name) if module.startswith("canbus")}
    assert all(module.startswith(("canbus.frame", "canbus.hidden")) for module in ours)


@pytest.mark.parametrize("name", ["canbus/frame.py", "canbus/node.py", "canbus/bus.py"])
def test_the_plain_data_of_the_bus_needs_the_standard_library_alone(name: str) -> None:
    allowed = {"__future__", "collections", "dataclasses", "enum", "typing", "canbus", "math"}
    assert tops(name) <= allowed


@pytest.mark.parametrize("name", sources("ecus"))
def test_no_ecu_imports_another(name: str) -> None:
    parts = name.split("/")
    own = parts[1] if len(parts) > 2 else ""
    named = {m.split(".")[1] for m in imports(name) if m.startswith("ecus.") and "." in m}
    assert not named & set(ECUS) - {own}, "they meet as frames"


@pytest.mark.parametrize("name", [*sources("simulation"), *sources("runtime")])
def test_the_plant_and_the_harness_know_ports_and_nothing_else_of_an_ecu(name: str) -> None:
    if name == "simulation/world.py":  # builds the nodes
        return
    for module in imports(name):
        if module.startswith("ecus."):
            assert module.split(".")[2:3] == ["ports"], f"{module}: the ECU's inside"


@pytest.mark.parametrize(
    "name",
    [
        name
        for package in (
            "ecus", "safety_monitor", "oracle", "simulation", "dbc", "gateway", "planner",
        )
        for name in sources(package)
        if name not in GATEWAY_IO
    ],
)
def test_no_core_knows_clocks_threads_sockets_or_chance(name: str) -> None:
    assert not tops(name) & WAITING


@pytest.mark.parametrize(
    "name",
    [n for p in ("ecus", "safety_monitor", "oracle", "simulation", "dbc") for n in sources(p)],
)
def test_no_core_knows_an_interface_to_a_bus(name: str) -> None:
    assert not imports(name) & {"canbus.python_can_bus", "canbus.bus"}
    assert not tops(name) & {"os", "subprocess", "signal", "logging", "select"}


def test_cantools_is_imported_by_the_databases_and_the_generator_alone() -> None:
    assert importers("cantools") - set(sources("bench")) == {
        "dbc/database.py", "dbc/generate.py", "telemetry/databases.py",
    }


@pytest.mark.parametrize("name", sources("oracle"))
def test_the_oracle_shares_nothing_with_the_nodes_but_the_dbc_file(name: str) -> None:
    ours = {m for m in imports(name) if m.startswith(("canbus.", "dbc."))}
    assert all(m.startswith(("canbus.frame", "dbc.database")) for m in ours)


def test_python_can_is_imported_for_buses_and_for_logs_in_one_place_each() -> None:
    assert importers("can") - set(sources("bench")) == {
        "canbus/python_can_bus.py", "telemetry/logs/python_can_logs.py",
        "telemetry/record/python_can_writers.py",
    }


def test_mcap_and_mf4_are_read_and_written_in_one_place_each() -> None:
    assert importers("mcap") == {"telemetry/logs/mcap_log.py", "telemetry/record/mcap_file.py"}
    assert importers("asammdf") - set(sources("bench")) == {
        "telemetry/logs/mf4_log.py", "telemetry/record/mf4_writer.py",
    }


def test_tomlkit_changes_vehicle_files_in_one_place() -> None:
    assert importers("tomlkit") == {"vehicles/writing.py"}


def test_canopen_is_imported_in_one_place() -> None:
    assert importers("canopen") == {"canbus/canopen_device.py"}


def test_the_e2e_library_is_imported_by_the_codec_and_by_its_judge() -> None:
    assert importers("e2e") == {"dbc/protection.py", "oracle/decode.py"}


def test_experiments_drive_as_the_command_line_does_and_are_started_by_one_command() -> None:
    assert importers("experiments") - set(sources("experiments")) == {"dbw/reproduce.py"}


def test_clocks_are_read_in_two_places() -> None:
    measuring = set(sources("bench"))
    assert (importers("time") | importers("datetime")) - measuring == CLOCKS


@EVERY_FILE
def test_a_bus_that_may_be_socketcan_takes_the_kernels_times_of_arrival(name: str) -> None:
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "PythonCanBus":
            is_virtual = ast.unparse(node.args[0]) == "VIRTUAL"
            given = {keyword.arg for keyword in node.keywords}
            assert is_virtual or "realtime" in given, f"{name}:{node.lineno}"


@EVERY_FILE
def test_only_what_a_person_starts_prints(name: str) -> None:
    if name.startswith(("dbw/", "bench/", "examples/")):
        return
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id != "print", f"{name}:{node.lineno}"


@EVERY_FILE
def test_nobody_sleeps(name: str) -> None:
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Attribute) and node.attr == "sleep":
            is_awaited = isinstance(node.value, ast.Name) and node.value.id == "asyncio"
            assert is_awaited and name in GATEWAY_IO, f"{name}:{node.lineno}"


@EVERY_FILE
def test_chance_is_made_where_a_world_is_made_and_with_a_seed(name: str) -> None:
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("default_rng"):
            assert node.args, f"{name}:{node.lineno}: a generator without a seed"
            assert name.startswith(
                ("simulation/world", "runtime/plant_process", "campaign/run", "experiments/chance",
                 "dbw/", "bench/")
            )
