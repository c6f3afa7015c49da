"""Seeds over processes: none lost, none twice, and no process left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster

from campaign import cluster
from campaign.failure import EXCEPTION, WORKER_LIVES, worker_died
from campaign.result import SeedResult
from campaign.store import campaign_sha256
from campaign.workers import AHEAD, DEATHS_MAX, LocalPool, Pool, WorkersError, each_seed, open_pool
from runtime.clock import monotonic_ns
from tests.campaign import fakes

ROOT = Path(__file__).parents[2]
SEEDS = range(5, 30)
PARENT = """
import signal
import sys
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any
from campaign.workers import LocalPool, each_seed
from tests.campaign.fakes import pid_then_forever
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job inherits none
    with LocalPool(2) as pool:
        list(each_seed(pool, partial(pid_then_forever, Path(sys.argv[1])), range(9), abs))
"""


def run(pool: Pool, task: Callable[..., SeedResult]) -> list[SeedResult]:
    """All seeds, sorted."""
    with pool:
        answers = list(each_seed(pool, fakes.task_of(task), SEEDS, worker_died))
    return sorted(answers, key=lambda result: result.seed)


def test_each_seed_is_answered_once_by_any_number_of_workers() -> None:
    expected = [fakes.result_of(seed) for seed in SEEDS]
    assert run(LocalPool(1), fakes.run_seed) == expected
    assert run(LocalPool(3), fakes.run_seed) == expected


def test_a_killed_worker_loses_nothing(tmp_path: Path) -> None:
    answers = run(LocalPool(2), partial(fakes.run_killing, tmp_path, 1))
    assert len(list(tmp_path.iterdir())) == 2, "killed once, then done"
    assert answers == [fakes.result_of(seed) for seed in SEEDS]


def test_a_seed_that_kills_its_workers_is_given_up_and_no_other(tmp_path: Path) -> None:
    answers = run(LocalPool(2), partial(fakes.run_killing, tmp_path, 99))
    assert len(list(tmp_path.iterdir())) == DEATHS_MAX
    assert [result.seed for result in answers] == list(SEEDS)
    failed = [result for result in answers if result.violations]
    assert [result.seed for result in failed] == [fakes.KILLER]
    assert failed[0].violations[0].property == WORKER_LIVES


def test_an_exception_is_a_failure_of_its_seed_with_the_traceback() -> None:
    answers = run(LocalPool(2), fakes.run_raising)
    assert [result.seed for result in answers] == list(SEEDS)
    failed = [result for result in answers if result.violations]
    assert [result.seed for result in failed] == [fakes.RAISER]
    violation = failed[0].violations[0]
    assert violation.property == EXCEPTION
    assert "run_raising" in violation.text and "ZeroDivisionError: one over" in violation.text


def test_only_a_few_seeds_are_in_flight() -> None:
    taken: list[int] = []

    def endless() -> Iterator[int]:
        while True:
            taken.append(len(taken))
            yield taken[-1]

    with LocalPool(2) as pool:
        answers = each_seed(pool, fakes.task_of(fakes.run_seed), endless(), worker_died)
        for done in range(1, 50):
            next(answers)
            assert len(taken) - done < 2 * AHEAD
        answers.close()  # type: ignore[attr-defined]


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_parent(how: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    pids = tmp_path / "pids"
    pids.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, str(script), str(pids)], env=environment, stderr=subprocess.DEVNULL
    ) as parent:
        with killed_if_it_fails(parent):
            until(lambda: len(list(pids.iterdir())) == 2)
        parent.send_signal(how)
    assert parent.returncode != 0
    until(lambda: not any(is_running(int(path.name)) for path in pids.iterdir()))


def until(holds: Callable[[], bool]) -> None:
    """Waits for something that must come soon."""
    end_ns = monotonic_ns() + 120_000_000_000
    pause = threading.Event()
    while not holds():
        assert monotonic_ns() < end_ns, "it never came"
        pause.wait(0.01)


@contextmanager
def killed_if_it_fails(process: subprocess.Popen[Any]) -> Iterator[None]:
    """A test that fails waits for nobody who never ends."""
    try:
        yield
    except BaseException:
        process.kill()
        raise


@pytest.fixture
def dask_address() -> Iterator[str]:
    with LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        host="127.0.0.1",
        protocol="tcp",
        dashboard_address=None,
    ) as dask:
        yield dask.scheduler_address.removeprefix("tcp://")


def test_a_dask_cluster_gives_the_same_hash_as_local_workers(dask_address: str) -> None:
    ours = run(LocalPool(2), fakes.run_raising)
    theirs = run(open_pool(f"dask://{dask_address}"), fakes.run_raising)
    assert [result.trace_sha256 for result in ours] == [result.trace_sha256 for result in theirs]
    assert campaign_sha256(r.trace_sha256 for r in ours) == campaign_sha256(
        r.trace_sha256 for r in theirs
    )


def test_a_cluster_with_other_code_ends_the_campaign(
    dask_address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashes = iter(range(1000))
    monkeypatch.setattr(cluster, "code_sha256", lambda: str(next(hashes)))
    with pytest.raises(WorkersError, match=r"^a worker of the cluster has other code than this"):
        run(open_pool(f"dask://{dask_address}"), fakes.run_seed)


class GoneCluster(cluster.DaskPool):
    """As its client has it when the scheduler goes away: every task is taken back."""

    count = 2

    def submit(self, task: Callable[[int], object], seed: int) -> Future[Any]:
        """A future that is cancelled."""
        future: Future[Any] = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future


def test_a_cluster_that_goes_away_is_told_and_no_seed_is_blamed() -> None:
    answers = each_seed(GoneCluster("127.0.0.1:9"), abs, SEEDS, abs)
    with pytest.raises(WorkersError, match="the workers are gone: the same command goes on"):
        list(answers)


def test_a_cluster_that_does_not_answer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    with pytest.raises(WorkersError, match=r"dask://127.0.0.1:9: no Dask scheduler answers"):
        open_pool("dask://127.0.0.1:9").__enter__()
    with pytest.raises(WorkersError, match="dask://nobody: no Dask scheduler answers"):
        open_pool("dask://nobody").__enter__()


@pytest.mark.parametrize("workers", ["0", "-1", "many", "1025", "", "1.5", "tcp://1.2.3.4:5"])
def test_workers_that_cannot_be_are_refused(workers: str) -> None:
    with pytest.raises(WorkersError, match=r"allowed auto, 1 to 1024, and dask://HOST:PORT"):
        open_pool(workers)


def test_auto_is_a_process_for_each_core() -> None:
    assert open_pool("auto").count == len(os.sched_getaffinity(0))
    assert open_pool("7").count == 7
