"""Signs of life: they stop when the loop stops, whoever listens."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from runtime.node_process import run_node
from runtime.service_notify import ServiceNotify, SignsOfLife
from tests.runtime.fake_manager import Manager
from tests.runtime.runtime_fakes import MS, FakeBus, FakeClock, FakeNode, FakePort, StopAt

S = 1_000 * MS


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    with Manager(tmp_path / "user@home") as manager:
        yield manager


def test_the_first_cycle_means_ready_and_later_ones_ping_at_half_the_timeout(
    manager: Manager,
) -> None:
    service = ServiceNotify(manager.environment)
    assert manager.heard() == []
    for cycle in range(201):
        service.alive(cycle * 10 * MS)
    assert manager.heard() == ["READY=1\nWATCHDOG=1", *["WATCHDOG=1"] * 4]


def test_without_a_watchdog_ready_is_all_that_is_said(manager: Manager) -> None:
    del manager.environment["WATCHDOG_USEC"]
    service = ServiceNotify(manager.environment)
    for cycle in range(1_000):
        service.alive(cycle * 10 * MS)
    assert manager.heard() == ["READY=1\nWATCHDOG=1"]


def test_a_watchdog_meant_for_another_process_is_not_ours(manager: Manager) -> None:
    manager.environment["WATCHDOG_PID"] = str(os.getpid() + 1)
    service = ServiceNotify(manager.environment)
    service.alive(0)
    service.alive(10 * S)
    assert len(manager.heard()) == 1


def test_status_and_stopping_are_told_in_one_line_each(manager: Manager) -> None:
    service = ServiceNotify(manager.environment)
    service.status("steering died:\nexit code 3")
    service.stopping()
    assert manager.heard() == ["STATUS=steering died: exit code 3", "STOPPING=1"]


@pytest.mark.parametrize("address", [None, "", "/no/such/socket"])
def test_without_a_manager_nothing_is_said_and_nothing_fails(address: str | None) -> None:
    environment = {} if address is None else {"NOTIFY_SOCKET": address}
    service = ServiceNotify(environment)
    service.alive(0)
    service.stopping()


def test_a_manager_that_does_not_read_never_holds_up_the_loop(manager: Manager) -> None:
    service = ServiceNotify(manager.environment)
    for cycle in range(10_000):
        service.alive(cycle * S)
    assert 0 < len(manager.heard()) < 10_000


def test_a_nodes_pings_come_from_its_loop_and_stop_when_a_step_hangs(manager: Manager) -> None:
    class Hangs(Exception):
        """A step that never returns, as far as the loop can tell."""

    clock = FakeClock()
    heard_at_hang: list[str] = []

    def work(now_ns: int) -> None:
        if now_ns >= 3 * S:
            heard_at_hang.extend(manager.heard())
            clock.now_ns += 60 * S
            raise Hangs

    service = ServiceNotify(manager.environment)
    run_node(
        FakeNode(work),
        FakeBus(clock),
        FakePort(),
        clock,
        StopAt(clock, 100 * S),
        lambda event: None,
        alive=service.alive,
    )
    assert heard_at_hang == ["READY=1\nWATCHDOG=1", *["WATCHDOG=1"] * 5]
    assert manager.heard() == []


def test_the_launcher_knows_a_child_that_pings_and_one_that_hangs() -> None:
    own_pid = os.getpid()
    with SignsOfLife(1 * S) as signs:
        child = ServiceNotify(signs.environment)
        signs.listen(0)
        assert not signs.was_heard(own_pid) and not signs.hangs(own_pid, 100 * S)
        child.alive(0)
        signs.listen(10 * MS)
        assert signs.was_heard(own_pid) and not signs.hangs(own_pid, 1 * S)
        signs.listen(2 * S)
        assert signs.hangs(own_pid, 2 * S)
        child.alive(2 * S)
        signs.listen(2 * S)
        assert not signs.hangs(own_pid, 2 * S)


def test_what_is_no_ping_is_no_sign_of_life() -> None:
    with SignsOfLife(1 * S) as signs:
        child = ServiceNotify(signs.environment)
        child.status("busy")
        child.stopping()
        signs.listen(0)
        assert not signs.was_heard(os.getpid())


def test_one_child_cannot_ping_for_another() -> None:
    code = "import os; from runtime.service_notify import *; ServiceNotify(os.environ).alive(0)"
    with SignsOfLife(1 * S) as signs:
        with subprocess.Popen(
            [sys.executable, "-c", code], env={**os.environ, **signs.environment}
        ) as other:
            assert other.wait() == 0
        signs.listen(0)
        assert signs.was_heard(other.pid) and not signs.was_heard(os.getpid())


def test_children_ping_the_launcher_and_not_the_launchers_own_manager(manager: Manager) -> None:
    manager.environment["WATCHDOG_PID"] = str(os.getppid())
    with SignsOfLife(1 * S) as signs:
        child = ServiceNotify({**manager.environment, **signs.environment})
        child.alive(0)
        signs.listen(0)
        child.alive(1 * S)
        signs.listen(1 * S)
        assert not signs.hangs(os.getpid(), 2 * S)
    assert manager.heard() == []
