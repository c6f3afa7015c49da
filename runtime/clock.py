"""The wall clock of everything that runs in real time. The only place that reads one."""

from __future__ import annotations

import time
from collections.abc import Callable

Clock = Callable[[], int]
"""Answers the time in ns; never goes back."""

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000


def monotonic_ns() -> int:
    """Time since an arbitrary start in ns; never goes back.

    On Linux this is CLOCK_MONOTONIC, which all processes of a machine share: nodes in separate
    processes keep their phases to each other.
    """
    return time.monotonic_ns()


def realtime_ns() -> int:
    """The system's clock in ns since 1970, which may be set at any time: only to be compared with
    the kernel's stamps on frames."""
    return time.time_ns()


def local_text(time_s: int) -> str:
    """Date and time of day, in the local zone, of whole seconds since 1970."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(time_s))
