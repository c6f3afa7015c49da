"""`dbw` in a process forked from this one.

A Python that starts anew reads and runs some five hundred files, which takes the emulated processor
ten seconds, and the stack beside it drives on meanwhile. A fork has them already.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import traceback
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from typing import IO, Any, Self

from dbw.main import main


class ForkedDbw:
    """`dbw` with these arguments, as a `subprocess.Popen` as far as tests need one.

    Its standard output is a pipe. A test module imports what its command imports.

    Args:
        arguments: of `dbw`.
        stderr: where its standard error goes; None leaves it this process's.

    Attributes:
        stdout: what it says, as text.
        returncode: None while it runs.
    """

    def __init__(self, arguments: list[str], stderr: IO[bytes] | None = None) -> None:
        read, write = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(read)
            _become(arguments, write, 2 if stderr is None else stderr.fileno())
        os.close(write)
        self.stdout = os.fdopen(read, "r")
        self._pidfd = os.pidfd_open(self.pid)
        self.returncode: int | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        if exception[0] is not None and self.returncode is None:
            os.kill(self.pid, signal.SIGKILL)
        self.stdout.close()
        self.wait()
        os.close(self._pidfd)

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code, once it has ended.

        Raises:
            subprocess.TimeoutExpired: It has not in so many seconds.
        """
        if self.returncode is None:
            if not wait_for([self._pidfd], timeout):
                raise subprocess.TimeoutExpired("dbw", timeout or 0.0)
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode

    def communicate(self, timeout: float) -> str:
        """What it says until it ends.

        Raises:
            subprocess.TimeoutExpired: It has not in so many seconds.
        """
        deadline_s = time.monotonic() + timeout
        said = b""
        while wait_for([self.stdout.fileno()], max(0.0, deadline_s - time.monotonic())):
            news = os.read(self.stdout.fileno(), 1 << 16)
            if not news:
                return said.decode()
            said += news
        raise subprocess.TimeoutExpired("dbw", timeout)

    def send_signal(self, number: int) -> None:
        """Nothing happens to one whose end is known."""
        if self.returncode is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """At once."""
        self.send_signal(signal.SIGKILL)


def said_by_dbw(*arguments: str, folder: Path) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command that ends by itself."""
    errors = folder / "stderr.txt"
    with errors.open("wb") as sink, ForkedDbw(list(arguments), sink) as process:
        out = process.stdout.read()
        code = process.wait()
    return code, out, errors.read_text()


def _become(arguments: list[str], stdout: int, stderr: int) -> Any:
    """The child: ends as `python -m dbw` does, and nothing of its parent's ends with it."""
    code = 1
    try:
        os.dup2(stdout, 1)
        os.dup2(stderr, 2)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w", buffering=1)
        code = main(arguments)
        sys.stdout.flush()
    except BaseException:  # else the parent's tests would go on in the child
        traceback.print_exc()
    finally:
        os._exit(code)
