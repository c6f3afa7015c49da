"""The stack on SocketCAN: answers, reading, ten minutes on a full bus, what each process costs.

Measured on this computer if it has vcan0 and vcan1 and we are root; else in the virtual machine
with a clock that counts instructions. Its times do not depend on what else the computer does, but
they are those of one processor that takes 1 ns for every instruction: ratios count.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from bench.socketcan.guest import CALL, PARTS, Measured
from bench.socketcan.report import SocketcanResult
from runtime.vm import Machine, MachineSettings, prepare

__all__ = ["NAME", "SocketcanResult", "measure", "measure_parts"]

NAME = "socketcan"
NETWORKS = ("vcan0", "vcan1")
TIMEOUT_S = 4 * 3600.0
"""Ten minutes of the guest take an hour on a computer that emulates it with one core to spare."""


def measure(*, quick: bool = False) -> SocketcanResult:
    """All parts.

    Raises:
        VmError: there is no SocketCAN here and the virtual machine cannot be had.
        RuntimeError: a part has failed; it has said on standard error why.
    """
    return measure_parts(tuple(PARTS), quick=quick)


def measure_parts(names: Sequence[str], *, quick: bool) -> SocketcanResult:
    """These parts alone, as `measure`."""
    command = [sys.executable, "-c", CALL, *names, *["--quick"] * quick]
    is_here = all(Path("/sys/class/net", name).exists() for name in NETWORKS) and not os.geteuid()
    answer = subprocess.run(command, check=False, stdout=subprocess.PIPE) if is_here else None
    code, data = (answer.returncode, answer.stdout) if answer else _in_the_machine(command)
    if code != 0:
        raise RuntimeError(f"measuring {', '.join(names)} has failed with exit code {code}")
    measured: Measured = pickle.loads(data)
    return SocketcanResult(quick=quick, is_emulated=not is_here, measured=measured)


def _in_the_machine(command: Sequence[str]) -> tuple[int | None, bytes]:
    settings = MachineSettings(icount_shift=0, timeout_s=TIMEOUT_S)
    sink = BytesIO()
    with Machine(prepare(), settings, command, stdout=sink) as machine:
        return machine.wait(), sink.getvalue()
