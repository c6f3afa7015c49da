"""The simulated car in wall time, at the other end of the harness.

The car itself is `simulation.plant`; here are its wires and its pace. A plant that is stalled (a
busy machine) must not look like an ECU that is dead: time that passes unseen is cut to
`STALL_NS_MAX`, the simulated world pauses, and the pause is counted.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

from numpy.random import default_rng

from canbus.bus import Bus
from canbus.frame import Frame, ReceivedFrame
from canbus.node import PERIOD_NS, Event, EventKind
from dbc.harness import (
    BrakeActuatorWire,
    BrakeEncoderWire,
    BrakeSensorsWire,
    DriverHandsWire,
    PlantMotionWire,
    PlantPositionWire,
    RelayCoil,
    SteeringActuatorWire,
    SteeringSensorsWire,
    SupervisorActuatorWire,
    SupervisorSensorsWire,
    ThrottleActuatorWire,
    ThrottleSensorsWire,
)
from ecus.brake_servo.ports import BrakeActuator
from ecus.steering.ports import SteeringActuator
from ecus.supervisor.ports import SupervisorActuator
from ecus.throttle.ports import ThrottleActuator
from runtime.clock import Clock, monotonic_ns
from runtime.harness import SPEC_OF_NAME, decode_harness, harness_frame
from runtime.node_process import NodeResult, Report, StopFlag, one_line
from runtime.nodes import PLANT_PHASE_NS
from runtime.pacing import Pacer
from runtime.process_settings import ProcessSettings
from runtime.realtime import apply_realtime, keep_collections_short
from runtime.service_notify import ServiceNotify
from runtime.stopping import StopRequest
from simulation.plant.car import ORIGIN, Car
from simulation.plant.derived import plant_of
from simulation.plant.state import Pose, Truth
from vehicles import Vehicle

PLANT_NODE = "Plant"

STALL_NS_MAX = 20_000_000
"""Longest time between two looks at the clock that counts as simulated time."""

POSE_CYCLES = 2
"""The true pose is sent every so many cycles: 50 Hz, for whoever watches."""

COLUMN_ANGLE_RAD_MAX = 16.7
DRIVER_TORQUE_NM_MAX = 65.0
SLOPE_RAD_MAX = 1.5

RELAY_OF_COIL = {RelayCoil.LEAVE: None, RelayCoil.OPEN: False, RelayCoil.CLOSE: True}
"""What a pulse of the coil does to the manual/automatic relay."""

ACCEPTANCE = frozenset(
    spec.can_id for spec in SPEC_OF_NAME.values() if PLANT_NODE in spec.receivers
)
"""Harness identifiers the plant reads."""


def build_car(vehicle: Vehicle, *, seed: int, start_pose: Pose = ORIGIN, start_ns: int = 0) -> Car:
    """A car of this vehicle, parked."""
    return Car(plant_of(vehicle), default_rng(seed), start_pose, start_ns)


class PlantSide:
    """A car behind harness frames; no input or output of its own.

    Args:
        car: powered on at `start_ns`.
        start_ns: wall time at power-on.

    Attributes:
        truth: the car at the latest cycle.
        bad_frames: frames for the plant that could not be used.
        stalled_ns: wall time that was cut away.
    """

    def __init__(self, car: Car, start_ns: int) -> None:
        self._car = car
        self._last_ns = start_ns
        self._cycle = 0
        self.truth: Truth = car.truth
        self.bad_frames = 0
        self.stalled_ns = 0

    @property
    def drive_acceptance(self) -> frozenset[int]:
        """Identifiers of the vehicle bus that the car's motor drives read; none without drives."""
        return frozenset() if self._car.train is None else self._car.train.acceptance

    def hear_vehicle_bus(self, received: Sequence[ReceivedFrame]) -> None:
        """Frames for the motor drives, which see them in the next step."""
        if self._car.train is not None:
            self._car.train.hear(item.frame for item in received)

    def drive_frames(self) -> list[Frame]:
        """What the motor drives have to say on the vehicle bus after a step."""
        return [] if self._car.train is None else self._car.train.take_frames()

    def step(self, now_ns: int, received: Sequence[ReceivedFrame]) -> list[Frame]:
        """One cycle: commands act at their arrival, then every sensor is read.

        Args:
            now_ns: wall time; never before an earlier one.
            received: frames of the harness bus since the last cycle, in order of arrival.

        Returns:
            The sensors' frames.
        """
        for item in received:
            if item.frame.can_id in ACCEPTANCE:
                self._take(item)
        car_ns = self._car_time(now_ns)
        self._car.advance(car_ns)
        self.truth = self._car.truth
        frames = self._sensor_frames(car_ns)
        if self._cycle % POSE_CYCLES == 0:
            frames += truth_frames(self.truth)
        self._cycle += 1
        return frames

    def _car_time(self, wall_ns: int) -> int:
        """The car's time at a wall time: the same clock, less the stalls."""
        passed_ns = max(0, wall_ns - self._last_ns)
        self.stalled_ns += max(0, passed_ns - STALL_NS_MAX)
        self._last_ns = max(wall_ns, self._last_ns)
        return self._last_ns - self.stalled_ns

    def _take(self, item: ReceivedFrame) -> None:
        reading = decode_harness(item)
        if reading is None:
            self.bad_frames += 1
            return
        car, now_ns = self._car, self._car_time(item.arrival_ns)
        car.advance(now_ns)
        match reading.content:
            case SteeringActuatorWire() as wire:
                car.actuate_steering(
                    now_ns,
                    SteeringActuator(
                        motor_duty_ratio=wire.motor_duty_ratio, motor_enabled=wire.motor_enabled
                    ),
                )
            case ThrottleActuatorWire() as wire:
                car.actuate_throttle(
                    now_ns,
                    ThrottleActuator(
                        throttle_dac_code=wire.throttle_dac_code,
                        regen_dac_code=wire.regen_dac_code,
                        reverse_selected=wire.reverse_selected,
                    ),
                )
            case BrakeActuatorWire() as wire:
                car.actuate_brake(
                    now_ns,
                    BrakeActuator(
                        servo_position_ratio=wire.servo_position_ratio,
                        servo_powered=wire.servo_powered,
                    ),
                )
            case SupervisorActuatorWire() as wire:
                relay = SupervisorActuator(automatic_relay_closed=RELAY_OF_COIL[wire.relay_coil])
                car.actuate_supervisor(now_ns, relay)
            case DriverHandsWire() as wire:
                self._drive(wire)

    def _drive(self, hands: DriverHandsWire) -> None:
        driver = self._car.driver
        driver.steering_torque_nm = hands.steering_torque_nm
        driver.throttle_pedal_ratio = hands.throttle_pedal_ratio
        driver.brake_pedal_ratio = hands.brake_pedal_ratio
        driver.button_pressed = hands.button_pressed
        driver.emergency_stop_pressed = hands.emergency_stop_pressed

    def _sensor_frames(self, car_ns: int) -> list[Frame]:
        steering = self._car.sense_steering(car_ns)
        throttle = self._car.sense_throttle(car_ns)
        brake = self._car.sense_brake(car_ns)
        panel = self._car.sense_supervisor(car_ns)
        messages: dict[str, Any] = {
            "STEERING_SENSORS": SteeringSensorsWire(
                column_angle_rad=_clip(steering.column_angle_rad, COLUMN_ANGLE_RAD_MAX),
                driver_torque_nm=_clip(steering.driver_torque_nm, DRIVER_TORQUE_NM_MAX),
                motor_fault=steering.motor_fault,
            ),
            "THROTTLE_SENSORS": ThrottleSensorsWire(
                encoder_count=throttle.encoder_count,
                encoder_edge_age_s=throttle.encoder_edge_age_s,
                pedal_ratio=throttle.pedal_ratio,
            ),
            "BRAKE_ENCODER": BrakeEncoderWire(
                wheel_count=brake.wheel_count, wheel_edge_age_s=brake.wheel_edge_age_s
            ),
            "BRAKE_SENSORS": BrakeSensorsWire(
                servo_position_ratio=brake.servo_position_ratio,
                pedal_ratio=brake.pedal_ratio,
                slope_rad=_clip(brake.slope_rad, SLOPE_RAD_MAX),
            ),
            "SUPERVISOR_SENSORS": SupervisorSensorsWire(
                button_pressed=panel.button_pressed,
                emergency_stop_pressed=panel.emergency_stop_pressed,
                automatic_relay_closed=bool(panel.automatic_relay_closed),
            ),
        }
        return [harness_frame(name, message) for name, message in messages.items()]


