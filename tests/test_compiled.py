"""The compiled stack is the same stack: equal traces and equal verdicts, bit for bit."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import compile_stack
from oracle import judge
from simulation import kernel
from tests.oracle.storms import Stormy, storm, weather
from tests.scenarios.driving import Drive

SEEDS = range(6)
UNTOLD_SEED = 3
IN_A_PROCESS = """
from tests.test_compiled import is_compiled, story
assert is_compiled(), "not the compiled modules"
print(*story(), sep="\\n")
"""


def is_compiled() -> bool:
    """Whether the modules in use are those that mypyc made."""
    return all(str(module.__file__).endswith(".so") for module in (kernel, judge))


def story() -> list[str]:
    """Traces of a drive and of storms, and what the oracle makes of them."""
    drive = Drive(7).go(3.0)
    drive.run(2.0)
    lines = [drive.world.trace.sha256]
    for seed in SEEDS:
        stormy, report = weather(seed)
        lines.append(f"{stormy.drive.world.trace.sha256} {report!r}")
    return [*lines, repr(_untold())]


def _untold() -> object:
    """A storm of which the oracle is not told: every emergency looks like a false one."""
    stormy = Stormy(UNTOLD_SEED)
    stormy.injector.listeners.clear()
    begin_s = stormy.drive.world.now_ns * 1e-9
    report = stormy.run(storm(np.random.default_rng(UNTOLD_SEED), begin_s))
    assert report.violations, "nothing to compare"
    return report


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
