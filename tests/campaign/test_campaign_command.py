"""`dbw campaign`: from the command line to the results, the report and the exit code."""

from __future__ import annotations

import io
import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from campaign import cluster
from campaign.failure import Tally
from campaign.parts import read_hashes
from campaign.settings import CampaignSettings
from campaign.store import campaign_sha256
from dbw import campaign_screen
from dbw.campaign_screen import CampaignScreen, progress_line
from dbw.main import main
from tests.campaign import fakes
from tests.campaign.test_workers import ROOT, is_running, killed_if_it_fails, until
from vehicles.reading import vehicle_text

Capture = pytest.CaptureFixture[str]
SEEDS = CampaignSettings().seeds(0.4, 0)
SHA256 = campaign_sha256(fakes.result_of(seed).trace_sha256 for seed in SEEDS)
COMMAND = """
import sys
from functools import partial
from pathlib import Path
import campaign.run
from dbw.main import main
from tests.campaign import fakes
if __name__ == "__main__":
    campaign.run.run_seed = partial(fakes.run_forever, Path(sys.argv[1]))
    sys.exit(main(sys.argv[2:]))
"""


def arguments(out: Path, *more: str) -> list[str]:
    return ["campaign", "--hours", "0.4", "--workers", "2", "--out", str(out), *more]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Callable[[object], None]:
    """Puts another seed in place of the real one."""

    def put(run_seed: object) -> None:
        monkeypatch.setattr("campaign.run.run_seed", run_seed)
        monkeypatch.setattr("campaign.run.faults_of", fakes.faults_of)

    return put


@pytest.mark.slow
def test_a_campaign_without_failures_is_reported_and_is_not_run_twice(
    tmp_path: Path, capsys: Capture, fake: Callable[[object], None]
) -> None:
    fake(fakes.run_seed)
    assert main(arguments(tmp_path / "out")) == 0
    first = capsys.readouterr()
    assert f"trace {SHA256}" in first.out and first.err == ""
    assert f"report: {tmp_path}/out/report.html" in first.out
    assert (tmp_path / "out" / "report.html").stat().st_size > 1000
    fake(fakes.run_raising)
    assert main(arguments(tmp_path / "out")) == 0, "nothing was missing"
    assert f"trace {SHA256}" in capsys.readouterr().out
    assert main(arguments(tmp_path / "out", "--restart")) == 1, "and begun anew, one seed raises"
    assert "ZeroDivisionError: one over nothing" in capsys.readouterr().out


@pytest.mark.slow
def test_failing_seeds_are_told_minimised_and_recorded(
    tmp_path: Path, capsys: Capture, fake: Callable[[object], None]
) -> None:
    fake(fakes.run_failing)
    out = tmp_path / "out"
    assert main(arguments(out)) == 1
    shown = capsys.readouterr()
    assert shown.err == "dbw: error: 2 of 12 seeds failed\n"
    for seed in fakes.FAILING:
        assert f"seed {seed}: at 30.000 s: no crash and freeze: both at once\n" in shown.out
        assert f"dbw campaign --replay {seed} --out {out}\n" in shown.out
        text = (out / f"replay-{seed}" / "replay.txt").read_text()
        assert f"seed {seed}, 120 s: equal to the stored result" in text
        fewest = (out / f"replay-{seed}" / "fewest-faults.toml").read_text()
        assert fewest.count("[[fault]]") == 2 and '"crash"' in fewest and '"freeze"' in fewest
    assert main(["campaign", "--replay", "3", "--out", str(out)]) == 1
    assert "equal to the stored result" in capsys.readouterr().out
    assert main(["campaign", "--replay", "4", "--out", str(out)]) == 0
    fake(fakes.run_seed)
    assert main(["campaign", "--replay", "3", "--out", str(out)]) == 1, "other than stored"
    assert "differs from the stored result" in capsys.readouterr().out


