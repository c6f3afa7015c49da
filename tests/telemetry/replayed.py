"""A drive whose sensors go over the harness as frames, as they do on a desk; both buses kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from canbus.frame import Frame, ReceivedFrame
from canbus.node import PERIOD_NS
from runtime.harness import Wires
from runtime.nodes import NODES, build_wires
from runtime.plant_process import PlantSide
from simulation.world import Station
from telemetry.replay.through_node import Record
from tests.scenarios.driving import Drive

TICK_PHASE_NS = 9_000_000
"""No node steps so late in the cycle of the simulated world: each finds its readings waiting."""
TICK_PRIORITY = 0
WORK_NS = 100_000
"""From the beginning of a step to its command on the harness."""


class Recorded:
    """A drive and its record so far."""

    def __init__(self, seed: int = 1) -> None:
        self.drive = Drive(seed)
        self.vehicle_bus: list[ReceivedFrame] = []
        self.harness: list[ReceivedFrame] = []
        world = self.drive.world
        self._plant = PlantSide(world.car, 0)
        self._wires: list[Wires[Any, Any]] = []
        world.wire.witnesses.append(self._hear)
        for name, entry in NODES.items():
            wires = build_wires(name)
            self._wires.append(wires)
            self._connect(world.stations[entry.node], wires)
        self._read_sensors(0)
        world.kernel.at(TICK_PHASE_NS, TICK_PRIORITY, self._tick)

    @property
    def record(self) -> Record:
        """Everything heard so far."""
        harness = sorted(self.harness, key=lambda item: item.arrival_ns)
        return Record(vehicle_bus=self.vehicle_bus, harness=harness)

    def _hear(self, true_ns: int, sender: str, frame: Frame) -> None:
        self.vehicle_bus.append(ReceivedFrame(true_ns, frame))

    def _connect(self, station: Station, wires: Wires[Any, Any]) -> None:
        station.senses.append(lambda true_ns, reading: wires.sensors(true_ns))
        station.acts.append(self._actuator(wires))

    def _actuator(self, wires: Wires[Any, Any]) -> Callable[[int, Any], Any]:
        def act(true_ns: int, command: Any) -> Any:
            sent_ns = true_ns + WORK_NS
            self.harness += [ReceivedFrame(sent_ns, frame) for frame in wires.frames(command)]
            return command

        return act

    def _tick(self, true_ns: int) -> None:
        self._read_sensors(true_ns)
        self.drive.world.kernel.at(true_ns + PERIOD_NS, TICK_PRIORITY, self._tick)

    def _read_sensors(self, true_ns: int) -> None:
        frames = [ReceivedFrame(true_ns, frame) for frame in self._plant.step(true_ns, [])]
        self.harness += frames
        for wires in self._wires:
            wires.take(frames)
