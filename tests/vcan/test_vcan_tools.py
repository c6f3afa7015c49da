"""Other people's tools: candump, canplayer and cantools with our DBC."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections import Counter
from functools import partial
from importlib.resources import files
from pathlib import Path

import dbw.monitor_lines  # noqa: F401, before the forks
import telemetry.record.recorder  # noqa: F401
from canbus.frame import Frame
from canbus.node import NODE_IDS
from canbus.python_can_bus import PythonCanBus
from dbc.codec import Decoded, decode
from dbc.messages import SPECS, Mode
from runtime.clock import monotonic_ns
from runtime.nodes import NODES, build_node, build_wires
from runtime.status import listen
from telemetry.logs.reading import Log
from telemetry.replay.comparison import DIFFERENCES, Match
from telemetry.replay.source import record_of
from telemetry.replay.through_node import replay_node
from tests.vcan import LOAD_S_MAX
from tests.vcan.bus_log import HARNESS_BUS
from tests.vcan.forked import ForkedDbw
from tests.vcan.stack import VEHICLE, VEHICLE_BUS, Stack, pause
from vehicles import load_vehicle

RECEIVERS = Path("/proc/net/can/rcvlist_all")
"""Who hears every frame, by interface."""


def recorded(stack: Stack, path: Path) -> list[str]:
    """Two seconds of driving, as `candump -L` wrote them, the vehicle bus alone."""
    stack.drive()
    pause(1.0)
    lines = [line for line in stack.log_path.read_text().split("\n") if " vcan0 " in line][-700:]
    path.write_text("\n".join([*lines[:-1], ""]))
    return lines[:-1]


def monitored(path: Path, count: int) -> list[str]:
    """What `dbw monitor` shows of a log that `canplayer` plays."""
    with ForkedDbw(["monitor", "vcan0", "-n", str(count)]) as monitor:
        play_to_a_listener(path)
        return monitor.communicate(timeout=LOAD_S_MAX).splitlines()


def play_to_a_listener(path: Path) -> None:
    """Plays a log once somebody hears vcan0; nobody else is on the bus."""
    while not re.search(r"^\s*vcan0\s", RECEIVERS.read_text(), re.M):
        pause(0.05)
    subprocess.run(["canplayer", "-I", str(path), "vcan0=vcan0"], check=True)


def recorded_by_dbw(path: Path, out: Path) -> list[tuple[int, bytes]]:
    """What `dbw record` keeps of a log that `canplayer` plays, until Ctrl-C."""
    with ForkedDbw(["record", "vcan0", "--out", str(out)]) as recorder:
        play_to_a_listener(path)
        pause(0.5)
        recorder.send_signal(signal.SIGINT)
        assert recorder.wait(timeout=LOAD_S_MAX) == 0
    return [(frame.can_id, frame.data) for frame in Log(out).frames()]


def test_a_recorded_drive_is_decoded_to_the_last_frame_and_replayed(
    parked: Stack, tmp_path: Path
) -> None:
    path = tmp_path / "drive.log"
    lines = recorded(parked, path)
    parked.__exit__(None, None, None)  # the bus is the player's now
    for line in lines:
        can_id, _, data = line.split()[2].partition("#")
        frame = Frame(int(can_id, 16), bytes.fromhex(data))
        assert frame.can_id in SPECS
        assert isinstance(decode(frame), Decoded), line
    dbc = str(files("dbc").joinpath("vehicle.dbc"))
    decoded = subprocess.run(
        [sys.executable, "-m", "cantools", "decode", "--single-line", dbc],
        input=path.read_text(), capture_output=True, text=True, check=True,
    ).stdout.splitlines()
    assert len(decoded) == len(lines)
    unknown = [line for line in decoded if "Unknown" in line or "rror:" in line or "::" not in line]
    assert not unknown, unknown[:3]
    assert any("SUPERVISOR_STATE" in line and "AUTOMATIC" in line for line in decoded)
    with PythonCanBus("socketcan", "vcan0", clock=monotonic_ns) as bus:
        player = subprocess.Popen(["canplayer", "-I", str(path), "vcan0=vcan0"])
        status = listen(bus, monotonic_ns)
        assert player.wait() == 0
    assert status.mode is Mode.AUTOMATIC
    assert {node.name for node in status.nodes if node.is_heard} == set(NODE_IDS)
    assert not status.bad_frames and not status.unknown_ids
    frames = [(frame.can_id, frame.data) for frame in Log(path).frames()]
    assert recorded_by_dbw(path, tmp_path / "again.log") == frames
    assert recorded_by_dbw(path, tmp_path / "again.mcap") == frames
    shown = monitored(path, len(lines))
    told = [line.split()[1] for line in shown]
    assert told == [line.split()[2].partition("#")[0] for line in lines]
    protected = [line for line in shown if "_STATUS (" in line]
    assert len(protected) > 100
    assert all(" ok)" in line or " first)" in line for line in protected)
    assert any("SUPERVISOR_STATE" in line and "mode=AUTOMATIC" in line for line in shown)


def test_on_their_recorded_inputs_the_nodes_do_what_they_did(tmp_path: Path) -> None:
    with Stack(tmp_path) as stack:
        stack.recover()
        stack.drive()
        stack.kill("throttle")
        stack.brakes()
    record = record_of(Log(stack.log_path).frames(), VEHICLE_BUS, HARNESS_BUS)
    vehicle = load_vehicle(VEHICLE)
    for name in ("supervisor", "steering"):
        outcome = replay_node(
            NODES[name].node, record, partial(build_node, name, vehicle), partial(build_wires, name)
        )
        both = (outcome.vehicle_bus, outcome.harness)
        counts = sum((count for one in both for count in one.counts.values()), Counter())
        assert counts.total() > 500
        # a frame that comes as the node begins its cycle may count for this one or the next; which
        # sender's do is the chance of two phases
        assert counts[Match.EQUAL] > 0.5 * counts.total()
        different = [one for comparison in both for one in comparison.differences]
        assert sum(counts[match] for match in DIFFERENCES) < 0.005 * counts.total(), different[:9]