def truth_frames(truth: Truth) -> list[Frame]:
    """Where the car truly is, for whoever watches; the heading within +-pi."""
    position = PlantPositionWire(x_m=truth.pose.x_m, y_m=truth.pose.y_m)
    motion = PlantMotionWire(
        heading_rad=math.remainder(truth.pose.heading_rad, math.tau),
        speed_mps=truth.speed_mps,
        yaw_rate_radps=truth.yaw_rate_radps,
    )
    return [harness_frame("PLANT_POSITION", position), harness_frame("PLANT_MOTION", motion)]


def _clip(value: float, limit: float) -> float:
    """The value within +-limit, as an electrical input saturates; NaN stays NaN."""
    return value if math.isnan(value) else max(-limit, min(limit, value))


def run_plant(
    plant: PlantSide,
    bus: Bus,
    clock: Clock,
    stop: StopFlag,
    report: Report,
    on_cycle: Callable[[Truth], None] = lambda truth: None,
    alive: Callable[[int], None] = lambda now_ns: None,
    vehicle_bus: Bus | None = None,
) -> NodeResult:
    """Runs the plant on the harness bus until `stop` is set.

    Args:
        plant: the car and its wires.
        bus: the harness bus, open.
        clock: the bus's clock.
        stop: looked at before and after every wait.
        report: gets what goes wrong.
        on_cycle: gets the truth of every cycle, in the plant's own thread.
        alive: called with the time at the end of every cycle, for watchdogs.
        vehicle_bus: where the car's motor drives are, open; None for a car without drives.

    Returns:
        How it ended; an exception is reported and in `failure`, not raised.
    """
    pacer = Pacer(start_ns=clock(), period_ns=PERIOD_NS, phase_ns=PLANT_PHASE_NS)
    failure = None
    tx_failures = 0
    received: list[ReceivedFrame] = []
    try:
        while not stop.is_set():
            received += bus.gather(pacer.wait_ns(clock()))
            now_ns = clock()
            if stop.is_set() or pacer.wait_ns(now_ns) > 0:
                continue
            pacer.begin(now_ns)
            if vehicle_bus is not None:
                plant.hear_vehicle_bus(vehicle_bus.receive(0))
            for frame in plant.step(now_ns, received):
                tx_failures += not bus.send(frame)
            if vehicle_bus is not None:
                for frame in plant.drive_frames():
                    tx_failures += not vehicle_bus.send(frame)
            received = []
            on_cycle(plant.truth)
            end_ns = clock()
            pacer.end(end_ns)
            alive(end_ns)
    except Exception as error:  # whatever it is: the ECUs see their wires go silent
        failure = one_line(error)
        text = f"{PLANT_NODE} ends: {failure}"
        report(Event(time_ns=clock(), node=PLANT_NODE, kind=EventKind.STATE, text=text))
    return NodeResult(
        node=PLANT_NODE,
        failure=failure,
        steps=pacer.cycles,
        overruns=pacer.overruns,
        skipped=pacer.skipped,
        lag_ns_max=pacer.lag_ns_max,
        tx_failures=tx_failures,
    )


