"""What a process that has deadlines asks of Linux: scheduling, memory and processors of its own.

Asked for by name and refused, the process does not start: whoever wrote `fifo:50` counts on it.
Without a wish the best is asked for and its refusal told.
"""

from __future__ import annotations

import ctypes
import gc
import os
import re
from contextlib import suppress
from dataclasses import dataclass

from runtime.errors import LaunchError

AUTO = "auto"
OFF = "off"
AUTO_SCHEDULING = "rr:10"
"""Above every ordinary thread, below the kernel's own (threaded interrupts have 50). In turns, so
that a node in an endless loop does not take the other nodes' processor with it."""

POLICIES = {"fifo": "SCHED_FIFO", "rr": "SCHED_RR"}
PRIORITY_MAX = 99
MCL_CURRENT = 1
MCL_FUTURE = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class RealtimeSettings:
    """What to ask for; the options of `dbw up` and `dbw ecu`.

    Attributes:
        scheduling: "fifo:PRIO" or "rr:PRIO" with a priority of 1 to 99 (sched(7)); "off"; "auto"
            for `AUTO_SCHEDULING` where the system grants it.
        lock_memory: keep all memory, present and future, from being paged out (mlockall(2)).
        cpus: processors to run on; empty leaves it to the system.

    Raises:
        LaunchError: the scheduling is none of these.
    """

    scheduling: str = AUTO
    lock_memory: bool = False
    cpus: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what cannot be asked for."""
        if self.scheduling in (AUTO, OFF):
            return
        found = re.fullmatch(r"(fifo|rr):(\d{1,2})", self.scheduling)
        if found is None or not 1 <= int(found[2]) <= PRIORITY_MAX:
            raise LaunchError(
                f"--realtime {self.scheduling}: allowed {AUTO}, {OFF}, "
                f"and fifo:PRIO or rr:PRIO with a priority of 1 to {PRIORITY_MAX}"
            )

    @property
    def options(self) -> list[str]:
        """The command line that says the same."""
        options = ["--realtime", self.scheduling]
        if self.lock_memory:
            options.append("--lock-memory")
        if self.cpus:
            options += ["--cpus", ",".join(map(str, self.cpus))]
        return options


def keep_collections_short() -> None:
    """Takes what is loaded so far out of the garbage collector's sight, for good.

    A full collection of it stops the process for 24 to 59 ms on a slow processor (measured on the
    plant in the virtual machine), longer than a wire may be silent.
    """
    gc.collect()
    gc.freeze()


def apply_realtime(settings: RealtimeSettings) -> str | None:
    """Asks the system for what the settings say, for the calling thread and what it locks.

    Scheduling is not inherited by what the thread starts; processors are.

    Returns:
        What "auto" did not get and what follows from that, in one line; None when all is granted.

    Raises:
        LaunchError: something asked for by name is refused.
    """
    if settings.cpus:
        _pin(settings.cpus)
    if settings.lock_memory:
        _lock_memory()
    if settings.scheduling == AUTO:
        if _schedule(AUTO_SCHEDULING):
            return None
        return "no real-time priority (CAP_SYS_NICE): other programs may delay this node"
    if settings.scheduling != OFF and not _schedule(settings.scheduling):
        raise LaunchError(
            f"--realtime {settings.scheduling}: refused by the system: it needs CAP_SYS_NICE or "
            "'ulimit -r' of at least the priority; or use --realtime auto"
        )
    return None


def _schedule(scheduling: str) -> bool:
    """Whether the system grants it."""
    name, _, priority = scheduling.partition(":")
    try:
        policy = getattr(os, POLICIES[name]) | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(int(priority)))
    except (AttributeError, OSError):  # the former on systems other than Linux
        return False
    return True


def _pin(cpus: tuple[int, ...]) -> None:
    wanted = ",".join(map(str, cpus))
    before = os.sched_getaffinity(0)
    with suppress(OSError, OverflowError):  # none of them exists; a number beyond all
        os.sched_setaffinity(0, cpus)
    if os.sched_getaffinity(0) != set(cpus):  # Linux leaves out the ones it does not have
        os.sched_setaffinity(0, before)
        allowed = ",".join(map(str, sorted(before)))
        raise LaunchError(f"--cpus {wanted}: refused by the system: allowed are {allowed}")


def _lock_memory() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        reason = os.strerror(ctypes.get_errno())
        raise LaunchError(
            f"--lock-memory: refused by the system ({reason}): it needs CAP_IPC_LOCK or "
            "'ulimit -l unlimited'"
        )
