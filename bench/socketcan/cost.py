"""What each process of the stack costs: processor time at rest and driving, and memory."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from bench.socketcan.drive import CHANNEL, HARNESS_CHANNEL, Drive, pause
from bench.socketcan.echo import Tester, node_subject
from bench.socketcan.proc import cpu_ns, resident_mib
from bench.socketcan.traffic import statistic
from canbus.node import PERIOD_NS
from runtime.clock import NS_PER_S, monotonic_ns
from runtime.nodes import NODES

SPAN_S, QUICK_SPAN_S = 20.0, 1.0
LISTENER = "python-can: recv alone"
LISTENER_PROGRAM = f"""
import can
with can.Bus(interface="socketcan", channel="{CHANNEL}") as bus:
    print("ready", flush=True)
    while True:
        bus.recv()
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """One process.

    Attributes:
        name: of the process.
        rest_ratio, drive_ratio: processor time per time, in MANUAL and in AUTOMATIC.
        resident_mib: memory, as a process started by itself; None where that was not looked at.
    """

    name: str
    rest_ratio: float
    drive_ratio: float
    resident_mib: float | None

    @staticmethod
    def per_cycle_us(ratio: float) -> float:
        """Processor time of one 10 ms cycle."""
        return ratio * PERIOD_NS / 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class CostResult:
    """All of them.

    Attributes:
        span_s: how long each state was watched.
        frames_per_s: on the vehicle bus while driving.
        costs: the car, the nodes, the planner and the listener.
    """

    span_s: float
    frames_per_s: float
    costs: tuple[Cost, ...]


def measure_cost(*, quick: bool = False) -> CostResult:
    """Needs vcan0 and vcan1."""
    span_s = QUICK_SPAN_S if quick else SPAN_S
    with _listener() as listener, Drive() as drive:
        pids = {**drive.pids, LISTENER: listener.pid}
        rest, _ = _watch(pids, span_s)
        drive.engage()
        driving, frames_per_s = _watch(pids, span_s)
        memory_mib = {LISTENER: resident_mib(listener.pid)}
    memory_mib |= _node_memory_mib()
    costs = tuple(
        Cost(
            name=name, rest_ratio=rest[name], drive_ratio=driving[name],
            resident_mib=memory_mib.get(name),
        )
        for name in pids
    )
    return CostResult(span_s=span_s, frames_per_s=frames_per_s, costs=costs)


def _watch(pids: Mapping[str, int], span_s: float) -> tuple[dict[str, float], float]:
    """Each process's share of a processor in a while, and the frames per second on the bus."""
    begin_ns, frames = monotonic_ns(), statistic(CHANNEL, "tx_packets")
    before_ns = {name: cpu_ns(pid) for name, pid in pids.items()}
    pause(span_s)
    span_ns = monotonic_ns() - begin_ns
    ratios = {name: (cpu_ns(pid) - before_ns[name]) / span_ns for name, pid in pids.items()}
    return ratios, (statistic(CHANNEL, "tx_packets") - frames) * NS_PER_S / span_ns


@contextmanager
def _listener() -> Iterator[subprocess.Popen[bytes]]:
    """The smallest python-can loop, in a Python of its own."""
    with subprocess.Popen([sys.executable, "-c", LISTENER_PROGRAM], stdout=subprocess.PIPE) as own:
        try:
            assert own.stdout is not None and own.stdout.readline() == b"ready\n"
            yield own
        finally:
            own.terminate()


def _node_memory_mib() -> dict[str, float]:
    """Memory of each node, started as a user starts it: a fork shares what it never touches."""
    command = [sys.executable, "-m", "dbw", "ecu", "--interface", "socketcan",
               "--channel", CHANNEL, "--harness-channel", HARNESS_CHANNEL]
    memory_mib = {}
    for name in NODES:
        with subprocess.Popen([*command, name], stderr=subprocess.DEVNULL) as process:
            try:
                with Tester(node_subject(name)) as tester:
                    tester.wait_for_the_first_answer()
                memory_mib[name] = resident_mib(process.pid)
            finally:
                process.terminate()
    return memory_mib
