"""Seeds over the workers of a Dask cluster that is there already."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any, Self, TypeVar

from distributed import Client, KilledWorker

from campaign.code import code_sha256
from campaign.workers import WorkersError

AnswerT = TypeVar("AnswerT")

CONNECT_S = 10.0
DEATHS_MAX = 2
"""The scheduler itself has tried a task on several workers before it tells of their deaths."""


class DaskPool:
    """Implements `Pool` with `distributed`; workers that come or go meanwhile do so freely.

    Every worker must have this very code installed: a task checks.

    Args:
        address: `HOST:PORT` of the scheduler.
    """

    death = (KilledWorker,)
    deaths_max = DEATHS_MAX

    def __init__(self, address: str) -> None:
        self._address = address
        self._client: Any = None
        self._executor: Any = None

    @property
    def count(self) -> int:
        """Threads of all workers that are there now."""
        return sum(self._client.nthreads().values())

    def __enter__(self) -> Self:
        """Connects.

        Raises:
            WorkersError: Nobody answers, or the cluster has no workers.
        """
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # errors say it already
        where = f"--workers dask://{self._address}"
        try:
            self._client = _connect(self._address)
        except (OSError, ValueError) as error:
            raise WorkersError(f"{where}: no Dask scheduler answers: {_reason(error)}") from error
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError as error:
            self._client.close()
            raise WorkersError(f"{where}: the cluster has no workers") from error
        self._executor = self._client.get_executor(pure=False)
        return self

    def __exit__(self, *exception: object) -> None:
        """Takes back what is in flight and disconnects; the cluster stays."""
        self._executor.shutdown(wait=False)
        self._client.close()

    def submit(self, task: Callable[[int], AnswerT], seed: int) -> Future[AnswerT]:
        """As `Pool`."""
        checked = partial(_checked, task, code_sha256())
        future: Future[AnswerT] = self._executor.submit(checked, seed)
        return future

    def renew(self) -> None:
        """As `Pool`: nothing to do, the cluster renews itself."""


def _connect(address: str) -> Any:
    make: Any = Client  # not typed
    return make(address, timeout=CONNECT_S, set_as_default=False)


def _reason(error: Exception) -> str:
    return str(error) or type(error).__name__


def _checked(task: Callable[[int], AnswerT], expected_sha256: str, seed: int) -> AnswerT:
    """On a worker: the task, if its answer will be that of the same code."""
    if code_sha256() != expected_sha256:
        raise WorkersError("a worker of the cluster has other code than this machine")
    return task(seed)
