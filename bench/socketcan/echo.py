"""How soon a frame is answered on the wire: our runtime against the smallest python-can loop.

Each subject runs in a process of its own. A request is sent, and both its and the answer's time are
the kernel's stamps on one raw socket, so that nothing of the observer is in the span between them.
"""

from __future__ import annotations

import signal
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import can
import numpy as np

from bench.socketcan.drive import CHANNEL, forked, process_settings
from canbus.frame import Frame, ReceivedFrame
from canbus.node import NODE_IDS, PERIOD_NS, Event, StepOutput
from canbus.python_can_bus import PythonCanBus
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns
from runtime.node_process import NodeLoop, run_node, run_node_process
from runtime.nodes import NODES
from runtime.pacing import Pacer
from runtime.realtime import RealtimeSettings, apply_realtime
from runtime.stopping import StopRequest

REQUEST_ID, ANSWER_ID = 0x5A0, 0x5A1
REQUEST = Frame(REQUEST_ID, bytes(8))
ROUNDS, QUICK_ROUNDS = 1000, 20
WARM_UP_ROUNDS = 20
ANSWER_NS_MAX = 2 * PERIOD_NS
START_NS_MAX = 60 * NS_PER_S
SDO_UPLOAD_DEVICE_TYPE = bytes.fromhex("4000100000000000")
"""CiA 301: initiate upload of object 0x1000, subindex 0."""

_FRAME = struct.Struct("=IB3x8s")
_STAMP = struct.Struct("@qq")
_SO_TIMESTAMPNS = 35


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoResult:
    """One subject's answers.

    Attributes:
        name: of the subject.
        spans_ns: from the request to the answer, without the wait for the next cycle.
    """

    name: str
    spans_ns: tuple[int, ...]

    def percentile_us(self, percent: float) -> float:
        """Of all answers; 50 is the median."""
        return float(np.percentile(self.spans_ns, percent)) / 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """Who answers.

    Attributes:
        name: for the table.
        run: answers until SIGTERM.
        request, answer_id: what is sent to it, and where it answers.
        phase_ns: where its cycle lies; None when it answers at once.
    """

    name: str
    run: Callable[[], None]
    request: Frame = REQUEST
    answer_id: int = ANSWER_ID
    phase_ns: int | None = None


class EchoNode:
    """The smallest node: answers each request at its next step."""

    name = "Echo"
    acceptance: frozenset[int] | None = frozenset({REQUEST_ID})

    def step(
        self, now_ns: int, received: Sequence[ReceivedFrame], sensors: None
    ) -> StepOutput[None]:
        """One answer per request."""
        frames = [Frame(ANSWER_ID, item.frame.data) for item in received]
        return StepOutput(frames=frames, actuator=None, events=())


class NoHardware:
    """A port to nothing."""

    def poll(self) -> None:
        """Nothing arrives."""

    def sensors(self, now_ns: int) -> None:
        """There are none."""

    def actuate(self, now_ns: int, actuator: None) -> None:
        """There are none."""


def _bus(acceptance: frozenset[int] | None) -> PythonCanBus:
    return PythonCanBus(
        "socketcan", CHANNEL, clock=monotonic_ns, realtime=realtime_ns, acceptance=acceptance
    )


def _python_can_loop() -> None:
    filters: Any = [{"can_id": REQUEST_ID, "can_mask": 0x7FF}]
    with can.Bus(interface="socketcan", channel=CHANNEL, can_filters=filters) as bus:
        while True:
            message = bus.recv()
            assert message is not None
            bus.send(
                can.Message(arbitration_id=ANSWER_ID, data=message.data, is_extended_id=False)
            )


def _adapter_loop() -> None:
    with _bus(EchoNode.acceptance) as bus:
        while True:
            for item in bus.receive(NS_PER_S):
                bus.send(Frame(ANSWER_ID, item.frame.data))


def _event_driven_node() -> None:
    """What our runtime does from a frame to the answer, without the wait for a cycle."""
    pacer = Pacer(start_ns=monotonic_ns(), period_ns=1, gap_ns_min=0)  # due whenever it is asked
    with StopRequest() as stop, _bus(EchoNode.acceptance) as bus:
        loop = NodeLoop(EchoNode(), bus, NoHardware(), monotonic_ns, _no_report, pacer)
        while not stop.is_set():
            received = bus.receive(NS_PER_S)
            if received:
                loop.cycle(received, stop)


def _cyclic_node() -> None:
    with StopRequest() as stop, _bus(EchoNode.acceptance) as bus:
        run_node(EchoNode(), bus, NoHardware(), monotonic_ns, stop, _no_report)