def test_a_replay_needs_no_campaign(
    tmp_path: Path, capsys: Capture, fake: Callable[[object], None]
) -> None:
    fake(fakes.run_failing)
    assert main(["campaign", "--replay", "4", "--out", str(tmp_path / "out")]) == 0
    assert "no stored result to compare with" in capsys.readouterr().out
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["replay-4"]


@pytest.mark.slow
def test_a_terminated_campaign_keeps_what_is_finished_and_goes_on(
    tmp_path: Path, capsys: Capture, fake: Callable[[object], None]
) -> None:
    out, pids, script = tmp_path / "out", tmp_path / "pids", tmp_path / "command.py"
    pids.mkdir()
    script.write_text(COMMAND)
    with subprocess.Popen(
        [sys.executable, str(script), str(pids), *arguments(out)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        text=True,
    ) as running, killed_if_it_fails(running):
        until(lambda: len(list(pids.iterdir())) == 2)
        running.send_signal(signal.SIGTERM)
        _, said = running.communicate(timeout=120)
    assert running.returncode == 130
    assert said.splitlines()[0] == f"dbw: what is finished is in {out}: the same command goes on"
    assert said.splitlines()[-1] == "dbw: interrupted"
    assert not any(is_running(int(path.name)) for path in pids.iterdir())
    finished = [seed for seed, _ in read_hashes(out)]
    assert {0, 1} <= set(finished) <= {0, 1, 2, 3}
    fake(fakes.run_seed)
    assert main(arguments(out)) == 0
    assert f"trace {SHA256}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--hours", "0"], "--hours 0: allowed is above 0 up to 1000000"),
        (["--hours", "-1"], "--hours -1: allowed is above 0"),
        (["--hours", "nan"], "--hours nan: allowed is above 0"),
        (["--hours", "many"], "'many' is not a valid float"),
        (["--seed", "-1"], "'-1': a whole number from 0 to 4294967295 is wanted"),
        (["--workers", "0"], "--workers 0: allowed auto, 1 to 1024, and dask://HOST:PORT"),
        (["--workers", "dask://127.0.0.1:9"], "dask://127.0.0.1:9: no Dask scheduler answers"),
        (["--workers", "dask://nobody"], "dask://nobody: no Dask scheduler answers"),
        (["--faults", "missing.toml"], "missing.toml: No such file"),
        (["--vehicle", "tabby"], "vehicle 'tabby' is not known: allowed baja_5b"),
        (["--vehicle", "missing.toml"], "missing.toml: cannot be read"),
        (["--replay", "3", "--vehicle", "missing.toml"], "missing.toml: cannot be read"),
        (["--replay", "3", "--faults", "missing.toml"], "missing.toml: No such file"),
        (["--replay", "3", "--restart"], "--restart would remove it"),
        (["--replay", "x"], "'x': a whole number from 0"),
        (["--hour", "1"], "No such option '--hour'"),
        (["now"], "unexpected extra argument"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    options: list[str],
    said: str,
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cluster, "CONNECT_S", 0.3)
    assert said in refused(["campaign", "--out", str(tmp_path / "out"), *options], tmp_path, capsys)


def refused(arguments: list[str], folder: Path, capsys: Capture) -> str:
    """Runs a command that must be refused; answers its one line."""
    before = sorted(folder.rglob("*"))
    assert main(arguments) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.startswith("dbw: error: ")
    assert shown.err.count("\n") == 1
    assert sorted(folder.rglob("*")) == before
    return shown.err


