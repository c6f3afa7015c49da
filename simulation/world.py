"""All nodes and a car in virtual time, with the same code as on the car."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.random import Generator

from canbus.frame import Frame
from canbus.node import NODE_IDS, PERIOD_NS, Event, StepOutput
from ecus.brake_servo.ecu import BrakeServoEcu
from ecus.steering.ecu import SteeringEcu
from ecus.supervisor.ecu import SupervisorEcu
from ecus.throttle.ecu import ThrottleEcu
from gateway.core import NO_INPUTS, GatewayCore, PlannerInputs
from safety_monitor.monitor import SafetyMonitor
from safety_monitor.ports import MonitorSensors
from simulation.kernel import Kernel
from simulation.node_clock import NodeClock
from simulation.plant.car import ORIGIN, Car
from simulation.plant.derived import plant_of
from simulation.plant.drive_train import DriveTrain, DriveUnit
from simulation.plant.params import PlantParams
from simulation.plant.state import Pose
from simulation.trace import Trace
from simulation.wire import Receiver, Wire
from vehicles import Vehicle

STEP_PRIORITY: Final = 1
PHASE_STEP_NS: Final = 1_370_000
"""Nodes begin their cycles apart, as crystals that were switched on by hand do."""
DRIFT_PPM_MAX: Final = 100
EPOCH_NS_MAX: Final = 10**12
"""Clocks show up to 17 minutes at the start: a time taken from another clock is far off."""

Sense = Callable[[int], Any]
Act = Callable[[int, Any], None]
Tamper = Callable[[int, Sequence[Frame]], Sequence[Frame]]
"""`(true_ns, frames)`: what becomes of frames that a node gives its controller."""
Between = Callable[[int, Any], Any]
"""`(true_ns, reading)` or `(true_ns, command)`: what arrives of it."""



def in_time() -> int:
    """No lateness at all."""
    return 0


@dataclass(slots=True)
class Mounting:
    """How a node is wired: made by `build`, reading `sense`, moving `act`."""

    build: Callable[[], Any]
    sense: Sense
    act: Act


class Station(Receiver):
    """One node on the wire: its clock, its inbox, and whether it lives.

    Attributes:
        is_alive: it is stepped; a dead one's controller still acknowledges.
        is_frozen: it is not stepped, and finds all that has come meanwhile when it is again.
        is_mute, is_deaf: its frames reach nobody, or nobody's reach it.
        lateness_ns: how late its next cycle begins: its operating system's doing.
        step_ns: how long one of its steps takes; the next begins no sooner.
        tampers: what happens to its frames before its controller gets them.
        senses, acts: what lies between it and its sensors, and its actuator.
    """

    def __init__(self, world: World, name: str, mounting: Mounting, clock: NodeClock) -> None:
        super().__init__(name)
        self.clock = clock
        self.node: Any = mounting.build()
        self.is_alive = True
        self.is_frozen = False
        self.is_mute = False
        self.is_deaf = False
        self.lateness_ns: Callable[[], int] = in_time
        self.step_ns = 0
        self.tampers: list[Tamper] = []
        self.senses: list[Between] = []
        self.acts: list[Between] = []
        self._mounting = mounting
        self._world = world
        self._next_ns = 0

    @property
    def acceptance(self) -> frozenset[int] | None:
        """Identifiers the node's controller lets through; None for all."""
        accepted: frozenset[int] | None = self.node.acceptance
        return accepted

    def start(self, true_ns: int) -> None:
        """Plans the first cycle."""
        self._next_ns = self.clock.local_ns(true_ns)
        self._world.kernel.at(true_ns, STEP_PRIORITY, self._cycle)

    def _cycle(self, true_ns: int) -> None:
        world, clock = self._world, self.clock
        now_ns = clock.local_ns(true_ns)
        late_ns = now_ns - self._next_ns
        if late_ns >= PERIOD_NS:  # no bursts: what is missed is missed
            self._next_ns += late_ns // PERIOD_NS * PERIOD_NS
        self._next_ns += PERIOD_NS
        due_ns = clock.true_ns(self._next_ns) + self.lateness_ns()
        world.kernel.at(max(due_ns, true_ns + self.step_ns), STEP_PRIORITY, self._cycle)
        if not self.is_alive:
            self.inbox.clear()
        elif not self.is_frozen:
            self._step(true_ns, now_ns, self.sense(true_ns))

    def step(self, true_ns: int, sensors: Any) -> None:
        """One step of the node now; `sensors` in place of what its mounting reads."""
        self._step(true_ns, self.clock.local_ns(true_ns), sensors)

    def _step(self, true_ns: int, now_ns: int, sensors: Any) -> None:
        heard, self.inbox = self.inbox, []
        received = [] if self.is_deaf else self.clock.received(heard)
        output: StepOutput[Any] = self.node.step(now_ns, received, sensors)
        if output.actuator is not None:
            command = output.actuator
            for between in self.acts:
                command = between(true_ns, command)
            self._mounting.act(true_ns, command)
        if output.events:
            self._world.take_events(true_ns, output.events)
        if output.frames and not self.is_mute:
            frames = output.frames
            for tamper in self.tampers:
                frames = tamper(true_ns, frames)
            self._world.wire.send(true_ns, self.name, frames)

    def sense(self, true_ns: int) -> Any:
        """What the node reads now."""
        reading = self._mounting.sense(true_ns)
        for between in self.senses:
            reading = between(true_ns, reading)
        return reading

    def restart(self) -> None:
        """Power off and on: a new node with nothing remembered."""
        self.node = self._mounting.build()
        self.inbox = []
        self.is_alive = True
        self.is_frozen = False


