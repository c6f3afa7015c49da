"""`dbw monitor`: candump for this bus."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.listening import channels_of, listener_of, sources_of
from dbw.options import (
    WholeNumber,
    bitrate_option,
    database_options,
    interface_option,
    name_options,
    vehicle_option,
)

if TYPE_CHECKING:
    from telemetry.monitor.known import Catalogue
    from telemetry.monitor.meaning import Interpreter
    from telemetry.monitor.selection import Selection

COUNT_MAX: Final = 2**63 - 1
TIMEOUT_MS_MAX: Final = 86_400_000
STAMPS: Final = ("a", "d", "z", "A", "n")


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorOptions:
    """The command line of `dbw monitor`."""

    buses: tuple[str, ...]
    interface: str
    bitrate_bps: int | None
    vehicle: str
    stamp: str
    as_log: bool
    with_meaning: bool
    colour: str
    count: int | None
    timeout_ms: int | None
    dbc: tuple[str, ...]
    relaxed: bool
    canopen: bool | None
    messages: tuple[str, ...]
    signals: tuple[str, ...]
    nodes: tuple[str, ...]
    log: str | None
    live: bool


@click.command(
    epilog="""\b
Examples:
  dbw monitor vcan0
  dbw monitor -ta can0,180:780 can1
  dbw monitor --node Steering --signal SUPERVISOR_STATE.mode
  dbw monitor --live vcan0
  dbw monitor -L any | tee drive.log
  dbw monitor -tz --log drive.log --dbc other.dbc --relaxed

\b
Filters, as candump's, in hexadecimal (eight digits for 29-bit identifiers):
  ID:MASK  frames whose identifier fits      #MASK  only these classes of error frames
  ID~MASK  all others                        j      frames that all filters pass, not any"""
)
@click.argument("buses", nargs=-1, metavar="[CHANNEL[,FILTER]...]...")
@interface_option
@bitrate_option
@vehicle_option
@click.option(
    "-t",
    "--time",
    "stamp",
    type=click.Choice(STAMPS),
    default="n",
    show_default=True,
    help="Absolute, delta, since the first frame (z), Absolute with date, none.",
)
@click.option("-L", "as_log", is_flag=True, help="As candump -L: a log that its tools read.")
@click.option("--raw", is_flag=True, help="candump's columns alone, without meaning.")
@click.option(
    "--color",
    "colour",
    type=click.Choice(["auto", "always", "never"]),
    default="auto",
    show_default=True,
    help="auto: on terminals, unless NO_COLOR is set.",
)
@click.option("-n", "count", type=WholeNumber(1, COUNT_MAX), help="End after so many lines.")
@click.option(
    "-T",
    "timeout_ms",
    type=WholeNumber(1, TIMEOUT_MS_MAX),
    help="End after so many ms without a frame.",
)
@database_options
@click.option(
    "--canopen/--no-canopen",
    default=None,
    help="CANopen's frames in words.  [default: on this project's bus]",
)
@name_options
@click.option(
    "--signal",
    "signals",
    multiple=True,
    metavar="[MESSAGE.]NAME",
    help="Only these signals, and messages that carry them.",
)
@click.option(
    "--log", metavar="FILE|-", help="Read a log of any format; - is candump's text on stdin."
)
@click.option("--live", is_flag=True, help="A screen with a row per message; h shows its keys.")
def monitor(raw: bool, **given: Any) -> int:
    """Watch a bus: candump's lines with their meaning, or a screen.

    CHANNEL is an interface such as vcan0 (the default), or any; several are watched at once. Each
    frame is shown with its message, whether counter and CRC are right, and its signals. Sends
    nothing. What is lost because it was not read in time is told on stderr.
    """
    options = MonitorOptions(with_meaning=not raw, **given)
    return run_monitor(options)


def run_monitor(options: MonitorOptions) -> int:
    """Watches until the end; answers the exit code.

    Raises:
        UserMistake, FilterError, DatabaseError, BusError: What the user can put right; nothing is
            shown then.
    """
    from dbw.demo import interrupt_on_sigterm
    from telemetry.monitor.meaning import Interpreter
    from telemetry.monitor.selection import select
    from vehicles import load_vehicle

    sources = sources_of(options.buses)
    _check_combination(options)
    catalogue = catalogue_of(options.dbc, relaxed=options.relaxed)
    vehicle = load_vehicle(options.vehicle)
    drives = {} if vehicle.drives is None else vehicle.drives.names
    interpreter = Interpreter(catalogue, canopen=options.canopen, drives=drives)
    selection = select(
        catalogue,
        sources,
        messages=options.messages,
        signals=options.signals,
        nodes=options.nodes,
    )
    with interrupt_on_sigterm():
        if options.live:
            from dbw.monitor_screen import run_screen

            return run_screen(
                listener=listener_of(options.interface, sources, options.bitrate_bps),
                interpreter=interpreter,
                selection=selection,
                channels=channels_of(sources),
                bitrate_bps=options.bitrate_bps or round(vehicle.bus.bitrate_bps),
                with_colours=wants_colours(options.colour),
            )
        return _write_lines(options, interpreter, selection)


def _check_combination(options: MonitorOptions) -> None:
    plain_only = {
        "-L": options.as_log,
        "--raw": not options.with_meaning,
        "--log": options.log is not None,
        "-n": options.count is not None,
        "-T": options.timeout_ms is not None,
    }
    wrong = next((name for name, is_given in plain_only.items() if is_given), None)
    if options.live and wrong:
        raise UserMistake(f"--live and {wrong}: the screen shows a bus and keeps no lines")
    if options.live and not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UserMistake("--live needs a terminal: leave it away to write lines into a file")


def catalogue_of(dbc: Sequence[str], *, relaxed: bool) -> Catalogue:
    """What is known of the bus; cantools is imported only for a DBC that is given."""
    from telemetry.monitor.known import Catalogue

    if not dbc:
        return Catalogue()
    from telemetry.databases import load_databases

    databases = load_databases(dbc, relaxed=relaxed)
    for note in databases.notes:
        click.echo(f"dbw: {note}", err=True)
    return Catalogue(databases)


def wants_colours(colour: str) -> bool:
    """Whether `auto`, `always` or `never` means colours here."""
    if colour == "auto":
        return sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    return colour == "always"


def _write_lines(
    options: MonitorOptions, interpreter: Interpreter, selection: Selection
) -> int:
    from dbw.monitor_lines import LineOutput, write_bus, write_log
    from runtime.clock import local_text
    from telemetry.monitor.plain import LineWriter, Stamp, StampWriter

    output = LineOutput(
        writer=LineWriter(
            interpreter=interpreter,
            selection=selection,
            stamps=StampWriter(Stamp(options.stamp), local_text),
            channel_width=max((len(source.channel) for source in selection.sources), default=0),
            with_meaning=options.with_meaning,
            as_log=options.as_log,
        ),
        with_colours=wants_colours(options.colour),
        count=options.count,
    )
    if options.log is not None:
        write_log(output, options.log)
    else:
        with listener_of(options.interface, selection.sources, options.bitrate_bps) as listener:
            write_bus(output, listener, options.timeout_ms)
    return EXIT_OK
