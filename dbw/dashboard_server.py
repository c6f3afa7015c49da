"""Puts a dashboard together: the bus, what can be done to the car, the server, its end."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canbus.listener import Listener
from dbw.dashboard_controls import CarControls
from dbw.failures import UserMistake
from dbw.listening import listener_of
from gateway.connect import connect
from runtime.clock import NS_PER_S, local_text, monotonic_ns, realtime_ns
from runtime.realtime import RealtimeSettings, apply_realtime
from telemetry.dashboard.access import Access
from telemetry.dashboard.picture import HumanClock, Picture
from telemetry.dashboard.server import Server, listen
from telemetry.monitor.filters import Source
from vehicles import Vehicle

if TYPE_CHECKING:
    from telemetry.dashboard.foxglove_server import FoxgloveServer

JOIN_S_MAX = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """What the command line asks for."""

    interface: str
    channel: str
    vehicle: Vehicle
    host: str
    port: int
    access: Access
    bitrate_bps: int | None = None
    harness_channel: str | None = None
    with_gateway: bool = False

    def listener(self) -> Listener:
        """Hears every frame of the vehicle bus."""
        return listener_of(self.interface, [Source(channel=self.channel)], self.bitrate_bps)
    foxglove_port: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Dashboard:
    """One that listens; it answers while `serve` runs."""

    server: Server
    foxglove: FoxgloveServer | None
    listening: socket.socket

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self.listening.getsockname()[1])

    def serve(self, is_over: Callable[[], bool]) -> None:
        """Until it is over."""
        asyncio.run(self.server.serve(self.listening, is_over))


@contextmanager
def open_dashboard(setup: Setup) -> Iterator[Dashboard]:
    """Opens the port, the bus and the controls.

    Raises:
        DashboardError: The port cannot be had.
        BusError: The bus cannot be opened.
    """
    vehicle = setup.vehicle
    bitrate_bps = setup.bitrate_bps or round(vehicle.bus.bitrate_bps)
    with ExitStack() as stack:
        listening = stack.enter_context(listen(setup.host, setup.port))
        listener = stack.enter_context(setup.listener())
        car = None
        if setup.with_gateway:
            car = stack.enter_context(
                connect(setup.interface, setup.channel, vehicle=vehicle)
                if setup.bitrate_bps is None
                else connect(
                    setup.interface, setup.channel, vehicle=vehicle, bitrate_bps=bitrate_bps
                )
            )
        controls = stack.enter_context(
            CarControls(
                setup.interface,
                setup.channel,
                vehicle=vehicle,
                harness_channel=setup.harness_channel,
                car=car,
            )
        )
        foxglove = None
        if setup.foxglove_port is not None:
            foxglove = stack.enter_context(_foxglove_of(setup, setup.foxglove_port))
        server = Server(
            listener=listener,
            picture=Picture(vehicle, setup.channel, bitrate_bps, human_clock()),
            controls=controls,
            access=setup.access,
            about=_about(setup),
            clock=monotonic_ns,
            realtime=realtime_ns,
            also_feed=lambda heard: None if foxglove is None else foxglove.feed(heard),
        )
        yield Dashboard(server=server, foxglove=foxglove, listening=listening)


@contextmanager
def dashboard_beside(setup: Setup) -> Iterator[Dashboard]:
    """A dashboard in a thread of its own, beside a drive in this process."""
    ended = threading.Event()
    with open_dashboard(setup) as dashboard:

        def serve() -> None:
            apply_realtime(RealtimeSettings())  # what nodes in this process wait for
            dashboard.serve(ended.is_set)

        thread = threading.Thread(target=serve, name="dashboard", daemon=True)
        thread.start()
        try:
            yield dashboard
        finally:
            ended.set()
            thread.join(JOIN_S_MAX)


def _foxglove_of(setup: Setup, port: int) -> FoxgloveServer:
    try:
        from telemetry.dashboard.foxglove_server import FoxgloveServer
    except ImportError as error:
        raise UserMistake(
            "--foxglove needs foxglove-sdk: pip install can-by-wire[foxglove]"
        ) from error
    return FoxgloveServer(setup.channel, setup.host, port)


def _about(setup: Setup) -> dict[str, object]:
    vehicle = setup.vehicle
    return {
        "vehicle": vehicle.name,
        "bus": f"{setup.interface} {setup.channel}",
        "wheel_rad_max": vehicle.steering.wheel_angle_rad_max,
        "speed_mps_max": vehicle.traction.speed_mps_max,
    }


def human_clock() -> HumanClock:
    """By the system's clock, in the local zone."""
    return HumanClock(unix_s=_unix_s, text=_time_of_day)


def _unix_s(time_ns: int) -> float:
    return (realtime_ns() - (monotonic_ns() - time_ns)) / NS_PER_S


def _time_of_day(time_ns: int) -> str:
    unix_s = _unix_s(time_ns)
    return f"{local_text(int(unix_s)).partition(' ')[2]}.{int(unix_s % 1 * 1000):03d}"