def run_plant_process(
    settings: ProcessSettings, report: Report, *, seed: int = 0, start_pose: Pose = ORIGIN
) -> NodeResult:
    """The main of `dbw ecu plant`: runs until SIGTERM or SIGINT.

    Raises:
        LaunchError: the vehicle is unknown, or the system refuses what was asked
            of it by name.
        BusError: the harness bus, or the drives' bus, cannot be opened.
    """
    vehicle = settings.load_vehicle()
    bus = settings.harness_bus(vehicle, ACCEPTANCE)
    keep_collections_short()  # at the priority it would hold up the nodes that run already
    apply_realtime(settings.realtime)
    start_ns = monotonic_ns()
    car = build_car(vehicle, seed=seed, start_pose=start_pose, start_ns=start_ns)
    service = ServiceNotify(os.environ)
    plant = PlantSide(car, start_ns)
    with ExitStack() as open_buses:
        stop = open_buses.enter_context(StopRequest())
        open_buses.enter_context(bus)
        vehicle_bus: Bus | None = None
        if plant.drive_acceptance:
            vehicle_bus = open_buses.enter_context(
                settings.vehicle_bus(vehicle, plant.drive_acceptance)
            )
        keep_collections_short()  # once more, of what opening the buses has loaded
        result = run_plant(
            plant, bus, monotonic_ns, stop, report, alive=service.alive, vehicle_bus=vehicle_bus
        )
        service.stopping()
        return result
