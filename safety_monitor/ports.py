"""What is wired to the safety monitor."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorSensors:
    """The monitor reads the emergency-stop line itself; all else it hears on the bus."""

    emergency_stop_pressed: bool
