"""Seeds over the processes of this machine or of a Dask cluster; a worker's death loses nothing."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    wait,
)
from multiprocessing.connection import Connection
from typing import Generic, Protocol, Self, TypeVar

AnswerT = TypeVar("AnswerT")

AHEAD = 2
"""Seeds in flight for each worker: none waits for the next one, and no more are held."""
DEATHS_MAX = 3
"""A seed whose worker died so often is given up."""
PROCESSES_MAX = 1024
AUTO = "auto"
DASK = "dask://"


class WorkersError(Exception):
    """There are no such workers, or they cannot run a seed; one line."""


class Pool(Protocol):
    """Where tasks run, for as long as `with` lasts."""

    @property
    def death(self) -> tuple[type[BaseException], ...]:
        """What a task's future raises when its worker died."""

    @property
    def deaths_max(self) -> int:
        """A seed whose worker died so often is given up."""

    @property
    def count(self) -> int:
        """Tasks that run at the same time."""

    def __enter__(self) -> Self:
        """Starts, or connects to, the workers."""

    def __exit__(self, *exception: object) -> None:
        """Ends what was started; tasks in flight are abandoned."""

    def submit(self, task: Callable[[int], AnswerT], seed: int) -> Future[AnswerT]:
        """Hands a task over."""

    def renew(self) -> None:
        """After a death: once more able to take tasks. Those of the old pool are all over then."""


class LocalPool:
    """Implements `Pool` with processes of this machine, started afresh and by need.

    Args:
        processes: How many.
    """

    death = (BrokenExecutor, CancelledError)
    deaths_max = DEATHS_MAX

    def __init__(self, processes: int) -> None:
        self.count = processes
        self._executor: ProcessPoolExecutor | None = None
        self._leash: Connection | None = None
        self._hold: Connection | None = None

    def __enter__(self) -> Self:
        """Makes the pool; a process starts with its first task."""
        # A fork would carry whatever threads and memory this process has.
        context = multiprocessing.get_context("spawn")
        self._leash, self._hold = context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(
            self.count, mp_context=context, initializer=_begin_worker, initargs=(self._leash,)
        )
        return self

    def __exit__(self, *exception: object) -> None:
        """Lets go of the leash, so that all processes end at once, and waits for them."""
        assert self._executor and self._leash and self._hold
        self._hold.close()
        self._executor.shutdown(cancel_futures=True)
        self._leash.close()

    def submit(self, task: Callable[[int], AnswerT], seed: int) -> Future[AnswerT]:
        """As `Pool`."""
        assert self._executor is not None, "only within `with`"
        return self._executor.submit(task, seed)

    def renew(self) -> None:
        """As `Pool`: one death spoils the whole pool of the library, which fails all its tasks."""
        self.__exit__()
        self.__enter__()


def _begin_worker(leash: Connection) -> None:
    """In a new process: Ctrl-C is the parent's affair, whose end is this process's own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(leash,), daemon=True).start()


def _end_with_parent(leash: Connection) -> None:
    try:
        leash.recv()
    except (EOFError, OSError):
        os._exit(1)


def open_pool(workers: str) -> Pool:
    """The pool of a `--workers`: `auto`, a number, or `dask://HOST:PORT`.

    Raises:
        WorkersError: It is none of these.
    """
    if workers.startswith(DASK):
        from campaign.cluster import DaskPool

        return DaskPool(workers.removeprefix(DASK))
    if workers == AUTO:
        return LocalPool(len(os.sched_getaffinity(0)))
    is_number = workers.isascii() and workers.isdecimal() and len(workers) < 5
    if not is_number or not 1 <= int(workers) <= PROCESSES_MAX:
        raise WorkersError(
            f"--workers {workers}: allowed {AUTO}, 1 to {PROCESSES_MAX}, and {DASK}HOST:PORT"
        )
    return LocalPool(int(workers))


def each_seed(
    pool: Pool,
    task: Callable[[int], AnswerT],
    seeds: Iterable[int],
    give_up: Callable[[int], AnswerT],
) -> Iterator[AnswerT]:
    """The task's answer for each seed, as they come; only a few seeds are in flight.

    When a worker dies, nobody knows which of the seeds in flight was to blame. They are tried
    again one at a time, so that only the one that kills its workers is given up.

    Args:
        pool: Within its `with`.
        task: Can be pickled, as can its answer; raises nothing that is the seed's own fault.
        seeds: Taken one by one as there is room.
        give_up: The answer for a seed that killed its workers too often.

    Raises:
        WorkersError: The workers are gone, or cannot run the task.
    """
    return _Flight(pool, task, give_up).answers(seeds)


class _Flight(Generic[AnswerT]):
    """The seeds that are on their way."""

    def __init__(
        self, pool: Pool, task: Callable[[int], AnswerT], give_up: Callable[[int], AnswerT]
    ) -> None:
        self._pool = pool
        self._task = task
        self._give_up = give_up
        self._flying: dict[Future[AnswerT], int] = {}
        self._suspects: deque[int] = deque()
        self._deaths: Counter[int] = Counter()
        self._has_died = False

    def answers(self, seeds: Iterable[int]) -> Iterator[AnswerT]:
        """See `each_seed`."""
        waiting = iter(seeds)
        while self._send(waiting):
            landed, _ = wait(self._flying, return_when=FIRST_COMPLETED)
            yield from self._land(landed)
            if self._has_died:
                self._pool.renew()
                yield from self._land([future for future in self._flying if future.done()])
                self._has_died = False

    def _send(self, waiting: Iterator[int]) -> bool:
        """Fills up what is in flight; answers whether anything is."""
        if self._suspects:
            if not self._flying:
                self._submit(self._suspects.popleft())
            return True
        while len(self._flying) < max(1, self._pool.count) * AHEAD:
            seed = next(waiting, None)
            if seed is None:
                break
            self._submit(seed)
        return bool(self._flying)

    def _submit(self, seed: int) -> None:
        try:
            future = self._pool.submit(self._task, seed)
        except self._pool.death as error:  # a worker died while there was nothing to do
            future = Future()
            future.set_exception(error)
        self._flying[future] = seed

    def _land(self, futures: Iterable[Future[AnswerT]]) -> Iterator[AnswerT]:
        """Answers, and what is to be done for those that have none."""
        for future in futures:
            seed = self._flying.pop(future)
            error = CancelledError() if future.cancelled() else future.exception()
            if error is None:
                yield future.result()
            elif not isinstance(error, self._pool.death):
                raise _failure(error)
            else:
                self._has_died = True
                self._deaths[seed] += 1
                if self._deaths[seed] < self._pool.deaths_max:
                    self._suspects.append(seed)
                else:
                    yield self._give_up(seed)


def _failure(error: BaseException) -> WorkersError:
    """What is no death and no seed's fault."""
    if isinstance(error, CancelledError):
        return WorkersError("the workers are gone: the same command goes on, with others")
    if isinstance(error, WorkersError):
        return error
    return WorkersError(f"the workers cannot run a seed: {error!r}")
