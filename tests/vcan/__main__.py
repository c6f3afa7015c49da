"""`python -m tests.vcan [PYTEST ARGUMENT ...]`: the suite where SocketCAN is.

On this host, if it has vcan0, vcan1, can0 and can1 and we are root; else in virtual machines, two
at a time, whose clocks count instructions, so that times do not depend on the host's load. What
was measured is then in `out/vcan/latency.md`, and printed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO

from runtime.vm import Image, Machine, MachineSettings, VmError, prepare
from tests.vcan import LOAD_VARIABLE, VARIABLE
from tests.vcan.latency import read_rows, table

NETWORKS = ("vcan0", "vcan1", "can0", "can1")
TIMEOUT_S = 3600.0
"""For a suite that takes some ten minutes on a quiet machine."""
HALF = ("test_vcan_faults.py", "test_vcan_command_line.py", "test_vcan_codes.py")
"""About as much work as all other files together: these have a machine of their own."""
ALSO = ("tests/canbus/test_socketcan_kernel.py",)
"""About the kernel as well, without a stack."""
EXIT_NOTHING = 5
"""Of pytest: the arguments chose none of the tests."""

FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]
OUT = ROOT / "out" / "vcan"
PYTEST = [
    "PYTEST_DISABLE_PLUGIN_AUTOLOAD=1", sys.executable, "-m", "pytest", "-p", "pytest_timeout",
    "-p", "no:cacheprovider", "-o", "timeout_func_only=true", f"--confcutdir={FOLDER}",
]  # fmt: skip
"""With no plugin and no conftest.py but those needed: to load them takes the emulated processor
long. A test's time is that without its fixtures."""
GUEST_TEST_S_MAX = 36_000
"""Of a test in a machine, and of a wait for Python's start (`LOAD_S_MAX`). A test that hangs with
nothing to do comes here at once, and one that goes on for ever ends with the machine."""


def main(arguments: list[str]) -> int:
    """The worst exit code of pytest, or 2 when there is no machine to run it in."""
    is_here = all(Path("/sys/class/net", name).exists() for name in NETWORKS)
    own = sorted(FOLDER.glob("test_*.py"))
    files = [*own, *(ROOT / name for name in ALSO)]
    half = [path for path in files if path.name in HALF]
    parts = [half, [path for path in files if path not in half]]
    if is_here and os.geteuid() == 0:
        parts = [files]
    shutil.rmtree(OUT, ignore_errors=True)
    folders = [OUT / str(number) for number in range(len(parts))]
    for folder in folders:
        folder.mkdir(parents=True)
    commands = [_command(*part, arguments) for part in zip(folders, parts, strict=True)]
    if len(parts) > 1:
        patience = ["env", f"{LOAD_VARIABLE}={GUEST_TEST_S_MAX}"]
        commands = [[*patience, *it, "-o", f"timeout={GUEST_TEST_S_MAX}"] for it in commands]
    try:
        codes = _run_in_machines(commands) if len(parts) > 1 else [subprocess.call(commands[0])]
    except VmError as error:
        _say(str(error))
        return 2
    if rows := list(read_rows(folders)):
        OUT.joinpath("latency.md").write_text(table(rows))
        sys.stdout.write(f"\n{table(rows)}")
    return max((code for code in codes if code != EXIT_NOTHING), default=EXIT_NOTHING)


def _command(out: Path, files: list[Path], arguments: list[str]) -> list[str]:
    return ["env", f"{VARIABLE}={out}", *PYTEST, *map(str, files), *arguments]


def _run_in_machines(commands: list[list[str]]) -> list[int]:
    """The exit codes, in order; the second command's output comes when the first has ended."""
    image = prepare(lambda step, text: _say(text))
    with ThreadPoolExecutor(len(commands)) as pool, TemporaryFile() as later:
        sinks = (sys.stdout.buffer, later)
        runs = [
            pool.submit(_run, image, command, sink)
            for command, sink in zip(commands, sinks, strict=True)
        ]
        codes = [run.result() for run in runs]
        later.seek(0)
        sys.stdout.buffer.write(later.read())
        sys.stdout.buffer.flush()
    return codes


def _run(image: Image, command: list[str], sink: BinaryIO) -> int:
    settings = MachineSettings(icount_shift=0, timeout_s=TIMEOUT_S, writable=(OUT,))
    with Machine(image, settings, command, stdout=sink, stderr=sink) as machine:
        code = machine.wait()
        assert code is not None
        return code


def _say(text: str) -> None:
    sys.stderr.write(f"virtual machine: {text}\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