@pytest.mark.slow
def test_a_users_own_car_is_driven_and_told_from_another(
    tmp_path: Path, capsys: Capture, fake: Callable[[object], None]
) -> None:
    fake(fakes.run_failing)
    out, car = tmp_path / "out", tmp_path / "my car.toml"
    text = vehicle_text("fsae_electric").replace('name = "fsae_electric"', 'name = "mine"')
    car.write_text(text)
    assert main(arguments(out, "--vehicle", str(car))) == 1
    again = f"dbw campaign --replay 3 --out {out} --vehicle '{car}'"
    assert again in capsys.readouterr().out
    assert main([*shlex.split(again)[1:]]) == 1
    assert "equal to the stored result" in capsys.readouterr().out
    assert json.loads((out / "report.json").read_text())["vehicle"] == str(car)
    assert main(arguments(out)) == 2, "another car"
    assert "the campaign there has other settings" in capsys.readouterr().err
    car.write_text(text.replace("mass_kg = { value = 355.0", "mass_kg = { value = 400.0"))
    assert main(arguments(out, "--vehicle", str(car))) == 2, "the same file, changed"
    assert "the campaign there has other settings" in capsys.readouterr().err


def test_an_empty_file_of_faults_is_refused_and_not_taken_for_none(
    tmp_path: Path, capsys: Capture
) -> None:
    empty = tmp_path / "empty.toml"
    empty.touch()
    said = refused(arguments(tmp_path / "out", "--faults", str(empty)), tmp_path, capsys)
    assert f"{empty}: wanted is a list of [[fault]] tables" in said


def test_a_fault_of_a_drive_is_refused_for_a_car_without_drives(
    tmp_path: Path, capsys: Capture, fake: Callable[[object], None]
) -> None:
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nkind = "drive_dead"\ntarget = "LeftWheelDrive"\nat_s = 9.0\n')
    options = arguments(tmp_path / "out", "--faults", str(faults))
    assert f"{faults}: line 1: kind 'drive_dead': this car has no motor drives" in refused(
        options, tmp_path, capsys
    )
    fake(fakes.run_seed)
    assert main([*options, "--vehicle", "baja_5b"]) == 0


def test_a_file_of_faults_with_an_error_is_refused_with_its_line(
    tmp_path: Path, capsys: Capture
) -> None:
    file = tmp_path / "faults.toml"
    file.write_text('[[fault]]\nkind = "crash"\ntarget = "Steering"\nat_s = 1\n\n[[fault]]\n')
    line = refused(arguments(tmp_path / "out", "--faults", str(file)), tmp_path, capsys)
    assert f"{file}: line 6: kind None: allowed drop, " in line


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    assert f"{file} is a file" in refused(arguments(file), tmp_path, capsys)
    assert "cannot be written" in refused(arguments(file / "out"), tmp_path, capsys)
    assert "cannot be written" in refused(arguments(Path("/proc/out")), tmp_path, capsys)


def test_another_campaign_in_the_folder_is_refused(
    tmp_path: Path, capsys: Capture, fake: Callable[[object], None]
) -> None:
    fake(fakes.run_seed)
    out = tmp_path / "out"
    assert main(arguments(out)) == 0
    capsys.readouterr()
    (out / ".lock").touch()
    line = refused(arguments(out, "--seed", "9"), tmp_path, capsys)
    assert f"{out}: the campaign there begins with seed 0; --restart begins anew" in line


def test_progress_tells_hours_speed_time_left_and_failures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tally = Tally(seeds=60, simulated_s=7200.0, violations=2, missed=1)
    line = progress_line(tally, 36_000.0, 32.0)
    assert line == "2.00/10.00 h  32 x  0:15:00 left  violations 2  missed 1"
    assert "? left" in progress_line(Tally(), 36_000.0, 0.0)
    file = io.StringIO()
    console = Console(file=file, force_terminal=True, width=100)
    with CampaignScreen(console, 36_000.0, tally) as screen:
        screen.show(fakes.result_of(7))
    assert "2.03/10.00 h" in file.getvalue()
    log = io.StringIO()
    monkeypatch.setattr(campaign_screen, "LINE_NS", 0)
    with CampaignScreen(Console(file=log), 36_000.0, tally) as screen:
        screen.show(fakes.result_of(7))
    assert log.getvalue().startswith("2.07/10.00 h  ") and log.getvalue().count("\n") == 1
