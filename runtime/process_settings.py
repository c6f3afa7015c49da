"""What the process of a node, or of the plant, needs to know, and the buses it opens."""

from __future__ import annotations

from dataclasses import dataclass, field

from canbus.cycle import LATE_NS_MAX
from canbus.node import PERIOD_NS
from canbus.python_can_bus import PythonCanBus
from canbus.socketcan import backlog_frames_max
from runtime.clock import monotonic_ns, realtime_ns
from runtime.errors import LaunchError
from runtime.realtime import RealtimeSettings
from vehicles import Vehicle, VehicleError, load_vehicle

AWAY_NS_MAX = PERIOD_NS + LATE_NS_MAX
"""Longest time in which a node reads nothing and is still to be trusted (ER2)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessSettings:
    """The options of `dbw ecu`.

    Attributes:
        name: a key of `runtime.nodes.NODES`, or "plant".
        vehicle: name of a shipped vehicle, or a path ending in .toml.
        interface: python-can's name of the interface.
        channel: the vehicle bus.
        harness_channel: the bus that stands for the wires.
        harness_interface: its interface; None: as the vehicle bus.
        bitrate_bps: for interfaces that set it themselves; None: the vehicle file's.
        realtime: what to ask of the system.
    """

    name: str
    vehicle: str
    interface: str
    channel: str
    harness_channel: str
    harness_interface: str | None = None
    bitrate_bps: int | None = None
    realtime: RealtimeSettings = field(default_factory=RealtimeSettings)

    def load_vehicle(self) -> Vehicle:
        """What the process believes about the car.

        Raises:
            LaunchError: the vehicle is unknown or wrong.
        """
        try:
            return load_vehicle(self.vehicle)
        except VehicleError as error:
            raise LaunchError(str(error)) from error

    def vehicle_bus(self, vehicle: Vehicle, acceptance: frozenset[int] | None) -> PythonCanBus:
        """The vehicle bus, not opened yet."""
        return self._bus(self.interface, self.channel, vehicle, acceptance)

    def harness_bus(self, vehicle: Vehicle, acceptance: frozenset[int]) -> PythonCanBus:
        """The harness bus, not opened yet."""
        interface = self.harness_interface or self.interface
        return self._bus(interface, self.harness_channel, vehicle, acceptance)

    def _bus(
        self, interface: str, channel: str, vehicle: Vehicle, acceptance: frozenset[int] | None
    ) -> PythonCanBus:
        bitrate_bps = self.bitrate_bps or round(vehicle.bus.bitrate_bps)
        return PythonCanBus(
            interface,
            channel,
            clock=monotonic_ns,
            realtime=realtime_ns,
            bitrate=bitrate_bps,
            acceptance=acceptance,
            backlog_frames=backlog_frames_max(AWAY_NS_MAX, bitrate_bps),
        )
