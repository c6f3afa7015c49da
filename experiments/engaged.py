"""This stack in a car of its own, engaged, with a planner that an experiment writes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final

from dbc.messages import Mode, Request
from gateway.commands import Decision
from gateway.core import PlannerInputs
from simulation.link import SimulationLink
from simulation.plant.params import PlantParams
from simulation.plant.state import Truth
from simulation.world import World
from vehicles import Vehicle

TICK_NS: Final = 20_000_000
START_S: Final = 1.0
"""In which every node has started and the monitor has seen half a second of health."""
BUTTON_S: Final = 0.15
ENGAGE_S: Final = 0.1
SAMPLES_PER_TICK: Final = 2
SAMPLE_NS: Final = TICK_NS // SAMPLES_PER_TICK


class Engaged(ABC):
    """All nodes, the wire and the car, engaged at standstill.

    Args:
        vehicle: What the nodes believe.
        plant: What the car is.
        seed: Of everything left to chance.

    Attributes:
        world, link: The car and its nodes, and the gateway's end of them.
        is_silent: The planner decides nothing.
    """

    def __init__(self, vehicle: Vehicle, plant: PlantParams, seed: int) -> None:
        self.is_silent = False
        self.world = World(vehicle, seed, plant=plant, keep_frames=False)
        self.link = SimulationLink(self.world)
        driver = self.world.car.driver
        self.world.run_for(START_S)
        driver.button_pressed = True
        self.world.run_for(BUTTON_S)
        driver.button_pressed = False
        self.link.submit(PlannerInputs(request=Request.ENGAGE))
        self.run_for(ENGAGE_S)
        assert self.mode is Mode.AUTOMATIC, self.link.state().why_not_engaged

    @abstractmethod
    def decide(self) -> Decision:
        """The planner's decision, asked for once in each tick."""

    @abstractmethod
    def note(self, truth: Truth) -> None:
        """Takes a sample of the car, `SAMPLE_NS` after the last one."""

    @property
    def mode(self) -> Mode | None:
        """As the gateway hears it."""
        return self.link.state().mode

    @property
    def now_s(self) -> float:
        """True time."""
        return self.world.now_ns * 1e-9

    def run_for(self, span_s: float, then: Callable[[], None] | None = None) -> None:
        """Goes on in whole ticks of the planner; `then` is called after each."""
        for _ in range(round(span_s * 1e9) // TICK_NS):
            if not self.is_silent:
                decided_ns = self.link.now_ns()
                self.link.submit(PlannerInputs(decision=self.decide(), decided_ns=decided_ns))
            for _ in range(SAMPLES_PER_TICK):
                self.world.run_until(self.world.now_ns + SAMPLE_NS)
                self.note(self.world.car.truth)
            if then is not None:
                then()
