"""Real-time scheduling for the threads that have deadlines."""

from __future__ import annotations

import os

REALTIME_PRIORITY = 10
"""Above every ordinary thread, below the kernel's own (threaded interrupts have 50)."""


def prefer_realtime() -> bool:
    """Asks the system to run the calling thread before all ordinary ones (SCHED_RR, sched(7)).

    The nodes need a few percent of a processor, but within milliseconds; under ordinary
    scheduling any program that computes on the same machine makes them late. Needs
    CAP_SYS_NICE or a limit for `ulimit -r`. What the thread starts does not inherit it.

    Returns:
        False when the system does not grant it: the node then runs as any other program.
    """
    try:
        policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(REALTIME_PRIORITY))
    except (AttributeError, OSError):
        return False
    return True
