"""`dbw monitor`: how soon it is there, and what its screen costs on a full bus.

Start-up is measured beside cantools' own monitor and the bare interpreter, in turns. The screen
hears a full bus from a socket of the kernel with the kernel's stamps, a UDP socket in place of a
CAN one: the code that reads it is the one for SocketCAN. A process of its own feeds it at a fixed
rate, and a pseudo-terminal takes what it draws. Beside cantools' monitor it hears, as that does, a
bus of python-can's, at a rate that both can follow.
"""

from __future__ import annotations

import fcntl
import json
import os
import pty
import resource
import socket
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from bench.table import Table, command_line, met

NAME = "monitor"
START_S_GOAL = 0.15
CPU_GOAL = 0.30
FRAMES_PER_S = 9_000
"""Of 8 bytes each: a full bus at 1 Mbit/s."""
START_RUNS, QUICK_START_RUNS = 21, 3
LIVE_S, QUICK_LIVE_S = 600, 3
WARM_UP_S = 2
PEER_FRAMES_PER_S = 1_000
PEER_S, QUICK_PEER_S = 20, 2
PEER_START_S = 4
MULTICAST = "239.74.163.9"
COLUMNS, LINES = 160, 50
LOG_LINE = "(1.000000) vcan0 182#B83800004000A0FF\n"
DBW = [sys.executable, "-m", "dbw", "monitor"]
DBC = Path(__file__).parents[1] / "dbc" / "vehicle.dbc"


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """From the start of a process to its end, median of the runs, s."""

    what: str
    wall_s: float
    cpu_s: float
    has_goal: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Live:
    """The screen on a full bus, after warming up.

    Attributes:
        seconds: How long.
        cpu: Share of one core.
        frames: Frames heard.
        lost: Frames lost in the kernel's queue.
        grown_kib: How much resident memory has grown between the first minute's end, or the first
            half of a shorter run, and the end.
        draws: Times that the screen was drawn.
    """

    seconds: float
    cpu: float
    frames: int
    lost: int
    grown_kib: int
    draws: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Peer:
    """A screen on a bus of python-can's: share of one core."""

    what: str
    cpu: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorResult:
    """What `measure` answers."""

    starts: Sequence[Start]
    live: Live
    peers: Sequence[Peer]
    quick: bool

    def tables(self) -> list[Table]:
        """For printing."""
        command = command_line(NAME, quick=self.quick)
        live = self.live
        return [
            Table(
                title="Start-up of `dbw monitor`",
                command=command,
                headers=("process", "wall, ms", "CPU, ms", "goal 150 ms of wall"),
                rows=[
                    (
                        start.what,
                        f"{1e3 * start.wall_s:.0f}",
                        f"{1e3 * start.cpu_s:.0f}",
                        met(start.wall_s <= START_S_GOAL) if start.has_goal else "",
                    )
                    for start in self.starts
                ],
            ),
            Table(
                title="`dbw monitor --live` on a full bus",
                command=command,
                headers=(
                    "duration, s", "frames/s", "lost", "draws/s", "share of a core",
                    "goal 30 %", "memory grown, KiB",
                ),
                rows=[
                    (
                        f"{live.seconds:.0f}",
                        f"{live.frames / live.seconds:.0f}",
                        str(live.lost),
                        f"{live.draws / live.seconds:.1f}",
                        f"{live.cpu:.1%}",
                        met(live.cpu <= CPU_GOAL),
                        str(live.grown_kib),
                    )
                ],
            ),
            Table(
                title=f"Two screens on one bus of python-can's, {PEER_FRAMES_PER_S} frames/s",
                command=command,
                headers=("screen", "share of a core"),
                rows=[(peer.what, f"{peer.cpu:.1%}") for peer in self.peers],
                notes=("Interface `udp_multicast`; most of it is python-can's receiving.",),
            ),
        ]  # fmt: skip


def measure(*, quick: bool = False) -> MonitorResult:
    """Measures start-up and screen."""
    return MonitorResult(
        starts=measure_start(QUICK_START_RUNS if quick else START_RUNS),
        live=measure_live(QUICK_LIVE_S if quick else LIVE_S),
        peers=measure_peers(QUICK_PEER_S if quick else PEER_S),
        quick=quick,
    )


