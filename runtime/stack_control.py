"""Finding and stopping a stack from another process, through its state file."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from runtime.clock import NS_PER_S, Clock, monotonic_ns
from runtime.errors import LaunchError
from runtime.nodes import STOP_ORDER
from runtime.process_stack import STANDSTILL_S_MAX, TERMINATE_S_MAX
from runtime.state_file import ProcessRecord, StackState, read_state, remove_state

STOP_S_MAX = STANDSTILL_S_MAX + len(STOP_ORDER) * TERMINATE_S_MAX + 3.0
"""A launcher that follows its own limits is done by then."""

LOOK_S = 0.02

_pause = threading.Event()  # never set: only waited on


@dataclass(frozen=True, slots=True, kw_only=True)
class StopResult:
    """What `stop` did.

    Attributes:
        channel: of the stack.
        stopped: names of what was running and ended when told to.
        killed: names of what had to be killed.
        was_stale: nothing was running any more; the state file alone was removed.
    """

    channel: str
    stopped: tuple[str, ...]
    killed: tuple[str, ...]
    was_stale: bool


def status(channel: str) -> StackState | None:
    """The stack on a channel; None when none is written down.

    `StackState.alive` says what of it runs; a state without any is stale.

    Raises:
        LaunchError: the state file is broken.
    """
    return read_state(channel)


def stop(channel: str, *, clock: Clock = monotonic_ns, limit_s: float = STOP_S_MAX) -> StopResult:
    """Stops the stack on a channel and waits until it is gone.

    The launcher is told and ends its children in order. If it is dead, or does not do so within
    `limit_s`, they are ended here, in the same order. Only processes whose start time fits the
    recorded one are signalled.

    Raises:
        LaunchError: no stack is written down for this channel, or its file is broken.
    """
    state = read_state(channel)
    if state is None:
        raise LaunchError(f"no stack is up on channel '{channel}'")
    running = state.alive
    killed: tuple[str, ...] = ()
    if state.launcher in running:
        _signal(state, state.launcher, signal.SIGTERM)
        _wait(state, (state.launcher,), clock, limit_s)
    for record in _in_order(state):
        if not state.is_alive(record):
            continue
        _signal(state, record, signal.SIGTERM)
        if not _wait(state, (record,), clock, TERMINATE_S_MAX):
            _signal(state, record, signal.SIGKILL)
            _wait(state, (record,), clock, TERMINATE_S_MAX)
            killed += (record.name,)
    if state.is_alive(state.launcher):
        _signal(state, state.launcher, signal.SIGKILL)
        _wait(state, (state.launcher,), clock, TERMINATE_S_MAX)
        killed += (state.launcher.name,)
    if state.alive:
        names = ", ".join(f"{record.name} (process {record.pid})" for record in state.alive)
        raise LaunchError(f"could not stop {names}")
    remove_state(channel)
    return StopResult(
        channel=channel,
        stopped=tuple(record.name for record in running if record.name not in killed),
        killed=killed,
        was_stale=not running,
    )


def _in_order(state: StackState) -> list[ProcessRecord]:
    rank = {name: place for place, name in enumerate(STOP_ORDER)}
    return sorted(state.nodes, key=lambda record: rank.get(record.name, -1))


def _signal(state: StackState, record: ProcessRecord, number: signal.Signals) -> None:
    """Signals a process of ours; one that is gone, or another's by now, is left alone.

    Raises:
        LaunchError: the process is ours to stop by its record, but not by the system's rules.
    """
    if not state.is_alive(record):
        return
    try:
        descriptor = os.pidfd_open(record.pid)
    except ProcessLookupError:
        return
    try:
        # The descriptor holds on to one process: looked at again, it cannot be a later one.
        if state.is_alive(record):
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(descriptor, number)
    except PermissionError as error:
        raise LaunchError(
            f"not allowed to stop {record.name} (process {record.pid}): it is another user's"
        ) from error
    finally:
        os.close(descriptor)


def _wait(
    state: StackState, records: Iterable[ProcessRecord], clock: Clock, limit_s: float
) -> bool:
    """Waits until the processes are gone; False when the time is over first."""
    deadline_ns = clock() + round(limit_s * NS_PER_S)
    while any(state.is_alive(record) for record in records):
        if clock() >= deadline_ns:
            return False
        _pause.wait(LOOK_S)
    return True
