"""This stack in a car of its own, with a planner that asks for one speed and one angle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dbc.messages import Mode, Request
from experiments.uah.paper_board import Run, Sample, sample
from gateway.commands import Decision
from gateway.core import PlannerInputs
from gateway.kinematics import Kinematics
from simulation.link import SimulationLink
from simulation.plant.params import PlantParams
from simulation.world import World
from vehicles import Vehicle

TICK_NS: Final = 20_000_000
START_S: Final = 1.0
"""In which every node has started and the monitor has seen half a second of health."""
BUTTON_S: Final = 0.15
ENGAGE_S: Final = 0.1
SAMPLES_PER_TICK: Final = 2


class Stack:
    """All nodes, the wire and the car, engaged at standstill.

    Args:
        vehicle: What the nodes believe.
        plant: What the car is.
        seed: Of everything left to chance.

    Attributes:
        speed_mps: What the planner asks for.
        wheel_rad: The steering wheel's angle that it asks for, as a curvature.
        is_silent: The planner decides nothing.
    """

    def __init__(self, vehicle: Vehicle, plant: PlantParams, seed: int) -> None:
        self.speed_mps = 0.0
        self.wheel_rad = 0.0
        self.is_silent = False
        self.world = World(vehicle, seed, plant=plant, keep_frames=False)
        self.link = SimulationLink(self.world)
        self._kinematics = Kinematics.of(vehicle.geometry, vehicle.steering)
        self._samples: list[Sample] = []
        driver = self.world.car.driver
        self.world.run_for(START_S)
        driver.button_pressed = True
        self.world.run_for(BUTTON_S)
        driver.button_pressed = False
        self.link.submit(PlannerInputs(request=Request.ENGAGE))
        self.run_for(ENGAGE_S)
        assert self.mode is Mode.AUTOMATIC, self.link.state().why_not_engaged

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
                self._decide()
            for _ in range(SAMPLES_PER_TICK):
                self.world.run_until(self.world.now_ns + TICK_NS // SAMPLES_PER_TICK)
                self._samples.append(sample(self.world.car.truth))
            if then is not None:
                then()

    @property
    def run(self) -> Run:
        """All that happened so far."""
        return Run.of(self._samples)

    def _decide(self) -> None:
        curvature_per_m = self._kinematics.curvature_per_m(self.wheel_rad)
        decision = Decision(speed_mps=self.speed_mps, curvature_per_m=curvature_per_m)
        self.link.submit(PlannerInputs(decision=decision, decided_ns=self.link.now_ns()))
