"""Where a drive takes place: what it needs beside the planner's public API."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from gateway.api import Car
from planner.gnss import GnssFix
from planner.pose import Pose
from telemetry.bus_log import BusLog
from telemetry.recording import DriveRecorder


class DriveFailed(RuntimeError):
    """The drive could not begin, or the stack broke; one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TruePose:
    """The car as it is, in the road's coordinates."""

    time_ns: int
    """On the gateway's clock, as everything a planner sees."""
    pose: Pose
    speed_mps: float


class Stage(Protocol):
    """A running stack with a car; entered by `with`."""

    car: Car
    """Open while the stage is."""
    recorder: DriveRecorder
    log: BusLog

    def press_button(self) -> None:
        """The person in the car presses Auto/Manual and lets go."""
        ...

    def observe(self) -> Iterable[GnssFix]:
        """Called at every tick: notes the truth; answers the fixes that have arrived since."""
        ...

    def check(self) -> None:
        """Raises DriveFailed when something that should run does not."""
        ...
