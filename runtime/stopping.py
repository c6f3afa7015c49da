"""When a process of the stack has to end: told by a signal, or left alone by its launcher."""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import Any, Self

LAUNCHER_PID_VARIABLE = "DBW_LAUNCHER_PID"
"""Environment variable by which a launcher tells its children who it is."""

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Set by SIGINT or SIGTERM, or by the launcher's death; the handlers last as long as `with`.

    A child whose launcher was killed must not go on alone: nobody would supervise or stop it.
    Its parent's id changes then, which `is_set` looks for; there is no thread and no handler that
    could be late. Only in the main thread.

    Attributes:
        count: signals so far.
    """

    def __init__(self) -> None:
        self.count = 0
        launcher = os.environ.get(LAUNCHER_PID_VARIABLE, "")
        self._launcher_pid = int(launcher) if launcher.isdecimal() else None
        self._old_handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        """Installs the handlers."""
        for number in STOP_SIGNALS:
            self._old_handlers[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *exception: object) -> None:
        """Puts the old handlers back."""
        for number, handler in self._old_handlers.items():
            signal.signal(number, handler)
        self._old_handlers.clear()

    def is_set(self) -> bool:
        """Whether it is time to end."""
        return self.count > 0 or (
            self._launcher_pid is not None and os.getppid() != self._launcher_pid
        )

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
