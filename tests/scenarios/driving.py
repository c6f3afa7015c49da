"""A drive in virtual time, for scenarios: engaged, moving, with a planner that can fall silent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from canbus.frame import Frame
from dbc.codec import Decoded, decode, encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import (
    EmergencyBrake,
    ErrorCode,
    Inhibit,
    Mode,
    ModeRequest,
    NodeState,
    Reason,
    Request,
    SupervisorState,
)
from dbc.protection import COUNTER_MODULO
from ecus.supervisor.ecu import SupervisorEcu
from gateway.commands import Decision
from gateway.core import PlannerInputs
from gateway.state import CarState
from simulation.link import SimulationLink
from simulation.plant.params import PlantParams
from simulation.world import World
from vehicles import Vehicle, load_vehicle

TABBY = load_vehicle("tabby_evo")
TICK_S = 0.02
STRANGER = "stranger"
START_S = 1.0
"""Time in which every node has started and the monitor has seen half a second of health."""


class Drive:
    """A world with a planner that asks for one speed and curvature."""

    def __init__(
        self, seed: int = 1, vehicle: Vehicle = TABBY, plant: PlantParams | None = None
    ) -> None:
        self.world = World(vehicle, seed, plant=plant)
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


def ready(seed: int = 1) -> Drive:
    """A standing car in READY."""
    drive = Drive(seed).start()
    drive.press_button()
    assert drive.is_in(Mode.READY)
    return drive


def stopped_in_emergency(slope_rad: float = 0.0) -> Drive:
    """A car that stands in EMERGENCY, its brake full, on a slope."""
    drive = Drive().go(3.0)
    drive.request(Request.EMERGENCY_STOP)
    assert drive.brakes_to_standstill()
    drive.run(1.0)
    drive.car.faults.slope_rad = slope_rad
    return drive


def displace(drive: Drive, name: str, message: Any) -> None:
    """From now on two forged frames, in sequence, follow each true one of this message."""
    spec = SPEC_OF_NAME[name]

    def witness(true_ns: int, sender: str, frame: Frame) -> None:
        if sender == STRANGER or frame.can_id != spec.can_id:
            return
        counter = frame.data[1] & 0xF
        forged = [encode(spec, message, (counter + n) % COUNTER_MODULO) for n in (1, 2)]
        drive.world.kernel.at(
            true_ns, 0, lambda now_ns: drive.world.wire.send(now_ns, STRANGER, forged)
        )

    drive.world.wire.witnesses.append(witness)


def ask_as_stranger(drive: Drive, request: Request) -> None:
    """Two MODE_REQUEST frames in sequence: the supervisor believes the second."""
    message = ModeRequest(request=request, planner_period_ms=20, sequence=200)
    for counter in (6, 7):
        drive.world.inject(encode(SPEC_OF_NAME["MODE_REQUEST"], message, counter))


def supervisor_state(mode: Mode, *, authorised: bool = False, epoch: int = 0) -> SupervisorState:
    """What a stranger may say in the supervisor's place."""
    return SupervisorState(
        mode=mode, steering_authorised=authorised, throttle_authorised=authorised,
        brake_authorised=authorised, er0=False, er1=False, er2=False, er3=False, er4=False,
        er5=False, er6=False, reset_epoch=epoch, decision_age_ms_max=85, inhibit=Inhibit.NONE,
    )


def replay(drive: Drive, rows: list[tuple[int, Frame]]) -> None:
    """Frames recorded elsewhere, sent again at their own pace."""
    began_ns = drive.world.now_ns
    for true_ns, frame in rows:
        def send(now_ns: int, frame: Frame = frame) -> None:
            drive.world.wire.send(now_ns, STRANGER, [frame])

        drive.world.kernel.at(began_ns + true_ns, 0, send)
    drive.run(rows[-1][0] / 1e9 + 0.1)


def held_on_a_slope(name: str, slope_rad: float) -> Drive:
    """AUTOMATIC and told to stand, on a slope that comes once the brake is on."""
    drive = Drive(vehicle=load_vehicle(name)).start()
    drive.press_button()
    drive.engage()
    drive.run(1.0)
    drive.car.faults.slope_rad = slope_rad
    drive.run(1.0)
    assert drive.is_in(Mode.AUTOMATIC), drive.state.why_not_engaged
    return drive
