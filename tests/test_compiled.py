"""The compiled stack is the same stack: equal traces and equal verdicts, bit for bit."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import compile_stack
from campaign import ledger
from campaign.run import build, faults_of, run_seed
from campaign.settings import CampaignSettings
from oracle import judge
from simulation import kernel

SETTINGS = CampaignSettings(seed_s=60.0)
SEEDS = range(4)
FAULTS = """
[[fault]]
kind = "drive_deaf"
target = "LeftWheelDrive"
at_s = 6.0
for_s = 0.5
[[fault]]
kind = "drive_fault"
target = "*"
per_h = 400.0
for_s = 0.5
"""
ON_DRIVES = CampaignSettings(vehicle="baja_5b", seed_s=30.0, faults_text=FAULTS)
UNTOLD_SEED = 3
IN_A_PROCESS = """
from tests.test_compiled import is_compiled, story
assert is_compiled(), "not the compiled modules"
print(*story(), sep="\\n")
"""


def is_compiled() -> bool:
    """Whether the modules in use are those that mypyc made."""
    return all(str(module.__file__).endswith(".so") for module in (kernel, judge, ledger))


def story() -> list[str]:
    """What campaign's seeds come to, traces and verdicts and all, and what an oracle makes of
    storms that it is not told of: every emergency looks like a false one."""
    lines = []
    for seed in SEEDS:
        result = run_seed(SETTINGS, seed)
        assert result.injections
        lines.append(repr(replace(result, cpu_s=0.0)))
    sent = pickle.loads(pickle.dumps(ON_DRIVES))  # as to a worker
    on_drives = run_seed(sent, 0)
    assert sent.faults is not None and len(on_drives.injections) > 1
    lines.append(repr(replace(on_drives, cpu_s=0.0)))
    scenario = build(SETTINGS, UNTOLD_SEED)
    scenario.injector.plan(faults_of(SETTINGS, UNTOLD_SEED))
    scenario.injector.listeners.clear()
    scenario.world.run_until(round(SETTINGS.seed_s * 1e9))
    untold = scenario.oracle.finish(scenario.world.now_ns)
    assert untold.violations, "nothing to compare"
    return [*lines, repr(untold)]


def test_modules_that_stay_interpreted_exist() -> None:
    for name in compile_stack.INTERPRETED:
        assert (compile_stack.ROOT / name).exists(), name


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_compiled_stack_has_the_same_traces_and_verdicts(tmp_path: Path) -> None:
    compile_stack.compile_into(tmp_path / "compiled")
    run = subprocess.run(
        [sys.executable, "-P", "-c", IN_A_PROCESS],
        env={**os.environ, "PYTHONPATH": f"{tmp_path / 'compiled'}:{compile_stack.ROOT}"},
        capture_output=True, text=True, check=False,
    )
    assert run.stdout.splitlines() == story(), run.stderr
