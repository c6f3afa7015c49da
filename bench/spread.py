"""Independent pieces of work over the cores; the order of the answers is that of the work."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

WorkT = TypeVar("WorkT")
AnswerT = TypeVar("AnswerT")


def spread(
    work: Callable[[WorkT], AnswerT], items: Iterable[WorkT], chunk: int = 1
) -> list[AnswerT]:
    """`work` of each item, in processes of their own as many as there are cores.

    A single item, or a single core, is worked on in this process.
    """
    listed = list(items)
    processes = min(len(os.sched_getaffinity(0)), len(listed))
    if processes <= 1:
        return [work(item) for item in listed]
    # Started afresh: a fork would carry whatever threads and memory this process has.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        try:
            return list(pool.map(work, listed, chunksize=chunk))
        except BaseException:  # an interrupt too: nobody waits for minutes of work left
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise
