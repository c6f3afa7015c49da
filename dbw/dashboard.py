"""`dbw dashboard`: the car as a web page."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.options import (
    VIRTUAL,
    BusName,
    WholeNumber,
    bitrate_option,
    channel_option,
    check_two_buses,
    interface_option,
    vehicle_option,
)

if TYPE_CHECKING:
    from dbw.dashboard_server import Dashboard, Setup

PORT_MAX = 65_535
DEFAULT_PORT = 8420
FOXGLOVE_PORT = 8765
"""Foxglove's own default."""
DEFAULT_HOST = "127.0.0.1"
DESK_CHANNEL = "desk"


@click.command(
    epilog="""\b
Examples:
  dbw dashboard --desk                                       # a whole car, driven by the page
  dbw dashboard --channel can0                               # watches; may call the emergency brake
  dbw dashboard --channel vcan0 --harness-channel vcan1      # beside dbw up: button and pedals too
  dbw dashboard --channel vcan0 --harness-channel vcan1 --gateway
  dbw dashboard --channel can0 --host 0.0.0.0 --token-file token.txt"""
)
@interface_option
@channel_option
@bitrate_option
@vehicle_option
@click.option(
    "--harness-channel",
    type=BusName(),
    default=None,
    help="Of a simulated car: the page is its driver too, with button, pedals and hands.",
)
@click.option(
    "--gateway",
    is_flag=True,
    help="Be the planner's side: engage, disengage, reset, and drive by the page. Never beside a "
    "planner.",
)
@click.option(
    "--desk", is_flag=True, help="Start a whole simulated car in this process, and all of it."
)
@click.option(
    "--host",
    default=DEFAULT_HOST,
    show_default=True,
    metavar="ADDRESS",
    help="Address to listen on; 0.0.0.0 for all, whoever reaches it may watch.",
)
@click.option(
    "--port",
    type=WholeNumber(0, PORT_MAX),
    default=DEFAULT_PORT,
    show_default=True,
    help="0 takes a free one.",
)
@click.option(
    "--name",
    "names",
    multiple=True,
    metavar="HOST",
    help="A name of this machine by which browsers reach it, beside localhost and addresses.",
)
@click.option(
    "--token-file",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help="Keeps the token of the controls from one start to the next; made if it is not there.  "
    "[default: a new token at each start]",
)
@click.option(
    "--foxglove",
    "foxglove_port",
    type=WholeNumber(0, PORT_MAX),
    is_flag=False,
    flag_value=str(FOXGLOVE_PORT),
    default=None,
    metavar="[PORT]",
    help=f"Every message as a channel for Foxglove, to be opened there as ws://localhost:PORT.  "
    f"[port: {FOXGLOVE_PORT}]",
)
def dashboard(
    interface: str,
    channel: str,
    bitrate_bps: int | None,
    vehicle: str,
    harness_channel: str | None,
    gateway: bool,
    desk: bool,
    host: str,
    port: int,
    names: tuple[str, ...],
    token_file: Path | None,
    foxglove_port: int | None,
) -> int:
    """Show the car on a web page, and drive it where that is possible.

    Anybody who reaches the page may watch. Controls need the token, which is in the address that
    is printed. On any bus the page may call for an emergency brake; what else it may do depends on
    what it stands beside: --harness-channel, --gateway, --desk.
    """
    require_server()
    from dbw.dashboard_server import Setup, open_dashboard
    from dbw.listening import gateway_is_heard
    from runtime.in_process import harness_channel_of
    from runtime.launch import InProcessStack
    from runtime.realtime import RealtimeSettings, apply_realtime, keep_collections_short
    from runtime.stopping import StopRequest
    from telemetry.dashboard.access import Access
    from vehicles import load_vehicle

    if desk:
        if harness_channel is not None or gateway:
            raise UserMistake("--desk brings its own harness and gateway: leave those options away")
        interface, channel = VIRTUAL, DESK_CHANNEL
        harness_channel = harness_channel_of(DESK_CHANNEL)
        gateway = True
    elif interface == VIRTUAL:
        raise UserMistake(
            "a virtual bus lives inside one process: use --desk, or dbw demo --realtime --dashboard"
        )
    if harness_channel is not None:
        check_two_buses(channel, harness_channel)
    setup = Setup(
        interface=interface,
        channel=channel,
        bitrate_bps=bitrate_bps,
        vehicle=load_vehicle(vehicle),
        harness_channel=harness_channel,
        with_gateway=gateway,
        host=host,
        port=port,
        access=Access(read_token(token_file), frozenset(names)),
        foxglove_port=foxglove_port,
    )
    if gateway and not desk and gateway_is_heard(setup.listener()):
        raise UserMistake(
            f"--gateway: another gateway is on {channel}, and a bus has one: leave it away to watch"
        )
    keep_collections_short()  # a full one would silence the gateway: the car would brake
    with StopRequest() as stop, ExitStack() as stack:
        if desk:
            stack.enter_context(InProcessStack(vehicle=setup.vehicle, channel=channel))
            apply_realtime(RealtimeSettings())  # what its threads wait for must not be put off
        running = stack.enter_context(open_dashboard(setup))
        announce(setup, running)
        click.echo("stop with Ctrl-C")
        running.serve(stop.is_set)
    return EXIT_OK


def require_server() -> None:
    """Says what to install where the web server is missing."""
    try:
        import tornado  # noqa: F401
    except ImportError as error:
        raise UserMistake("the page needs tornado: pip install can-by-wire[dashboard]") from error


def announce(setup: Setup, running: Dashboard) -> None:
    """Tells where the page is; the token is shown here alone."""
    from telemetry.dashboard.access import is_loopback

    host = "localhost" if is_loopback(setup.host) else setup.host
    host = f"[{host}]" if ":" in host else host
    click.echo(f"dashboard of {setup.interface} {setup.channel}: http://{host}:{running.port}/")
    click.echo(f"with controls: http://{host}:{running.port}/#token={setup.access.token}")
    if running.foxglove is not None:
        click.echo(f"Foxglove: ws://{host}:{running.foxglove.port}")
    if not is_loopback(setup.host):
        click.echo(
            "dbw: whoever reaches this address may watch, and the token travels unencrypted: keep "
            "to a network of your own, or put a proxy with TLS before it",
            err=True,
        )


def read_token(path: Path | None) -> str:
    """The token of a file, which is made if it is not there; a new one without a file.

    Raises:
        UserMistake: It cannot be read or written, or is too short.
    """
    import os

    from telemetry.dashboard.access import TOKEN_LENGTH_MIN, new_token

    if path is None:
        return new_token()
    try:
        if path.exists():
            token = path.read_text(encoding="ascii").strip()
        else:
            token = new_token()
            number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(number, "w", encoding="ascii") as file:
                file.write(f"{token}\n")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is no text in ASCII"
        raise UserMistake(f"--token-file {path}: {reason}") from error
    if len(token) < TOKEN_LENGTH_MIN or not token.isprintable() or " " in token:
        raise UserMistake(
            f"--token-file {path}: one line of at least {TOKEN_LENGTH_MIN} characters is wanted"
        )
    return token
