"""The compiled stack is the same stack: equal traces, bit for bit."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import compile_stack
from tests.scenarios.driving import Drive

DRIVE = """
from simulation import kernel
from tests.scenarios.driving import Drive
assert kernel.__file__.endswith(".so"), kernel.__file__
drive = Drive(7).go(3.0)
drive.run(2.0)
print(drive.world.trace.sha256)
"""


def test_modules_that_stay_interpreted_exist() -> None:
    for name in compile_stack.INTERPRETED:
        assert (compile_stack.ROOT / name).exists(), name


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_a_drive_of_the_compiled_stack_has_the_same_trace(tmp_path: Path) -> None:
    compile_stack.compile_into(tmp_path / "compiled")
    run = subprocess.run(
        [sys.executable, "-P", "-c", DRIVE],
        env={**os.environ, "PYTHONPATH": f"{tmp_path / 'compiled'}:{compile_stack.ROOT}"},
        capture_output=True, text=True, check=False,
    )
    drive = Drive(7).go(3.0)
    drive.run(2.0)
    assert run.stdout.strip() == drive.world.trace.sha256, run.stderr
