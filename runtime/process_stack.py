"""One process per node, started, watched and stopped in the right order."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from signal import Signals
from typing import Self

from canbus.node import Event, EventKind
from runtime.clock import NS_PER_S, Clock, monotonic_ns
from runtime.errors import LaunchError
from runtime.nodes import NODES, PLANT, STOP_ORDER, node_entry
from runtime.realtime import RealtimeSettings
from runtime.service_notify import ServiceNotify, SignsOfLife
from runtime.standstill import StandstillWait
from runtime.state_file import (
    PROC,
    ProcessRecord,
    StackState,
    boot_id,
    channel_lock,
    read_state,
    record_of,
    remove_state,
    write_state,
)
from runtime.stopping import LAUNCHER_PID_VARIABLE, StopRequest

LAUNCHER = "Launcher"
WATCH_S = 0.05
"""How often the launcher looks for children that have died."""

HANG_NS = NS_PER_S
"""A child whose loop has done no cycle for this long hangs; its next one is 99 too late."""

STANDSTILL_S_MAX = 5.0
"""Longest wait for the car to stand before its nodes are ended (a full stop takes less)."""

TERMINATE_S_MAX = 2.0
"""Time for a child to end by itself, two hundred of its cycles."""

DBW = (sys.executable, "-m", "dbw")
"""The command line, by which every node is started."""

Report = Callable[[Event], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class StackSettings:
    """What to start; the options of `dbw up`.

    Attributes:
        interface: python-can's name, one that reaches other processes.
        channel: the vehicle bus.
        harness_channel: the bus that stands for the wires.
        vehicle: name of a shipped vehicle, or a path ending in .toml.
        with_plant: False on a real car, where hardware drivers are on the harness.
        nodes: which nodes to start.
        bitrate_bps: for interfaces that set it themselves; None: the vehicle file's.
        realtime: what every process asks of the system.
    """

    interface: str
    channel: str
    harness_channel: str
    vehicle: str
    with_plant: bool = True
    nodes: tuple[str, ...] = tuple(NODES)
    bitrate_bps: int | None = None
    realtime: RealtimeSettings = field(default_factory=RealtimeSettings)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Child:
    """A child process."""

    record: ProcessRecord
    process: subprocess.Popen[bytes]


class ProcessStack:
    """A stack of processes; started and stopped by `with`, watched by `supervise`.

    A child that dies or hangs is reported by name; the others keep running, because it is they who
    bring the car to a stand. From then on the service manager's watchdog hears nothing more: in its
    time it ends the stack, in order, and starts a new one. Children are in sessions of their own,
    so that Ctrl-C reaches the launcher alone and it can end them in order; if the launcher is
    killed they end themselves.

    Args:
        settings: what to start.
        report: gets what happens.
        clock: for events and time limits.
        command: how the command line is started.
        standstill: waits for the car to stand while the stack goes down; answers whether it does.
        service: the launcher's service manager.
    """

    def __init__(
        self,
        settings: StackSettings,
        *,
        report: Report,
        clock: Clock = monotonic_ns,
        command: Sequence[str] = DBW,
        standstill: Callable[[Callable[[], bool]], bool] | None = None,
        service: ServiceNotify | None = None,
    ) -> None:
        for name in settings.nodes:
            node_entry(name)
        self._settings = settings
        self._report = report
        self._clock = clock
        self._command = tuple(command)
        self._standstill = standstill or StandstillWait(
            interface=settings.interface,
            channel=settings.channel,
            clock=clock,
            limit_ns=round(STANDSTILL_S_MAX * NS_PER_S),
        )
        self._service = service or ServiceNotify(os.environ)
        self._signs = SignsOfLife(HANG_NS)
        self._children: dict[str, _Child] = {}
        self._ended: dict[str, int] = {}
        self._hanging: set[str] = set()
        self._pause = threading.Event()  # never set: only waited on
        self._lock = ExitStack()
        self._hurry: Callable[[], bool] = lambda: False

    def __enter__(self) -> Self:
        """Starts every process.

        Raises:
            LaunchError: a stack is up on this channel, a process cannot be started, or this
                interface does not reach other processes.
        """
        self._check()
        with ExitStack() as lock:
            lock.enter_context(channel_lock(self._settings.channel))
            self._check_leftovers()
            lock.enter_context(self._signs)
            try:
                for name in self._names():
                    self._start(name)
                    self._write_state()
            except BaseException:
                self._stop_children(wait_for_standstill=False)
                raise
            self._lock = lock.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stops every process, brakes first, and leaves nothing behind."""
        self._service.stopping()
        try:
            self._stop_children(wait_for_standstill=True)
        finally:
            self._lock.close()

    def supervise(self, stop: StopRequest) -> int:
        """Watches the children until told to stop, or until none is left.

        A second signal while the stack goes down cuts the wait for standstill short.

        Returns:
            Exit code for the launcher: 0 when told to stop with every child alive, else 1.
        """
        signals_seen = 1
        self._hurry = lambda: stop.count > signals_seen
        while not stop.is_set():
            self._watch()
            if len(self._ended) == len(self._children):
                self._say("no process is left")
                break
            if self._all_live():
                self._service.alive(self._clock())
            self._pause.wait(WATCH_S)
        self._watch()
        return 1 if self._ended else 0

    def run(self) -> int:
        """The main of `dbw up`: starts, supervises until SIGINT or SIGTERM, stops.

        Returns:
            The exit code.

        Raises:
            LaunchError: it cannot be started.
        """
        with StopRequest() as stop, self:
            return self.supervise(stop)

    @property
    def processes(self) -> tuple[ProcessRecord, ...]:
        """The children started, by now perhaps dead."""
        return tuple(child.record for child in self._children.values())

    def _names(self) -> list[str]:
        plant = [PLANT] if self._settings.with_plant else []
        return plant + [name for name in NODES if name in self._settings.nodes]

    def _check(self) -> None:
        settings = self._settings
        if settings.interface == "virtual":
            raise LaunchError(
                "interface 'virtual' stays within one process: allowed socketcan and other "
                "interfaces that several processes can open; or run all nodes in one process"
            )
        if settings.channel == settings.harness_channel:
            raise LaunchError(
                f"channel and harness channel are both '{settings.channel}': they share "
                "identifiers and must be two buses"
            )
        if not (PROC / "self/stat").exists():
            raise LaunchError("separate processes need Linux's /proc to be watched safely")

    def _check_leftovers(self) -> None:
        """The launcher of an old state file is dead, for we hold its lock; its children?"""
        state = read_state(self._settings.channel)
        if state is None:
            return
        left = [record.name for record in state.nodes if state.is_alive(record)]
        if left:
            names = ", ".join(left)
            raise LaunchError(
                f"processes of an earlier stack still run on channel '{state.channel}': {names}; "
                "stop them with 'dbw down' first"
            )
        remove_state(state.channel)

    def _start(self, name: str) -> None:
        settings = self._settings
        arguments = [*self._command, "ecu", name]
        arguments += ["--interface", settings.interface, "--channel", settings.channel]
        arguments += ["--harness-channel", settings.harness_channel, "--vehicle", settings.vehicle]
        if settings.bitrate_bps is not None:
            arguments += ["--bitrate", str(settings.bitrate_bps)]
        arguments += settings.realtime.options
        launcher = {LAUNCHER_PID_VARIABLE: str(os.getpid()), **self._signs.environment}
        environment = {**os.environ, **launcher}
        try:
            process = subprocess.Popen(
                arguments, stdin=subprocess.DEVNULL, env=environment, start_new_session=True
            )
        except OSError as error:
            raise LaunchError(f"cannot start {name}: {error}") from error
        record = record_of(name, process.pid)
        if record is None:  # gone already; not reaped yet, so the id is its own
            record = ProcessRecord(name=name, pid=process.pid, start_ticks=-1)
        self._children[name] = _Child(record=record, process=process)

    def _write_state(self) -> None:
        launcher = record_of("launcher", os.getpid())
        assert launcher is not None  # that is us
        settings = self._settings
        write_state(
            StackState(
                channel=settings.channel,
                interface=settings.interface,
                harness_channel=settings.harness_channel,
                vehicle=settings.vehicle,
                boot_id=boot_id(),
                launcher=launcher,
                nodes=self.processes,
            )
        )

    def _watch(self) -> None:
        """Reports children that have died or hang since the last look."""
        now_ns = self._clock()
        self._signs.listen(now_ns)
        for name, child in self._children.items():
            if name in self._ended:
                continue
            process = f"{name} (process {child.record.pid})"
            code = child.process.poll()
            if code is not None:
                self._ended[name] = code
                self._say(f"{process} died: {how_it_ended(code)}")
            elif self._signs.hangs(child.record.pid, now_ns) != (name in self._hanging):
                self._hanging ^= {name}
                hangs = f"hangs: no cycle for {HANG_NS / NS_PER_S:g} s"
                self._say(f"{process} {hangs if name in self._hanging else 'runs again'}")

    def _all_live(self) -> bool:
        """Whether every child runs and does its cycles."""
        return (
            not self._ended
            and not self._hanging
            and all(self._signs.was_heard(child.record.pid) for child in self._children.values())
        )

    def _stop_children(self, *, wait_for_standstill: bool) -> None:
        running = [name for name in STOP_ORDER if name in self._children]
        try:
            if wait_for_standstill and not self._standstill(self._hurry):
                self._say("cannot tell that the car stands; the actuators' watchdogs take over")
            for name in running:
                self._stop(name)
        finally:  # an exception above, a further Ctrl-C: still no orphan
            for child in self._children.values():
                if child.process.poll() is None:
                    child.process.kill()
                child.process.wait()
            remove_state(self._settings.channel)

    def _stop(self, name: str) -> None:
        process = self._children[name].process
        if process.poll() is not None:
            return
        process.terminate()
        try:
            process.wait(TERMINATE_S_MAX)
        except subprocess.TimeoutExpired:
            self._say(f"{name} (process {process.pid}) did not end in time: killed")
            process.kill()
            process.wait()

    def _say(self, text: str) -> None:
        self._service.status(text)
        self._report(Event(time_ns=self._clock(), node=LAUNCHER, kind=EventKind.STATE, text=text))


def how_it_ended(code: int) -> str:
    """An exit code of `subprocess` in words."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"
