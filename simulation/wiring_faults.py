"""Faults between an ECU and its hardware: readings that lie, actuators that do not obey."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from numpy.random import Generator

from ecus.brake_servo.ports import BrakeActuator
from ecus.steering.ports import SteeringActuator
from ecus.throttle.ports import DAC_CODE_MAX, ThrottleActuator, dac_code
from simulation.fault_kinds import SENSORS, SWAPPED_WITH, FaultKind, full_scale
from simulation.faults import Fault
from simulation.overlay import Overlays, Undo
from simulation.world import Station, World

NS_PER_S = 1_000_000_000
DAC_IDLE = dac_code(0.0)
DAC_FULL = dac_code(1.0)
ENCODER_FLAGS = {"Throttle": "motor_encoder_dead", "BrakeServo": "wheel_encoder_dead"}

Bend = Callable[[float, Any], float]
"""`(value, reading)`: what is read instead."""
Command = SteeringActuator | ThrottleActuator | BrakeActuator


class WiringFaults:
    """Puts itself between ECUs and the car.

    Args:
        world: where.
        rng: noise of sensors.
        overlays: shared with whatever else changes the car's faults.
    """

    def __init__(self, world: World, rng: Generator, overlays: Overlays) -> None:
        self._world = world
        self._rng = rng
        self._overlays = overlays

    def begin(self, fault: Fault, true_ns: int) -> Undo:
        """A fault of one reading or actuator begins."""
        if fault.kind is FaultKind.ENCODER_DEAD:
            flag = ENCODER_FLAGS[fault.target]
            return self._overlays.put(self._world.car.faults, flag, True)
        if fault.target in SENSORS:
            return self._bend(fault)
        return self._hamper(fault, true_ns)

    # Readings --------------------------------------------------------------------------------

    def _bend(self, fault: Fault) -> Undo:
        sensor = SENSORS[fault.target]
        bend = self._bending(fault)

        def between(true_ns: int, reading: Any) -> Any:
            value = bend(getattr(reading, sensor.field), reading)
            return replace(reading, **{sensor.field: value})

        return _wrap(self._world.stations[sensor.node].senses, between)

    def _bending(self, fault: Fault) -> Bend:
        size = fault.value * full_scale(self._world.vehicle, fault.target)
        match fault.kind:
            case FaultKind.SENSOR_STUCK:
                held: list[float] = []

                def stuck(value: float, reading: Any) -> float:
                    if not held:
                        held.append(value)
                    return held[0]

                return stuck
            case FaultKind.SENSOR_OFFSET:
                return lambda value, reading: value + size
            case FaultKind.SENSOR_NOISE:
                return lambda value, reading: value + size * float(self._rng.standard_normal())
            case FaultKind.SENSOR_OUT_OF_BOUNDS:
                return lambda value, reading: size
            case FaultKind.SENSOR_NAN:
                return lambda value, reading: math.nan
        assert fault.kind is FaultKind.SENSOR_SWAPPED
        other = SWAPPED_WITH[fault.target]
        return lambda value, reading: float(getattr(reading, other))

    # Actuators -------------------------------------------------------------------------------

    def _hamper(self, fault: Fault, begin_ns: int) -> Undo:
        station = self._world.stations[fault.target]
        match fault.kind:
            case FaultKind.ACTUATOR_STUCK:
                held: list[Command] = []

                def stuck(true_ns: int, command: Command) -> Command:
                    if not held:
                        held.append(command)
                    return held[0]

                return _wrap(station.acts, stuck)
            case FaultKind.ACTUATOR_WEAK:
                return _wrap(station.acts, lambda _, command: scaled(command, fault.value))
            case FaultKind.ACTUATOR_SLOW:
                return _wrap(station.acts, _lag(fault.value))
        assert fault.kind is FaultKind.ACTUATOR_HOT
        return self._overheat(fault, station, begin_ns)

    def _overheat(self, fault: Fault, station: Station, begin_ns: int) -> Undo:
        """Its power falls to nothing; a motor driver that has shut down says so (ER4)."""

        def hot(true_ns: int, command: Command) -> Command:
            left = 1.0 - (true_ns - begin_ns) / (fault.value * NS_PER_S)
            return scaled(command, max(left, 0.0))

        cool = _wrap(station.acts, hot)
        if fault.target != "Steering":
            return cool
        relight: list[Undo] = []
        is_hot = [True]

        def shut_down(true_ns: int) -> None:
            if is_hot[0]:
                faults = self._world.car.faults
                relight.append(self._overlays.put(faults, "steering_motor_fault", True))

        self._world.kernel.at(begin_ns + round(fault.value * NS_PER_S), -1, shut_down)

        def undo(true_ns: int) -> None:
            is_hot[0] = False
            cool(true_ns)
            for step in relight:
                step(true_ns)

        return undo


def scaled(command: Command, share: float) -> Command:
    """A command of which the actuator does only a share (0 to 1)."""
    if isinstance(command, SteeringActuator):
        return replace(command, motor_duty_ratio=command.motor_duty_ratio * share)
    if isinstance(command, BrakeActuator):
        return replace(command, servo_position_ratio=command.servo_position_ratio * share)
    return replace(
        command,
        throttle_dac_code=DAC_IDLE + round((command.throttle_dac_code - DAC_IDLE) * share),
        regen_dac_code=DAC_IDLE + round((command.regen_dac_code - DAC_IDLE) * share),
    )


def _lag(time_constant_s: float) -> Callable[[int, Command], Command]:
    """Follows with a first-order lag; what switches, switches at once."""
    state: dict[str, float] = {}
    last_ns: list[int] = []

    def lag(true_ns: int, command: Command) -> Command:
        span_s = (true_ns - last_ns[0]) / NS_PER_S if last_ns else 0.0
        last_ns[:] = [true_ns]
        gain = span_s / (time_constant_s + span_s)
        changes: dict[str, float | int] = {}
        for name in ("motor_duty_ratio", "servo_position_ratio", "throttle_dac_code",
                     "regen_dac_code"):
            wanted = getattr(command, name, None)
            if wanted is not None:
                before = state.get(name, float(wanted))
                state[name] = before + gain * (wanted - before)
                changes[name] = round(state[name]) if name.endswith("code") else state[name]
        return replace(command, **changes)  # type: ignore[arg-type]

    return lag


def _wrap(chain: list[Any], link: Any) -> Undo:
    """Puts a link into a chain; the answer takes it out."""
    chain.append(link)
    return lambda _: chain.remove(link)


assert 0 <= DAC_IDLE < DAC_FULL <= DAC_CODE_MAX
