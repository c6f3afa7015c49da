"""One node in wall time: waits for frames, steps at absolute deadlines, sends and acts.

The same loop runs as a thread (all nodes in one process on python-can's `virtual` bus) and as the
main of a process (SocketCAN). It neither polls nor catches up.
"""

from __future__ import annotations

import os
import threading
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from canbus.bus import Bus, BusStatistics, error_classes_text
from canbus.frame import ReceivedFrame
from canbus.node import EARS_NS, PERIOD_NS, Event, EventKind, Node
from runtime.clock import NS_PER_MS, NS_PER_S, Clock, monotonic_ns
from runtime.harness import ActuatorPort, HarnessPort
from runtime.nodes import build_node, build_wires, node_entry
from runtime.pacing import Pacer
from runtime.process_settings import ProcessSettings
from runtime.realtime import apply_realtime, keep_collections_short
from runtime.service_notify import ServiceNotify
from runtime.stopping import StopRequest

LISTEN_S = 2 * PERIOD_NS / NS_PER_S
"""A node hears its sensors, which tell a reading each cycle, before its first step."""

REPORT_INTERVAL_NS = NS_PER_S
"""Overruns and refused frames are all counted, but told at most once in this time."""

LOSSES = {
    "tx_failures": "frames not sent so far: the bus refused them",
    "rx_lost": "frames lost in the kernel's receive queue so far",
    "rx_dropped": "overflows of the controller's receive buffer so far",
    "rx_failures": "reads failed so far: the interface is or was down",
    "error_frames": "error frames of the controller so far",
}
"""Counters of the bus that mean that something is wrong with it, and how they are told."""

Report = Callable[[Event], None]
"""Where events go. Called from the node's own thread."""

AnyNode = Node[Any, Any]
AnyPort = ActuatorPort[Any, Any]


