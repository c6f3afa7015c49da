"""What is wired to the safety monitor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class MonitorSensors:
    """The monitor reads the emergency-stop line itself; all else it hears on the bus."""

    emergency_stop_pressed: Final[bool]

    def __init__(self, *, emergency_stop_pressed: bool) -> None:
        self.emergency_stop_pressed = emergency_stop_pressed