def _real_node(name: str) -> Callable[[], None]:
    def run() -> None:
        run_node_process(process_settings(name), _no_report)

    return run


def _no_report(event: Event) -> None:
    pass


ECHOES = (
    Subject(name="python-can: recv, send", run=_python_can_loop),
    Subject(name="our bus: receive, send", run=_adapter_loop),
    Subject(name="our runtime: frame, step, answer", run=_event_driven_node),
    Subject(name="the same node in its 10 ms cycle", run=_cyclic_node, phase_ns=0),
)
"""The reference first, then what the goal is about."""


def node_subject(name: str) -> Subject:
    """A node of the stack, asked for its device type."""
    entry = NODES[name]
    node_id = NODE_IDS[entry.node]
    return Subject(
        name=f"{name}: SDO upload", run=_real_node(name), phase_ns=entry.phase_ns,
        request=Frame(0x600 + node_id, SDO_UPLOAD_DEVICE_TYPE), answer_id=0x580 + node_id,
    )


def measure_echo(*, quick: bool = False) -> tuple[EchoResult, ...]:
    """Needs vcan0 and vcan1."""
    rounds = QUICK_ROUNDS if quick else ROUNDS
    subjects = [*ECHOES, *(node_subject(name) for name in NODES)]
    return tuple(measure_subject(subject, rounds) for subject in subjects)


def measure_subject(subject: Subject, rounds: int) -> EchoResult:
    """Starts it, asks it, ends it."""
    generator = np.random.default_rng(0)
    with forked(_run, subject), Tester(subject) as tester:
        tester.wait_for_the_first_answer()
        for _ in range(WARM_UP_ROUNDS):
            tester.ask(0)
        spans_ns = tuple(
            tester.ask(int(generator.integers(PERIOD_NS))) for _ in range(rounds)
        )
    return EchoResult(name=subject.name, spans_ns=spans_ns)


def _run(subject: Subject) -> None:
    """In the child: as a process of the stack, at a real-time priority where that is granted."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    apply_realtime(RealtimeSettings())
    subject.run()


class Tester:
    """Asks one subject, and reads the kernel's stamps."""

    def __init__(self, subject: Subject) -> None:
        self._subject = subject
        self._request = _FRAME.pack(
            subject.request.can_id, len(subject.request.data), subject.request.data
        )

    def __enter__(self) -> Tester:
        """Opens its socket, which hears what it sends itself."""
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        ids = (self._subject.request.can_id, self._subject.answer_id)
        filters = b"".join(struct.pack("=II", can_id, socket.CAN_SFF_MASK) for can_id in ids)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._socket.bind((CHANNEL,))
        self._socket.setblocking(False)
        return self

    def __exit__(self, *exception: object) -> None:
        """Closes it."""
        self._socket.close()

    def wait_for_the_first_answer(self) -> None:
        """Until the subject is there."""
        deadline_ns = monotonic_ns() + START_NS_MAX
        while True:
            assert monotonic_ns() < deadline_ns, f"{self._subject.name} does not answer"
            self._socket.send(self._request)
            _pause(ANSWER_NS_MAX)
            if any(can_id == self._subject.answer_id for can_id, _ in self._waiting()):
                break
        _pause(ANSWER_NS_MAX)
        list(self._waiting())

    def ask(self, after_ns: int) -> int:
        """One question, asked after a pause; answers how long its answer took.

        The wait for the next cycle is left out, unless that cycle came too late to be waited for.
        """
        _pause(after_ns)
        offset_ns = realtime_ns() - monotonic_ns()
        self._socket.send(self._request)
        _pause(ANSWER_NS_MAX)
        stamps_ns = dict(self._waiting())
        asked_ns = stamps_ns[self._subject.request.can_id]
        span_ns = stamps_ns[self._subject.answer_id] - asked_ns
        if self._subject.phase_ns is None:
            return span_ns
        wait_ns = (self._subject.phase_ns - (asked_ns - offset_ns)) % PERIOD_NS
        return span_ns - wait_ns if span_ns >= wait_ns else span_ns

    def _waiting(self) -> Iterator[tuple[int, int]]:
        """Identifiers and stamps of all frames that have arrived."""
        while True:
            try:
                frame, ancillary, _, _ = self._socket.recvmsg(16, 64)
            except BlockingIOError:
                return
            seconds, nanoseconds = _STAMP.unpack(ancillary[0][2])
            yield _FRAME.unpack(frame)[0], seconds * NS_PER_S + nanoseconds


def _pause(span_ns: int) -> None:
    """The wall clock is the subject here."""
    threading.Event().wait(span_ns / NS_PER_S)