def measure_start(runs: int) -> list[Start]:
    """Processes in turns, so that what else the machine does meets all alike."""
    with TemporaryDirectory() as folder:
        log = Path(folder) / "one.log"
        log.write_text(LOG_LINE, encoding="ascii")
        commands = {
            "python -c pass": [sys.executable, "-c", "pass"],
            "dbw monitor --help": [*DBW, "--help"],
            "dbw monitor, first decoded frame": [*DBW, "--log", str(log)],
            "the same with --dbc vehicle.dbc's copy": [
                *DBW, "--log", str(log), "--dbc", str(_copy_of_dbc(folder)),
            ],
            "python -m cantools monitor --help": [
                sys.executable, "-m", "cantools", "monitor", "--help",
            ],
        }  # fmt: skip
        found: dict[str, list[tuple[float, float]]] = {what: [] for what in commands}
        for _ in range(runs):
            for what, command in commands.items():
                found[what].append(_run(command))
    return [
        Start(
            what=what,
            wall_s=median(wall_s for wall_s, _ in times),
            cpu_s=median(cpu_s for _, cpu_s in times),
            has_goal=what.startswith("dbw"),
        )
        for what, times in found.items()
    ]


def _copy_of_dbc(folder: str) -> Path:
    """The vehicle bus's DBC with one more line, so that cantools is needed to read it."""
    path = Path(folder) / "copy.dbc"
    path.write_text(DBC.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    return path


def _run(command: Sequence[str]) -> tuple[float, float]:
    """Wall and CPU time of a process, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start_ns = time.perf_counter_ns()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    wall_s = (time.perf_counter_ns() - start_ns) * 1e-9
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall_s, used


def measure_live(duration_s: int) -> Live:
    """A feeder, the screen in a pseudo-terminal, and this process, which reads what is drawn."""
    with TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        port = free_port()
        screen, master = _in_terminal([
            sys.executable, "-m", "bench.monitor_live", str(port), str(duration_s), str(result),
        ])  # fmt: skip
        process = feeder(str(port), FRAMES_PER_S)
        try:
            _drain(master)
            if screen.wait() != 0:
                raise RuntimeError("the screen failed")
        finally:
            process.kill()
            process.wait()
            os.close(master)
        return Live(**json.loads(result.read_text(encoding="utf-8")))


def measure_peers(duration_s: int) -> list[Peer]:
    """cantools' monitor and ours beside each other, hearing the same frames."""
    bus = ["-i", "udp_multicast", "-c", MULTICAST]
    commands = {
        "python -m cantools monitor": [sys.executable, "-m", "cantools", "monitor", *bus, str(DBC)],
        "dbw monitor --live": [*DBW, "--live", "--interface", "udp_multicast", MULTICAST],
    }
    process = feeder(MULTICAST, PEER_FRAMES_PER_S)
    screens = [_in_terminal(command) for command in commands.values()]
    for _, master in screens:
        threading.Thread(target=_drain, args=(master,), daemon=True).start()
    try:
        _wait(PEER_START_S)
        start_s, before = time.monotonic(), [_cpu_s(screen.pid) for screen, _ in screens]
        _wait(duration_s)
        span_s = time.monotonic() - start_s
        used = [_cpu_s(screen.pid) - b for (screen, _), b in zip(screens, before, strict=True)]
    finally:
        process.kill()
        process.wait()
        for screen, _ in screens:
            screen.kill()
            screen.wait()
    return [Peer(what=what, cpu=cpu / span_s) for what, cpu in zip(commands, used, strict=True)]


def _in_terminal(command: Sequence[str]) -> tuple[subprocess.Popen[bytes], int]:
    """A process in a pseudo-terminal, and the other end of that."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", LINES, COLUMNS, 0, 0))
    environment = {**os.environ, "TERM": "xterm-256color"}
    process = subprocess.Popen(command, stdin=slave, stdout=slave, env=environment)
    os.close(slave)
    return process, master


def free_port() -> int:
    """A UDP port of this machine that nobody has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def feeder(where: str, frames_per_s: int) -> subprocess.Popen[bytes]:
    """Sends onto a port, or a bus of python-can's, until it is killed."""
    command = [sys.executable, "-m", "bench.monitor_feed", where, str(frames_per_s)]
    return subprocess.Popen(command)


def _drain(master: int) -> None:
    """Reads what is drawn until the other end is closed."""
    try:
        while os.read(master, 1 << 16):
            pass
    except OSError:
        return


def _wait(seconds: float) -> None:
    threading.Event().wait(seconds)


def _cpu_s(pid: int) -> float:
    """CPU time that a process has used, all its threads together, s."""
    text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii")
    user, system = text.rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
