"""Programs that people use on a CAN bus, and the network's own."""

from __future__ import annotations

import subprocess
import time


def run(command: str) -> str:
    """A command that must succeed; answers what it says."""
    result = subprocess.run(command.split(), capture_output=True, text=True, check=False)
    assert result.returncode == 0, f"{command}: {result.stderr}"
    return result.stdout


def cansend(text: str, channel: str = "vcan0") -> float:
    """One frame, as a user would send it; answers the time before."""
    now_s = time.time()
    run(f"cansend {channel} {text}")
    return now_s
