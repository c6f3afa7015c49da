"""A drive in virtual time, for scenarios: engaged, moving, with a planner that can fall silent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from canbus.frame import Frame
from dbc.codec import Decoded, decode
from dbc.messages import EmergencyBrake, ErrorCode, Mode, NodeState, Reason, Request
from ecus.supervisor.ecu import SupervisorEcu
from gateway.commands import Decision
from gateway.core import PlannerInputs
from gateway.state import CarState
from simulation.link import SimulationLink
from simulation.world import World
from vehicles import Vehicle, load_vehicle

TABBY = load_vehicle("tabby_evo")
TICK_S = 0.02
START_S = 1.0
"""Time in which every node has started and the monitor has seen half a second of health."""


class Drive:
    """A world with a planner that asks for one speed and curvature."""

    def __init__(self, seed: int = 1, vehicle: Vehicle = TABBY) -> None:
        self.world = World(vehicle, seed)
        self.link = SimulationLink(self.world)
        self.car = self.world.car
        self.speed_mps = 0.0
        self.curvature_per_m = 0.0
        self.is_planner_silent = False
        self.emergencies: list[tuple[int, str, EmergencyBrake]] = []
        self.world.wire.witnesses.append(self._witness)

    def _witness(self, true_ns: int, sender: str, frame: Frame) -> None:
        if 0x010 < frame.can_id <= 0x016:
            decoded = decode(frame)
            if isinstance(decoded, Decoded):  # a stranger's may be broken
                self.emergencies.append((true_ns, sender, decoded.message))

    def start(self) -> Drive:
        """Until MANUAL with a permit."""
        self.world.run_for(START_S)
        assert self.mode is Mode.MANUAL
        return self

    def press_button(self) -> None:
        """A push of the Auto/Manual button."""
        self.car.driver.button_pressed = True
        self.world.run_for(0.1)
        self.car.driver.button_pressed = False
        self.world.run_for(0.05)

    def engage(self, wait_s: float = 0.08) -> Drive:
        """Asks for AUTOMATIC, the planner deciding meanwhile."""
        self.link.submit(PlannerInputs(request=Request.ENGAGE))
        self.run(wait_s)
        return self

    def go(self, speed_mps: float, curvature_per_m: float = 0.0) -> Drive:
        """From power-on to AUTOMATIC at the wanted speed."""
        self.start()
        self.press_button()
        self.engage()
        assert self.mode is Mode.AUTOMATIC, self.state.why_not_engaged
        self.speed_mps = speed_mps
        self.run(speed_mps / 1.4 + 1.0)
        self.curvature_per_m = curvature_per_m
        self.run(1.5)
        assert self.mode is Mode.AUTOMATIC, self.log()
        assert abs(self.speed - speed_mps) < 0.3
        return self

    def run(self, span_s: float, until: Callable[[], bool] | None = None) -> bool:
        """Lets time pass, the planner deciding every 20 ms unless silent; True when `until`."""
        end_ns = self.world.now_ns + round(span_s * 1e9)
        while self.world.now_ns < end_ns:
            if not self.is_planner_silent:
                self.link.submit(
                    PlannerInputs(
                        decision=Decision(
                            speed_mps=self.speed_mps, curvature_per_m=self.curvature_per_m
                        ),
                        decided_ns=self.link.now_ns(),
                    )
                )
            self.world.run_for(TICK_S)
            if until is not None and until():
                return True
        return False

    def request(self, request: Request, span_s: float = 0.2) -> None:
        """The planner asks the supervisor for something."""
        self.link.submit(PlannerInputs(request=request))
        self.run(span_s)

    def stop_node(self, name: str) -> None:
        """The node dies: no step, no frame, its hardware watchdog starves."""
        self.world.stations[name].is_alive = False

    @contextmanager
    def losing(self, wanted: Callable[[Frame], bool]) -> Iterator[None]:
        """Within the block, frames for which `wanted` holds are lost on their way to everybody."""

        def keep(true_ns: int, sender: str, frame: Frame, receiver: str) -> bool:
            return not wanted(frame)

        self.world.wire.filters.append(keep)
        yield
        self.world.wire.filters.remove(keep)

    @property
    def supervisor(self) -> SupervisorEcu:
        node = self.world.stations["Supervisor"].node
        assert isinstance(node, SupervisorEcu)
        return node

    @property
    def mode(self) -> Mode:
        return self.supervisor.mode

    def is_in(self, mode: Mode) -> bool:
        """Whether the supervisor is in this mode now."""
        return self.mode is mode

    @property
    def codes(self) -> tuple[ErrorCode, ...]:
        """Codes that the planner is told; none when it is told nothing."""
        return self.state.codes or ()

    @property
    def speed(self) -> float:
        """True speed, m/s."""
        return self.car.truth.speed_mps

    @property
    def brake(self) -> float:
        """True position of the brake servo."""
        return self.car.truth.servo_position_ratio

    @property
    def state(self) -> CarState:
        return self.link.state()

    def node_state(self, name: str) -> NodeState:
        state = self.world.stations[name].node.state
        assert isinstance(state, NodeState)
        return state

    def brakes_to_standstill(self, within_s: float = 4.0) -> bool:
        """Whether the car comes to stand, braked."""
        return self.run(within_s, until=lambda: abs(self.speed) < 0.02)

    def first_emergency(self) -> tuple[ErrorCode, Reason]:
        """Code and reason of the first EMERGENCY_BRAKE frame on the wire."""
        message = self.emergencies[0][2]
        return message.code, message.reason

    def log(self) -> str:
        """What the nodes reported."""
        return "\n".join(
            f"{true_ns / 1e9:.3f} {event.node} {event.kind} {event.text}"
            for true_ns, event in self.world.events
        )
