"""What a planner's `Car` needs from below: a bus in wall time, or a simulation in its own time."""

from __future__ import annotations

from typing import Protocol

from gateway.core import PlannerInputs
from gateway.state import CarState
from vehicles.vehicle import Vehicle


class Link(Protocol):
    """A running gateway. Opened once, closed once; closing twice is harmless."""

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle at the other end, as the gateway believes it to be."""
        ...

    @property
    def planner_period_ns(self) -> int:
        """The period the planner has promised."""
        ...

    def open(self) -> None:
        """Begins. Raises what the transport raises when it cannot."""
        ...

    def close(self) -> None:
        """Ends; the commands stop, and what was waited for ends at once."""
        ...

    def now_ns(self) -> int:
        """Time on the gateway's own clock; never goes back."""
        ...

    def submit(self, inputs: PlannerInputs) -> None:
        """Hands a decision or a request to the gateway, which acts on it at once.

        Raises:
            LinkFailed: The gateway has ended by an error.
        """
        ...

    def state(self) -> CarState:
        """The car as known now.

        Raises:
            LinkFailed: The gateway has ended by an error.
        """
        ...

    def wait_until(self, time_ns: int) -> None:
        """Blocks until `time_ns`, or until the link ends. A simulation steps its kernel here."""
        ...

    async def wait_async(self, time_ns: int) -> None:
        """The same without blocking the event loop."""
        ...
