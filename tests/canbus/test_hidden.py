"""A library that slows down another one's import is out of its sight, and of nobody else's."""

from __future__ import annotations

import subprocess
import sys

import pytest

from canbus.hidden import hidden

IMPORTERS = (
    "canbus.python_can_bus", "canbus.canopen_device", "dbc.database", "telemetry.databases",
    "telemetry.logs.python_can_logs", "telemetry.record.python_can_writers", "dbw.monitor_screen",
)  # fmt: skip


def test_a_hidden_library_is_not_found_and_is_there_again() -> None:
    sys.modules.pop("this", None)
    with hidden("this"), pytest.raises(ModuleNotFoundError):
        __import__("this")
    assert "this" not in sys.modules


def test_a_library_that_is_imported_already_stays() -> None:
    with hidden("pytest"):
        assert __import__("pytest") is pytest
    assert sys.modules["pytest"] is pytest


@pytest.mark.parametrize("module", IMPORTERS)
def test_asammdf_is_installed_and_does_not_slow_down_what_needs_python_can(module: str) -> None:
    code = (
        f"import sys, {module}; assert 'asammdf' not in sys.modules;"
        "import importlib.util; assert importlib.util.find_spec('asammdf')"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
