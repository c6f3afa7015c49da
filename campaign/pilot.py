"""Who drives in a campaign: a planner on a road of its own, and a person who gets it going again.

The planner decides as often as it has promised, through the same checks as any planner
(`gateway.commands.decide`), and plays what a faulty one does. The person presses the button,
stands on the brake while the car rolls in MANUAL, and asks for a reset when it stands in EMERGENCY,
or when a code is latched that keeps it from engaging.
"""

from __future__ import annotations

from collections.abc import Callable
from math import nan, pi, sin
from typing import Final

from numpy.random import Generator

from campaign.route import RoadLimits, Route
from dbc.messages import Mode, Request
from gateway.commands import CommandError, Decision, decide
from gateway.core import PlannerInputs
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from simulation.link import SimulationLink
from simulation.world import World

NS_PER_S: Final = 1_000_000_000
PERIOD_NS: Final = 20_000_000
PRIORITY: Final = 2
"""After wire and nodes of the same instant."""
STANDING_MPS = 0.05
FOOT_RATIO = 0.4
BUTTON_NS = 100_000_000
RETRY_NS = 600_000_000
"""Between two pushes of the button, or two requests for a reset."""
ENGAGE_RETRY_NS = 200_000_000
LEAD_S = 0.25
"""How far ahead of the road the curvature is asked for: the steering's own lag."""
DAMPING = 0.9
LENGTH_M = 2.0
LENGTH_S = 0.5
"""Within how many metres the pattern's car is back on its road: so many, and these seconds' way."""
LOST: Final = frozenset({FaultKind.PLANNER_ABSURD, FaultKind.PLANNER_OSCILLATING})
"""They lead the car off its road."""


