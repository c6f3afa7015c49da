"""`python -m tests.vcan [PYTEST ARGUMENT ...]`: the suite where SocketCAN is.

On this host, if it has vcan0, vcan1, can0 and can1 and we are root; else in the virtual machine,
whose clock counts instructions, so that times do not depend on the host's load.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from runtime.vm import MachineSettings, VmError, prepare, run
from tests.vcan import VARIABLE

NETWORKS = ("vcan0", "vcan1", "can0", "can1")
TIMEOUT_S = 3000.0
"""For a suite that takes some ten minutes on a quiet machine."""


def main(arguments: list[str]) -> int:
    """The exit code of pytest, or 2 when there is no machine to run it in."""
    os.environ[VARIABLE] = "1"
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "tests/vcan", *arguments]
    has_networks = all(Path("/sys/class/net", name).exists() for name in NETWORKS)
    if has_networks and os.geteuid() == 0:
        os.execv(command[0], command)
    try:
        image = prepare(lambda step, text: _say(text))
        return run(image, MachineSettings(icount_shift=0, timeout_s=TIMEOUT_S), command)
    except VmError as error:
        _say(f"the vcan suite needs SocketCAN: {error}")
        return 2


def _say(text: str) -> None:
    sys.stderr.write(f"virtual machine: {text}\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
