"""Other people's tools: candump, canplayer and cantools with our DBC."""

from __future__ import annotations

import subprocess
import sys
from importlib.resources import files
from pathlib import Path

from canbus.frame import Frame
from canbus.node import NODE_IDS
from canbus.python_can_bus import PythonCanBus
from dbc.codec import Decoded, decode
from dbc.messages import SPECS, Mode
from runtime.clock import monotonic_ns
from runtime.status import listen
from tests.vcan.stack import Stack, pause


def recorded(stack: Stack, path: Path) -> list[str]:
    """Two seconds of driving, as `candump -L` wrote them, the vehicle bus alone."""
    stack.drive()
    pause(1.0)
    lines = [line for line in stack.log_path.read_text().split("\n") if " vcan0 " in line][-700:]
    path.write_text("\n".join([*lines[:-1], ""]))
    return lines[:-1]


def test_a_recorded_drive_is_decoded_to_the_last_frame_and_replayed(
    parked: Stack, tmp_path: Path
) -> None:
    path = tmp_path / "drive.log"
    lines = recorded(parked, path)
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
    parked.__exit__(None, None, None)  # the bus is the player's now
    with PythonCanBus("socketcan", "vcan0", clock=monotonic_ns) as bus:
        player = subprocess.Popen(["canplayer", "-I", str(path), "vcan0=vcan0"])
        status = listen(bus, monotonic_ns)
        assert player.wait() == 0
    assert status.mode is Mode.AUTOMATIC
    assert {node.name for node in status.nodes if node.is_heard} == set(NODE_IDS)
    assert not status.bad_frames and not status.unknown_ids