class Pilot:
    """Planner and person of one world; begins by itself.

    Args:
        world: Where.
        rng: Of the route, and of an absurd planner.
        fault: What is wrong with the planner now, None for nothing.
        is_busy: Whether the person does something else with his hands and feet.

    Attributes:
        is_driving: The car drives itself, by this pilot.
    """

    def __init__(
        self,
        world: World,
        rng: Generator,
        fault: Callable[[], Fault | None],
        is_busy: Callable[[], bool],
    ) -> None:
        limits = RoadLimits.of(world.vehicle)
        self.route: Final = Route(rng, limits)
        self._length_m = LENGTH_M * limits.scale
        self.is_driving = False
        self._world = world
        self._rng = rng
        self._fault = fault
        self._is_busy = is_busy
        self._link = SimulationLink(world)
        self._chassis = world.car.parts.chassis
        self._ready_ns = 0
        self._release_ns: int | None = None
        self._decided_ns = 0
        self._is_lost = False
        first_ns = int(rng.integers(PERIOD_NS))
        world.kernel.at(world.now_ns + first_ns, PRIORITY, self._tick)

    def path_error_m(self) -> float:
        """The car's distance from its road; NaN while it does not drive itself."""
        if not self.is_driving:
            return nan
        return self.route.offset_of(self._chassis.x_m, self._chassis.y_m)

    def _tick(self, now_ns: int) -> None:
        self._world.kernel.at(now_ns + PERIOD_NS, PRIORITY, self._tick)
        self._world.car.advance(now_ns)
        mode: Mode = self._world.stations["Supervisor"].node.mode
        was_driving, self.is_driving = self.is_driving, mode is Mode.AUTOMATIC
        if self.is_driving:
            self._drive(now_ns, is_new=not was_driving)
        if not self._is_busy():
            self._act(now_ns, mode)

    # The planner -----------------------------------------------------------------------------

    def _drive(self, now_ns: int, *, is_new: bool) -> None:
        chassis, route = self._chassis, self.route
        fault = self._fault()
        was_lost, self._is_lost = self._is_lost, fault is not None and fault.kind in LOST
        if is_new or (was_lost and not self._is_lost):  # it plans anew from where it has come to
            route.begin(chassis.x_m, chassis.y_m, chassis.heading_rad)
        route.go_on(chassis.x_m, chassis.y_m, chassis.heading_rad, chassis.speed_mps,
                    PERIOD_NS / NS_PER_S)
        speed_mps, curvature_per_m = route.speed_mps, self._curvature_per_m()
        if fault is not None:
            is_due = now_ns - self._decided_ns >= fault.value * 1e6
            if fault.kind is FaultKind.PLANNER_FROZEN or (
                fault.kind is FaultKind.PLANNER_LATE and not is_due
            ):
                return
            speed_mps, curvature_per_m = self._spoilt(fault, now_ns, speed_mps, curvature_per_m)
        self._decide(now_ns, speed_mps, curvature_per_m)

    def _curvature_per_m(self) -> float:
        """Back to the road within some metres, without overshoot; bounded by the vehicle."""
        route, speed_mps = self.route, max(self._chassis.speed_mps, 0.0)
        length_m = self._length_m + LENGTH_S * speed_mps
        ahead_per_m = route.curvature_per_m + route.curvature_rate_per_ms * LEAD_S
        wanted_per_m = (ahead_per_m - route.offset_m / length_m**2
                        - 2.0 * DAMPING * route.heading_error_rad / length_m)
        limit_per_m = self._world.vehicle.curvature_per_m_max
        return min(max(wanted_per_m, -limit_per_m), limit_per_m)

    def _spoilt(
        self, fault: Fault, now_ns: int, speed_mps: float, curvature_per_m: float
    ) -> tuple[float, float]:
        """What a faulty planner asks for instead."""
        vehicle, rng = self._world.vehicle, self._rng
        if fault.kind is FaultKind.PLANNER_NAN:
            return nan, nan
        if fault.kind is FaultKind.PLANNER_ABSURD:
            side = -1.0 if rng.random() < 0.5 else 1.0
            speed_mps = vehicle.traction.speed_mps_max if rng.random() < 0.5 else 0.0
            return speed_mps, side * vehicle.curvature_per_m_max
        if fault.kind is FaultKind.PLANNER_OSCILLATING:
            swing = sin(2.0 * pi * fault.value * now_ns / NS_PER_S)
            return speed_mps, swing * vehicle.curvature_per_m_max
        return speed_mps, curvature_per_m

    def _decide(self, now_ns: int, speed_mps: float, curvature_per_m: float) -> None:
        try:
            decision: Decision = decide(
                self._world.vehicle, speed_mps=speed_mps, curvature_per_m=curvature_per_m
            )
        except CommandError:
            return  # refused to the planner's face: nothing is sent, its last word grows old
        self._decided_ns = now_ns
        self._link.submit(PlannerInputs(decision=decision, decided_ns=self._link.now_ns()))

    # The person ------------------------------------------------------------------------------

    def _act(self, now_ns: int, mode: Mode) -> None:
        driver = self._world.car.driver
        if self._release_ns is not None and now_ns >= self._release_ns:
            driver.button_pressed = False
            self._release_ns = None
        is_standing = abs(self._chassis.speed_mps) < STANDING_MPS
        rolls = mode is Mode.MANUAL and not is_standing
        driver.brake_pedal_ratio = FOOT_RATIO if rolls else 0.0
        if now_ns < self._ready_ns:
            return
        if rolls:
            self._ready_ns = now_ns + RETRY_NS  # the foot off the pedal before the button
        elif mode in (Mode.MANUAL, Mode.READY) and self._link.state().codes:
            self._ask(now_ns, Request.RESET, RETRY_NS)
        elif mode is Mode.MANUAL:
            driver.button_pressed = True
            self._release_ns = now_ns + BUTTON_NS
            self._ready_ns = now_ns + RETRY_NS
        elif mode is Mode.READY and self._release_ns is None:
            self._ask(now_ns, Request.ENGAGE, ENGAGE_RETRY_NS)
        elif mode is Mode.EMERGENCY and is_standing:
            self._ask(now_ns, Request.RESET, RETRY_NS)

    def _ask(self, now_ns: int, request: Request, wait_ns: int) -> None:
        self._ready_ns = now_ns + wait_ns
        self._link.submit(PlannerInputs(request=request))
