"""`python -m tests.vcan [PYTEST ARGUMENT ...]`: the suite where SocketCAN is.

On this host, if it has vcan0, vcan1, can0 and can1 and we are root; else in virtual machines, two
at a time, whose clocks count instructions, so that times do not depend on the host's load.
"""

from __future__ import annotations

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO

from runtime.vm import Image, Machine, MachineSettings, VmError, prepare
from tests.vcan import VARIABLE

NETWORKS = ("vcan0", "vcan1", "can0", "can1")
TIMEOUT_S = 2400.0
"""For a suite that takes some ten minutes on a quiet machine."""
HALF = ("test_vcan_faults.py", "test_vcan_clock.py")
"""About as much work as all other files together: these two have a machine of their own."""
EXIT_NOTHING = 5
"""Of pytest: the arguments chose none of the tests."""

FOLDER = Path(__file__).parent
PYTEST = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]


def main(arguments: list[str]) -> int:
    """The worst exit code of pytest, or 2 when there is no machine to run it in."""
    os.environ[VARIABLE] = "1"
    if all(Path("/sys/class/net", name).exists() for name in NETWORKS) and os.geteuid() == 0:
        os.execv(sys.executable, [*PYTEST, str(FOLDER), *arguments])
    files = sorted(path.name for path in FOLDER.glob("test_*.py"))
    parts = [list(HALF), [name for name in files if name not in HALF]]
    try:
        image = prepare(lambda step, text: _say(text))
        with ThreadPoolExecutor(len(parts)) as pool, TemporaryFile() as later:
            sinks = (sys.stdout.buffer, later)
            runs = [
                pool.submit(_run, image, part, arguments, sink)
                for part, sink in zip(parts, sinks, strict=True)
            ]
            codes = [run.result() for run in runs]
            later.seek(0)
            sys.stdout.buffer.write(later.read())
    except VmError as error:
        _say(str(error))
        return 2
    ran = [code for code in codes if code != EXIT_NOTHING]
    return max(ran, default=EXIT_NOTHING)


def _run(image: Image, files: list[str], arguments: list[str], sink: BinaryIO) -> int:
    command = [*PYTEST, *(str(FOLDER / name) for name in files), *arguments]
    settings = MachineSettings(icount_shift=0, timeout_s=TIMEOUT_S)
    with Machine(image, settings, command, stdout=sink, stderr=sink) as machine:
        code = machine.wait()
        assert code is not None
        return code


def _say(text: str) -> None:
    sys.stderr.write(f"virtual machine: {text}\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
