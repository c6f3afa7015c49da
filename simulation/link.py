"""The gateway's link into the simulation: a planner waits, and virtual time goes on."""

from __future__ import annotations

from collections.abc import Generator
from types import coroutine

from gateway.core import GatewayCore, PlannerInputs
from gateway.state import CarState
from simulation.world import World
from vehicles import Vehicle


@coroutine
def _turn() -> Generator[None, None, None]:
    """Hands control to the event loop once, whichever it is."""
    yield


class SimulationLink:
    """Implements `gateway.link.Link`: waiting steps the kernel, nothing else passes time."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._station = world.stations["Gateway"]

    @property
    def _core(self) -> GatewayCore:
        core = self._station.node
        assert isinstance(core, GatewayCore)
        return core

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle the gateway works for."""
        return self._world.vehicle

    @property
    def planner_period_ns(self) -> int:
        """What the planner promises."""
        return self._core.planner_period_ns

    def open(self) -> None:
        """Nothing to do: the world is there."""

    def close(self) -> None:
        """Nothing to do: the world stays."""

    def now_ns(self) -> int:
        """The gateway's own time."""
        return self._station.clock.local_ns(self._world.now_ns)

    def submit(self, inputs: PlannerInputs) -> None:
        """Hands a wish to the gateway, which steps at once."""
        self._world.submit(inputs)

    def state(self) -> CarState:
        """What the gateway knows now."""
        return self._core.state(self.now_ns())

    def wait_until(self, time_ns: int) -> None:
        """Runs the world until the gateway's clock shows this time."""
        self._world.run_until(self._station.clock.true_ns(time_ns))

    async def wait_async(self, time_ns: int) -> None:
        """The same for asynchronous planners; other tasks of the event loop get their turn."""
        await _turn()
        self.wait_until(time_ns)
