"""The whole stack as processes on vcan, as `dbw up` has them, and a planner that drives.

They are forks of this one, which has imported everything: under emulation imports take long.
"""

from __future__ import annotations

import multiprocessing
import re
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, Self

from bench.socketcan.planner import ENGAGE, LOOK, RESET, View, plan
from canbus.node import Event
from canbus.python_can_bus import PythonCanBus
from dbc.messages import Mode
from gateway.sentences import ONLY_THE_BUTTON
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns
from runtime.harness import HANDS_OFF, harness_frame
from runtime.node_process import run_node_process
from runtime.nodes import NODES, PLANT
from runtime.plant_process import run_plant_process
from runtime.process_settings import ProcessSettings

CHANNEL, HARNESS_CHANNEL = "vcan0", "vcan1"
VEHICLE = "tabby_evo"
PLANNER = "planner and gateway"
START_S_MAX = 60.0
ANSWER_S_MAX = 20.0
BUTTON_S = 0.15
SETTLE_S = 3.0
"""From standstill to its speed."""

_STORY = re.compile(r"^\w+: (mode|state|code|verdict|nmt): ")


def process_settings(name: str) -> ProcessSettings:
    """Of a node, or of the car."""
    return ProcessSettings(
        name=name, vehicle=VEHICLE, interface="socketcan", channel=CHANNEL,
        harness_channel=HARNESS_CHANNEL,
    )


def pause(span_s: float) -> None:
    """The wall clock is the subject here."""
    threading.Event().wait(span_s)


@contextmanager
def forked(main: Callable[..., object], *arguments: Any) -> Iterator[int]:
    """A process of its own that is ended by SIGTERM; gives its id."""
    process = multiprocessing.get_context("fork").Process(target=main, args=arguments)
    process.start()
    assert process.pid is not None
    try:
        yield process.pid
    finally:
        process.terminate()
        process.join(5.0)
        process.kill()
        process.join()


class Drive:
    """The stack and the planner, within `with`.

    Args:
        logged: candump's filter of what goes into `bus_log`.

    Attributes:
        pids: the processes' ids by name.
        bus_log: what candump writes.
    """

    def __init__(self, logged: str = CHANNEL) -> None:
        self._logged = logged
        self._ends = ExitStack()
        self.pids: dict[str, int] = {}

    def __enter__(self) -> Self:
        """Starts everything, and waits until the car stands ready in MANUAL."""
        for entry in NODES.values():
            import_module(entry.module)
        with ExitStack() as ends:
            folder = Path(ends.enter_context(tempfile.TemporaryDirectory()))
            self.bus_log, self._node_log = folder / "bus.log", folder / "nodes.log"
            ends.callback(self._start_candump().terminate)
            for name in (PLANT, *NODES):
                self.pids[name] = ends.enter_context(forked(self._run, name))
            self._planner, theirs = multiprocessing.Pipe()
            self.pids[PLANNER] = ends.enter_context(forked(plan, CHANNEL, theirs))
            self._wait(self._is_ready, START_S_MAX)
            self._ends = ends.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        """Ends everything, the planner first."""
        self._ends.close()

    def _start_candump(self) -> subprocess.Popen[bytes]:
        with self.bus_log.open("wb") as sink:
            return subprocess.Popen(
                ["stdbuf", "-oL", "candump", "-L", "-r", "4000000", self._logged], stdout=sink
            )

    def _run(self, name: str) -> None:
        """A node's process, or the car's."""
        run = run_plant_process if name == PLANT else run_node_process
        with self._node_log.open("a", encoding="utf-8", buffering=1) as log:
            run(process_settings(name), lambda event: print(_line(event), file=log))

    def _is_ready(self) -> bool:
        view = self.ask(LOOK)
        if view.mode is Mode.EMERGENCY:  # nodes that start late miss each other
            view = self.ask(RESET)
        return view.why_not_engaged == ONLY_THE_BUTTON

    def _wait(self, condition: Callable[[], bool], limit_s: float) -> None:
        deadline_ns = monotonic_ns() + round(limit_s * NS_PER_S)
        while not condition():
            assert monotonic_ns() < deadline_ns, f"{self.ask(LOOK)}\n{self.said[-3000:]}"
            pause(0.1)

    def ask(self, wish: str = LOOK) -> View:
        """Tells the planner something; how things are then."""
        self._planner.send(wish)
        assert self._planner.poll(ANSWER_S_MAX), "the planner does not answer"
        view: View = self._planner.recv()
        return view

    @property
    def said(self) -> str:
        """What the nodes have reported."""
        return self._node_log.read_text()

    @property
    def story(self) -> str:
        """Modes, states and codes, of all that was reported."""
        return "\n".join(line for line in self.said.splitlines() if _STORY.search(line))

    def engage(self) -> None:
        """From MANUAL to AUTOMATIC and up to speed; the planner drives on from here."""
        with PythonCanBus(
            "socketcan", HARNESS_CHANNEL, clock=monotonic_ns, realtime=realtime_ns
        ) as harness:
            for is_pressed in (True, False):
                hands = replace(HANDS_OFF, button_pressed=is_pressed)
                harness.send(harness_frame("DRIVER_HANDS", hands))
                pause(BUTTON_S)
        self._wait(lambda: self.ask().mode is Mode.READY, 2.0)
        view = self.ask(ENGAGE)
        assert view.mode is Mode.AUTOMATIC, f"{view}\n{self.story}"
        pause(SETTLE_S)


def _line(event: Event) -> str:
    """As `dbw ecu` writes it, with the time behind it."""
    return f"{event.node}: {event.kind}: {event.text} [{event.time_ns / NS_PER_S:.3f} s]"