class StopFlag(Protocol):
    """`threading.Event`, or anything that can say whether it is time to end."""

    def is_set(self) -> bool:
        """Whether to end."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeResult:
    """How a node's run ended.

    Attributes:
        node: its DBC name.
        failure: why it ended by itself, in one line; None when it was told to end.
        steps: cycles done.
        overruns: cycles that were not over when the next one was due.
        skipped: cycles left out.
        lag_ns_max: how late the latest of all cycles began.
        tx_failures: frames the driver refused.
    """

    node: str
    failure: str | None
    steps: int
    overruns: int
    skipped: int
    lag_ns_max: int
    tx_failures: int

    @property
    def exit_code(self) -> int:
        """0 when the node was told to end, 1 when it failed."""
        return 0 if self.failure is None else 1


def one_line(error: BaseException) -> str:
    """An exception as one line, with the place it came from."""
    text = " ".join(str(error).split())
    place = traceback.extract_tb(error.__traceback__)[-1:]
    where = "".join(f" ({Path(frame.filename).name}:{frame.lineno})" for frame in place)
    return f"{type(error).__name__}: {text}{where}" if text else f"{type(error).__name__}{where}"


class _Watch:
    """Tells about overruns and lost frames, without flooding the log."""

    def __init__(self, node: str, report: Report) -> None:
        self._node = node
        self._report = report
        self._told_ns: int | None = None
        self._told_late = 0
        self._told_lost = dict.fromkeys(LOSSES, 0)

    def check(self, now_ns: int, pacer: Pacer, statistics: BusStatistics) -> None:
        """Reports what has come up since the last report, if it is time to."""
        late = pacer.overruns + pacer.skipped
        lost = {name: getattr(statistics, name) for name in LOSSES}
        if late == self._told_late and lost == self._told_lost:
            return
        if self._told_ns is not None and now_ns - self._told_ns < REPORT_INTERVAL_NS:
            return
        if late > self._told_late:
            text = (
                f"{pacer.overruns} overruns and {pacer.skipped} skipped cycles so far, "
                f"latest by {pacer.lag_ns / NS_PER_MS:.1f} ms, "
                f"at worst {pacer.lag_ns_max / NS_PER_MS:.1f} ms"
            )
            self._tell(now_ns, EventKind.OVERRUN, text)
        for name, words in LOSSES.items():
            if lost[name] > self._told_lost[name]:
                is_error = name == "error_frames"
                what = f": {error_classes_text(statistics.error_classes)}" if is_error else ""
                self._tell(now_ns, EventKind.FRAME, f"{lost[name]} {words}{what}")
        self._told_late, self._told_lost, self._told_ns = late, lost, now_ns

    def _tell(self, now_ns: int, kind: EventKind, text: str) -> None:
        self._report(Event(time_ns=now_ns, node=self._node, kind=kind, text=text))


class NodeLoop:
    """The state of one run."""

    def __init__(
        self,
        node: AnyNode,
        bus: Bus,
        port: AnyPort,
        clock: Clock,
        report: Report,
        pacer: Pacer,
        alive: Callable[[int], None] = lambda now_ns: None,
    ) -> None:
        self.node = node
        self.bus = bus
        self.port = port
        self.clock = clock
        self.report = report
        self.pacer = pacer
        self.alive = alive
        self._received: list[ReceivedFrame] = []
        self._watch = _Watch(node.name, report)

    def run(self, stop: StopFlag) -> None:
        """Cycles until told to stop; an exception from node or port ends it."""
        while not stop.is_set():
            # a late cycle, which waits for nothing, still sees all there is
            self._received += self.bus.gather(self.pacer.wait_ns(self.clock()))
            self.port.poll()
            now_ns = self.clock()
            if stop.is_set() or self.pacer.wait_ns(now_ns) > 0:
                continue
            received, self._received = self._received, []
            if self.pacer.cycles == 0:
                received = [item for item in received if item.arrival_ns >= now_ns - EARS_NS]
            self.cycle(received, stop)

    def cycle(self, received: Sequence[ReceivedFrame], stop: StopFlag) -> None:
        """One step of the node, and what comes of it; it must be due."""
        now_ns = self.clock()
        self.pacer.begin(now_ns)
        output = self.node.step(now_ns, received, self.port.sensors(now_ns))
        if stop.is_set():
            return  # told to end while it was at work: nothing leaves late
        if output.actuator is not None:  # else its watchdog decides
            self.port.actuate(now_ns, output.actuator)
        for frame in output.frames:
            self.bus.send(frame)
        for event in output.events:
            self.report(event)
        end_ns = self.clock()
        self.pacer.end(end_ns)
        self._watch.check(end_ns, self.pacer, self.bus.statistics)
        self.alive(end_ns)


def run_node(
    node: AnyNode,
    bus: Bus,
    port: AnyPort,
    clock: Clock,
    stop: StopFlag,
    report: Report,
    *,
    phase_ns: int = 0,
    alive: Callable[[int], None] = lambda now_ns: None,
) -> NodeResult:
    """Runs a node until `stop` is set or it fails; its hardware's watchdogs do the rest.

    Args:
        node: the node; stepped every 10 ms with all frames since the last step.
        bus: the vehicle bus, open.
        port: the node's hardware, open.
        clock: the bus's clock.
        stop: looked at before and after every wait, so it acts within a cycle.
        report: gets the node's events, and the runtime's own about it.
        phase_ns: where the node's deadlines lie within the period.
        alive: called with the time at the end of every cycle, for watchdogs.

    Returns:
        How it ended. An exception from node or port is reported by name and is in `failure`; it
        is not raised, so that it ends this node alone.
    """
    pacer = Pacer(start_ns=clock(), period_ns=PERIOD_NS, phase_ns=phase_ns)
    loop = NodeLoop(node, bus, port, clock, report, pacer, alive)
    failure = None
    try:
        loop.run(stop)
    except Exception as error:  # whatever it is: this node ends, the others go on
        failure = one_line(error)
        text = f"{node.name} ends: {failure}"
        report(Event(time_ns=clock(), node=node.name, kind=EventKind.STATE, text=text))
    return NodeResult(
        node=node.name,
        failure=failure,
        steps=pacer.cycles,
        overruns=pacer.overruns,
        skipped=pacer.skipped,
        lag_ns_max=pacer.lag_ns_max,
        tx_failures=bus.statistics.tx_failures,
    )


def run_node_process(settings: ProcessSettings, report: Report) -> NodeResult:
    """The main of `dbw ecu NAME`: opens both buses and runs one node until SIGTERM or SIGINT.

    Raises:
        LaunchError: the name or the vehicle is unknown, or the system refuses what was asked of it
            by name.
        BusError: a bus cannot be opened.
    """
    entry = node_entry(settings.name)
    vehicle = settings.load_vehicle()
    node = build_node(settings.name, vehicle)
    wires = build_wires(settings.name)
    bus = settings.vehicle_bus(vehicle, node.acceptance)
    harness = settings.harness_bus(vehicle, wires.acceptance)
    keep_collections_short()  # at the priority it would hold up the nodes that run already
    complaint = apply_realtime(settings.realtime)
    if complaint is not None:
        now_ns = monotonic_ns()
        report(Event(time_ns=now_ns, node=node.name, kind=EventKind.STATE, text=complaint))
    service = ServiceNotify(os.environ)
    with StopRequest() as stop, bus, harness:
        keep_collections_short()  # once more, of what opening the buses has loaded
        threading.Event().wait(LISTEN_S)
        result = run_node(
            node,
            bus,
            HarnessPort(wires, harness),
            monotonic_ns,
            stop,
            report,
            phase_ns=entry.phase_ns,
            alive=service.alive,
        )
        service.stopping()
        return result
