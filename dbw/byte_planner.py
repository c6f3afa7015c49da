"""`dbw bytes`: a gateway for a planner that sends UWA's byte commands on the bus."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.options import VIRTUAL, channel_option, interface_option, vehicle_option

if TYPE_CHECKING:
    from vehicles import Vehicle


@click.command(
    epilog="""\b
Examples:
  dbw bytes --channel vcan0 --vehicle fsae_electric
  cansend vcan0 412#0A    steer 10 of 127 to the left; 410 brakes, 411 accelerates""",
)
@interface_option
@channel_option
@vehicle_option
@click.option(
    "--period",
    "period_s",
    type=float,
    default=0.05,
    show_default=True,
    metavar="S",
    help="How often the planner promises all three commands.",
)
def bytes(interface: str, channel: str, vehicle: str, period_s: float) -> int:
    """Be the gateway of a planner that sends Brake, Accelerate and Steer as bytes.

    Every command comes back as an echo, and BYTE_ERRORS tells the codes in force
    (dbc/byte_commands.dbc). The car needs the button, then all three with Accelerate 0; a planner
    that leaves one away brakes it. The commands are unprotected: whoever can send them drives.
    """
    from runtime.stopping import StopRequest
    from vehicles import load_vehicle

    if interface == VIRTUAL:
        raise UserMistake("a virtual bus lives inside one process: no car and no planner is there")
    with StopRequest() as stop:
        serve_bus(interface, channel, load_vehicle(vehicle), period_s, stop.is_set)
    return EXIT_OK


def serve_bus(
    interface: str,
    channel: str,
    vehicle: Vehicle,
    period_s: float,
    is_stopped: Callable[[], bool],
) -> None:
    """Runs the adapter beside a gateway of its own until it is to stop; a driving car stops first.

    Raises:
        CommandError: The period, or the vehicle's range for foreign nodes.
        UserMistake: Another gateway is there: an identifier has one sender.
        BusError: The bus cannot be opened.
        LinkFailed: The gateway has ended.
    """
    from canbus.node import PERIOD_NS
    from canbus.python_can_bus import PythonCanBus
    from dbw.listening import gateway_is_heard, listener_of
    from gateway.adapters.byte_commands import COMMAND_IDS, ByteCommands, serve
    from gateway.commands import checked_period_ns
    from gateway.connect import connect
    from runtime.clock import monotonic_ns, realtime_ns
    from runtime.realtime import keep_collections_short
    from telemetry.monitor.filters import Source

    commands = ByteCommands(vehicle, checked_period_ns(vehicle, period_s))
    if gateway_is_heard(listener_of(interface, [Source(channel=channel)], None)):
        raise UserMistake(f"another gateway is on {channel}, and a bus has one")
    bus = PythonCanBus(
        interface, channel, clock=monotonic_ns, realtime=realtime_ns,
        acceptance=commands.acceptance,
    )  # fmt: skip
    keep_collections_short()  # a full one would silence the gateway: the car would brake
    with connect(interface, channel, vehicle=vehicle, planner_period_s=period_s) as car, bus:
        names = ", ".join(f"0x{can_id:03X} {name}" for can_id, name in COMMAND_IDS.items())
        click.echo(f"byte commands on {channel} for {vehicle.name}: {names}; stop with Ctrl-C")
        told = ""
        while not is_stopped():
            received = bus.receive(PERIOD_NS)
            refusal = serve(commands, car, monotonic_ns(), received, bus.send)
            if refusal and refusal != told:
                click.echo(f"not engaged: {refusal}")
            told = refusal or told
