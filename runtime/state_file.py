"""What is up on which channel: one JSON file per stack, so that other processes can find it.

A process is known by its id *and* its start time (/proc/PID/stat, field 22, proc(5)) within this
boot. Ids are used again; only a process that is proven to be the recorded one is ever signalled.
"""

from __future__ import annotations

import fcntl
import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote, unquote

from runtime.errors import LaunchError

PROC = Path("/proc")
_START_TIME_FIELD = 22
_STATE_FIELD = 3
_FIRST_FIELD_AFTER_NAME = 3
_DEAD_STATES = frozenset("ZXx")
"""Zombie and dead (proc(5)): the id is still taken, the process is not there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessRecord:
    """A process we started, or the launcher itself.

    Attributes:
        name: of the node, or "launcher".
        pid: its id.
        start_ticks: when it started, in clock ticks since boot.
    """

    name: str
    pid: int
    start_ticks: int

    @property
    def is_alive(self) -> bool:
        """Whether this very process still runs."""
        return start_ticks(self.pid) == self.start_ticks


@dataclass(frozen=True, slots=True, kw_only=True)
class StackState:
    """One stack, as its launcher wrote it down.

    Attributes:
        channel: the vehicle bus.
        interface: of the vehicle bus.
        harness_channel: the bus that stands for the wires.
        vehicle: name or path of the vehicle file.
        boot_id: of the boot in which it was started.
        launcher: the process that supervises.
        nodes: the nodes' processes, the plant among them.
    """

    channel: str
    interface: str
    harness_channel: str
    vehicle: str
    boot_id: str
    launcher: ProcessRecord
    nodes: tuple[ProcessRecord, ...]

    @property
    def is_of_this_boot(self) -> bool:
        """Whether the recorded ids can still mean anything."""
        return self.boot_id == boot_id()

    def is_alive(self, record: ProcessRecord) -> bool:
        """Whether a recorded process still runs."""
        return self.is_of_this_boot and record.is_alive

    @property
    def alive(self) -> tuple[ProcessRecord, ...]:
        """Launcher and nodes that still run."""
        return tuple(record for record in (self.launcher, *self.nodes) if self.is_alive(record))


def start_ticks(pid: int) -> int | None:
    """When a process started, in clock ticks since boot; None when it is gone or a zombie."""
    try:
        text = (PROC / str(pid) / "stat").read_text(encoding="utf-8", errors="replace")
    except (FileNotFoundError, ProcessLookupError):
        return None
    # The name in brackets may hold spaces and brackets itself: count from behind it.
    fields = text.rpartition(")")[2].split()
    if fields[_STATE_FIELD - _FIRST_FIELD_AFTER_NAME] in _DEAD_STATES:
        return None
    return int(fields[_START_TIME_FIELD - _FIRST_FIELD_AFTER_NAME])


def boot_id() -> str:
    """Identity of this boot of the machine."""
    return (PROC / "sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()


def record_of(name: str, pid: int) -> ProcessRecord | None:
    """The record of a running process; None when it is gone already."""
    ticks = start_ticks(pid)
    return None if ticks is None else ProcessRecord(name=name, pid=pid, start_ticks=ticks)


def state_folder() -> Path:
    """Where the state files lie; made if it is missing.

    Raises:
        LaunchError: it cannot be made, or belongs to someone else, who could then name processes
            for us to stop.
    """
    base = Path(os.environ.get("XDG_RUNTIME_DIR") or "/tmp")
    folder = base / "can-by-wire"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        is_ours = folder.stat().st_uid == os.geteuid()
    except OSError as error:
        raise LaunchError(f"cannot use {folder}: {error.strerror}; set XDG_RUNTIME_DIR") from error
    if not is_ours:
        raise LaunchError(f"{folder} belongs to another user; set XDG_RUNTIME_DIR to your own")
    return folder


def _path(channel: str, suffix: str) -> Path:
    return state_folder() / f"{quote(channel, safe='')}{suffix}"


def known_channels() -> list[str]:
    """Channels with a state file, stale ones included."""
    return sorted(unquote(path.stem) for path in state_folder().glob("*.json"))


def write_state(state: StackState) -> None:
    """Writes a stack's file in one go: a reader sees the old or the new, never half of one."""
    path = _path(state.channel, ".json")
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", dir=path.parent, prefix=path.stem, suffix=".tmp", delete=False
    ) as file:
        json.dump(asdict(state), file, indent=1)
    os.replace(file.name, path)


def read_state(channel: str) -> StackState | None:
    """The stack written down for a channel; None when there is no file.

    Raises:
        LaunchError: the file cannot be read as one of ours.
    """
    path = _path(channel, ".json")
    try:
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        launcher = ProcessRecord(**document.pop("launcher"))
        nodes = tuple(ProcessRecord(**record) for record in document.pop("nodes"))
        return StackState(launcher=launcher, nodes=nodes, **document)
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise LaunchError(f"{path} is not a state file: remove it") from error


def remove_state(channel: str) -> None:
    """Removes a stack's file, if it is there."""
    with suppress(FileNotFoundError):
        _path(channel, ".json").unlink()


@contextmanager
def channel_lock(channel: str) -> Iterator[None]:
    """Makes sure that one launcher has the channel; the kernel frees it when that one dies.

    Raises:
        LaunchError: another launcher has it.
    """
    with _path(channel, ".lock").open("a") as file:
        _lock(file, channel)
        yield


def _lock(file: IO[str], channel: str) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        state = read_state(channel)
        who = "" if state is None else f" (launcher process {state.launcher.pid})"
        raise LaunchError(
            f"a stack is up on channel '{channel}'{who}: stop it with 'dbw down' first"
        ) from None
