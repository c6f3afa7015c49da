"""A car that drives itself in virtual time, with a planner that holds speed and curvature.

Unlike a planner that waits on the link, this one is an event of the kernel: the world can be
stopped at any instant, which is where causes of emergencies have to come from.
"""

from __future__ import annotations

import math

import numpy as np

from canbus.frame import Frame
from dbc.codec import Decoded, decode
from dbc.endpoint import STOPPING_IDS
from dbc.messages import Mode, Request
from ecus.supervisor.ecu import SupervisorEcu
from gateway.commands import Decision
from gateway.core import PlannerInputs
from simulation.link import SimulationLink
from simulation.world import World
from vehicles import Vehicle, load_vehicle

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
PLANNER_PERIOD_NS = 20_000_000
PLANNER_PRIORITY = 2
"""After wire and nodes of the same instant."""

START_S = 1.0
"""Every node has started, and the monitor has seen half a second of health."""
BUTTON_S = 0.15
ENGAGE_S = 0.1
SETTLE_S = 1.5

TABBY = load_vehicle("tabby_evo")


class Rig:
    """A world, its planner and what was heard on the wire.

    Attributes:
        speed_mps, curvature_per_m: What the planner decides, until changed.
        is_silent: The planner has stopped deciding.
        decided_ns: True time of its last decision.
        newest: The last frame of each identifier with the true time of its end.
        stranger_ns: True time at which a stranger's frame last ended.
        emergency: True time, sender and frame of the first EMERGENCY_BRAKE.
        frames: How many have ended on the wire.
    """

    def __init__(self, seed: int, vehicle: Vehicle = TABBY) -> None:
        self.seed = seed
        self.world = World(
            vehicle, seed, planner_period_ns=PLANNER_PERIOD_NS, keep_frames=False
        )
        self.car = self.world.car
        self.rng = np.random.default_rng((seed, 1))
        self.speed_mps = 0.0
        self.curvature_per_m = 0.0
        self.is_silent = False
        self.decided_ns = 0
        self.newest: dict[int, tuple[int, Frame]] = {}
        self.stranger_ns: int | None = None
        self.emergency: tuple[int, str, Frame] | None = None
        self.frames = 0
        self._link = SimulationLink(self.world)
        self.world.wire.witnesses.append(self._witness)
        first_ns = int(self.rng.integers(PLANNER_PERIOD_NS))
        self.world.kernel.at(first_ns, PLANNER_PRIORITY, self._decide)

    def _witness(self, true_ns: int, sender: str, frame: Frame) -> None:
        self.frames += 1
        self.newest[frame.can_id] = (true_ns, frame)
        if sender not in self.world.stations:
            self.stranger_ns = true_ns
        if frame.can_id in STOPPING_IDS and self.emergency is None:
            self.emergency = (true_ns, sender, frame)

    def _decide(self, true_ns: int) -> None:
        self.world.kernel.at(true_ns + PLANNER_PERIOD_NS, PLANNER_PRIORITY, self._decide)
        if self.is_silent:
            return
        self.decided_ns = true_ns
        decision = Decision(speed_mps=self.speed_mps, curvature_per_m=self.curvature_per_m)
        self._link.submit(PlannerInputs(decision=decision, decided_ns=self._link.now_ns()))

    def stop_listening(self) -> None:
        """Notes no frame from now on, where only the world's own speed is wanted."""
        self.world.wire.witnesses.remove(self._witness)

    # Driving ---------------------------------------------------------------------------------

    def make_ready(self) -> None:
        """From power-on to READY."""
        self.world.run_for(START_S)
        self.car.driver.button_pressed = True
        self.world.run_for(BUTTON_S)
        self.car.driver.button_pressed = False
        self.world.run_for(BUTTON_S)
        assert self.mode is Mode.READY, self.world.events

    def request(self, request: Request) -> None:
        """The planner asks the supervisor for something."""
        self._link.submit(PlannerInputs(request=request))

    def drive_to(self, speed_mps: float, curvature_per_m: float) -> None:
        """From power-on to AUTOMATIC at this speed in this bend."""
        self.make_ready()
        self.request(Request.ENGAGE)
        self.world.run_for(ENGAGE_S)
        assert self.mode is Mode.AUTOMATIC, self.world.events
        self.speed_mps = speed_mps
        acceleration_mps2 = self.world.vehicle.traction.acceleration_mps2_max
        self.world.run_for(speed_mps / acceleration_mps2 + SETTLE_S)
        self.curvature_per_m = curvature_per_m
        self.world.run_for(SETTLE_S)
        assert self.is_driving, self.world.events
        assert math.isclose(self.car.truth.speed_mps, speed_mps, abs_tol=0.4)

    @property
    def mode(self) -> Mode:
        """The supervisor's."""
        supervisor = self.world.stations["Supervisor"].node
        assert isinstance(supervisor, SupervisorEcu)
        return supervisor.mode

    @property
    def is_driving(self) -> bool:
        """AUTOMATIC, and nobody has asked for the emergency brake."""
        return self.mode is Mode.AUTOMATIC and self.emergency is None

    def how_it_ended(self) -> str:
        """Mode and first emergency, for a line of a report."""
        if self.emergency is None:
            return f"mode {self.mode.name}"
        return f"mode {self.mode.name}, {told(self.emergency[2])}"


def told(frame: Frame) -> str:
    """Sender, code and reason of an EMERGENCY_BRAKE."""
    decoded = decode(frame)
    assert isinstance(decoded, Decoded)
    sender = decoded.spec.name.removesuffix("_EMERGENCY_BRAKE")
    return f"{sender} {decoded.message.code.name} {decoded.message.reason.name}"