class DriveStation(Receiver):
    """A motor drive of the car on the wire."""

    def __init__(self, unit: DriveUnit) -> None:
        super().__init__(unit.name)
        self.unit = unit

    @property
    def acceptance(self) -> frozenset[int] | None:
        """Identifiers that its controller lets through."""
        return self.unit.acceptance


class World:
    """The car, the wire and the six nodes.

    Args:
        vehicle: What the nodes believe.
        seed: The only source of chance: sensor noise, clocks, phases.
        planner_period_ns: What the planner promises.
        start_pose: Where the car stands.
        plant: The truth; by default that of the vehicle's name.
        keep_frames: Whether the trace keeps every frame, or only the hash.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        seed: int,
        *,
        planner_period_ns: int = 20_000_000,
        start_pose: Pose = ORIGIN,
        plant: PlantParams | None = None,
        keep_frames: bool = True,
    ) -> None:
        root = np.random.default_rng(seed)
        car_rng, clock_rng, self.planner_rng, self.fault_rng = root.spawn(4)
        self.vehicle = vehicle
        self.seed = seed
        self.kernel = Kernel()
        self.car = Car(plant or plant_of(vehicle), car_rng, start_pose)
        self.wire = Wire(self.kernel, round(vehicle.bus.bitrate_bps))
        self.trace = Trace(keep=keep_frames)
        self.wire.witnesses.append(self.trace)
        self.events: list[tuple[int, Event]] = []
        self.stations = self._build(planner_period_ns, clock_rng)
        self.drive_stations = () if self.car.train is None else self._add_drives(self.car.train)

    def _build(self, planner_period_ns: int, clock_rng: Generator) -> dict[str, Station]:
        car, vehicle = self.car, self.vehicle

        def nothing(true_ns: int, command: Any) -> None:
            raise AssertionError("a node without actuator gave a command")

        def monitor_sensors(true_ns: int) -> MonitorSensors:
            return MonitorSensors(emergency_stop_pressed=car.emergency_line)

        mountings = {
            "Supervisor": Mounting(
                lambda: SupervisorEcu(vehicle), car.sense_supervisor, car.actuate_supervisor
            ),
            "Steering": Mounting(
                lambda: SteeringEcu(vehicle), car.sense_steering, car.actuate_steering
            ),
            "Throttle": Mounting(
                lambda: ThrottleEcu(vehicle), car.sense_throttle, car.actuate_throttle
            ),
            "BrakeServo": Mounting(
                lambda: BrakeServoEcu(vehicle), car.sense_brake, car.actuate_brake
            ),
            "SafetyMonitor": Mounting(lambda: SafetyMonitor(vehicle), monitor_sensors, nothing),
            "Gateway": Mounting(
                lambda: GatewayCore(vehicle, planner_period_ns), lambda _: NO_INPUTS, nothing
            ),
        }
        assert mountings.keys() == NODE_IDS.keys()
        stations = {}
        for number, (name, mounting) in enumerate(mountings.items()):
            epoch_ns = int(clock_rng.integers(EPOCH_NS_MAX))
            drift_ppm = int(clock_rng.integers(-DRIFT_PPM_MAX, DRIFT_PPM_MAX + 1))
            station = Station(self, name, mounting, NodeClock(epoch_ns, drift_ppm))
            stations[name] = station
            self.wire.attach(station)
            station.start(number * PHASE_STEP_NS + int(clock_rng.integers(PHASE_STEP_NS)))
        return stations

    def _add_drives(self, train: DriveTrain) -> tuple[DriveStation, ...]:
        """The car's motor drives get their ends of the wire."""
        stations = tuple(DriveStation(unit) for unit in train.units)
        for station in stations:
            self.wire.attach(station)
        self.kernel.at(0, STEP_PRIORITY, self._exchange)
        return stations

    def _exchange(self, true_ns: int) -> None:
        """The drives hear what has come, move on, and send, once in each step of the plant."""
        self.kernel.at(true_ns + self.car.params.step_ns, STEP_PRIORITY, self._exchange)
        for station in self.drive_stations:
            station.unit.inbox += [frame for _, frame in station.inbox]
            station.inbox.clear()
        self.car.advance(true_ns)
        for station in self.drive_stations:
            frames, station.unit.outbox = station.unit.outbox, []
            if frames:
                self.wire.send(true_ns, station.name, frames)

    @property
    def now_ns(self) -> int:
        """True time."""
        return self.kernel.now_ns

    def run_until(self, true_ns: int) -> None:
        """Lets the world go on to a true time; the past is no error, nothing happens."""
        self.kernel.run_until(true_ns)
        self.car.advance(self.kernel.now_ns)

    def run_for(self, span_s: float) -> None:
        """Lets the world go on for a while."""
        self.run_until(self.now_ns + round(span_s * 1e9))

    def submit(self, inputs: PlannerInputs) -> None:
        """Hands the planner's wish to the gateway, which steps at once; a dead one does not."""
        gateway = self.stations["Gateway"]
        if gateway.is_alive and not gateway.is_frozen:
            gateway.step(self.now_ns, inputs)

    def inject(self, frame: Frame, sender: str = "stranger") -> None:
        """Somebody else's frame on the wire."""
        self.wire.send(self.now_ns, sender, [frame])

    def take_events(self, true_ns: int, events: Sequence[Event]) -> None:
        """Keeps what a node reports, with the true time."""
        self.events.extend((true_ns, event) for event in events)
