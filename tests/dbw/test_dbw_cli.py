"""Help, version, and the shape of errors."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dbw.main import COMMANDS, main

Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize("command", list(COMMANDS))
def test_help_of_every_command_has_an_example(command: str, capsys: Capture) -> None:
    assert main([command, "--help"]) == 0
    shown = capsys.readouterr()
    assert "Example" in shown.out and f"\n  dbw {command}" in shown.out.replace("    ", "  ")
    assert shown.err == ""


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]])
def test_overview_lists_every_command(arguments: list[str], capsys: Capture) -> None:
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert all(f"\n  {name} " in shown for name in COMMANDS)
    assert "dbw demo" in shown and "Exit codes" in shown


def test_version_is_one_line(capsys: Capture) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("dbw ")


def test_unknown_command_names_the_known_ones(capsys: Capture) -> None:
    assert main(["drive"]) == 2
    assert capsys.readouterr().err == (
        f"dbw: error: no command 'drive': allowed {', '.join(COMMANDS)}\n"
    )


def test_module_runs_as_a_program_and_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from dbw.main import main; main(['demo', '--help']);"
        "print([m for m in ('numpy', 'scipy', 'matplotlib', 'can', 'canopen') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    wrong = subprocess.run(
        [sys.executable, "-m", "dbw", "ecu", "gearbox"], capture_output=True, text=True, check=False
    )
    assert wrong.returncode == 2 and wrong.stdout == ""
    assert wrong.stderr.startswith("dbw: error: node 'gearbox' is not known: allowed steering")
    assert wrong.stderr.count("\n") == 1


def test_programmers_error_is_not_dressed_up_as_a_users(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: object, **options: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("dbw.demo.run_demo", broken)
    with pytest.raises(ZeroDivisionError):
        main(["demo"])


def test_ctrl_c_ends_with_130_and_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("dbw.demo.run_demo", interrupted)
    assert main(["demo"]) == 130
    assert capsys.readouterr().err.strip() == "dbw: interrupted"
