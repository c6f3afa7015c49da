"""`dbw replay`: a recorded drive once more."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.monitor import COUNT_MAX, STAMPS, catalogue_of
from dbw.options import (
    STANDARD_INPUT,
    WholeNumber,
    bitrate_option,
    bus_options,
    database_options,
    interface_option,
    name_options,
    span_options,
    vehicle_option,
)

if TYPE_CHECKING:
    from telemetry.logs.frames import FrameColumns
    from telemetry.replay.source import Source

MAX: Final = "max"
SPEED_MIN, SPEED_MAX = 0.001, 1000.0
NS_PER_S: Final = 1_000_000_000


class Speed(click.ParamType[float]):
    """How many times as fast as recorded; `max` is without waiting."""

    name = "speed"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The factor; infinite for `max`. Fails as click does."""
        if value == MAX:
            return math.inf
        try:
            speed = float(value)
        except ValueError:
            speed = math.nan
        if not SPEED_MIN <= speed <= SPEED_MAX:
            self.fail(f"{value!r}: a number from {SPEED_MIN} to {SPEED_MAX:g} is wanted, or {MAX}")
        return speed


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """The command line of `dbw replay`."""

    log: str
    buses: tuple[str, ...]
    onto: tuple[str, ...]
    interface: str
    bitrate_bps: int | None
    fd: bool
    force: bool
    speed: float
    loops: int
    gap_s: float | None
    step: bool
    from_s: float
    to_s: float
    dbc: tuple[str, ...]
    relaxed: bool
    messages: tuple[str, ...]
    nodes: tuple[str, ...]
    stamp: str
    through: str | None
    channel: str
    harness_channel: str
    vehicle: str


@click.command(
    epilog="""\b
Examples:
  dbw replay drive.log                                 # as dbw monitor showed it
  dbw replay drive.log vcan0,180:780 --speed 0.1 --from 12 --to 14
  dbw replay drive.log --onto vcan0                    # sent, for whoever listens there
  dbw replay drive.log --onto can0=vcan0 --onto can1=vcan1 --loop 0
  dbw replay drive.log --step --message SteerStatus
  dbw replay drive.log --through supervisor            # the node's code on its recorded inputs"""
)
@click.argument("log", metavar="LOG|-")
@click.argument("buses", nargs=-1, metavar="[CHANNEL[,FILTER]...]...")
@click.option(
    "--onto",
    multiple=True,
    metavar="[CHANNEL=]CHANNEL",
    help="Send the frames onto a bus, those of one channel of the log or all.",
)
@interface_option
@bitrate_option
@click.option("--fd", is_flag=True, help="Open the bus for CAN FD.")
@click.option("--force", is_flag=True, help="Send identifiers that the bus has already, too.")
@click.option(
    "--speed",
    type=Speed(),
    default=1.0,
    show_default=True,
    metavar=f"FACTOR|{MAX}",
    help="Times as fast as recorded.",
)
@click.option(
    "--loop",
    "loops",
    type=WholeNumber(0, COUNT_MAX),
    default=1,
    show_default=True,
    help="So many times; 0 until Ctrl-C.",
)
@click.option(
    "--max-gap",
    "gap_s",
    type=click.FloatRange(min=0.0),
    metavar="S",
    help="Cut longer silences to this.",
)
@click.option("--step", is_flag=True, help="Wait for Enter; a number and Enter: so many frames.")
@span_options
@database_options
@name_options
@click.option(
    "-t",
    "--time",
    "stamp",
    type=click.Choice(STAMPS),
    default="z",
    show_default=True,
    help="As of dbw monitor.",
)
@click.option(
    "--through",
    metavar="NODE",
    help="Feed a node's recorded inputs to its code, and compare what it sends with the record.",
)
@bus_options
@vehicle_option
def replay(**given: Any) -> int:
    """Play a log once more: as lines, onto a bus, or through a node.

    LOG is of any format that dbw decode reads; - is candump's text on standard input. Channels and
    their filters are those of dbw monitor. Nothing is sent without --onto, and no identifier that
    somebody else sends there already.

    --through needs a log of both the vehicle bus (--channel) and the harness (--harness-channel),
    from the node's start on. Ends with 1 if the node does not do what the record says.
    """
    return run_replay(ReplayOptions(**given))


def run_replay(options: ReplayOptions) -> int:
    """Replays; answers the exit code.

    Raises:
        LogError, DatabaseError, FilterError, BusError, ReplayError, UserMistake: What the user can
            put right; nothing is sent then.
    """
    from dbw.demo import interrupt_on_sigterm

    _check_combination(options)
    chunks = _reader(options)
    if options.through is not None:
        from dbw.replay_node import run_through

        return run_through(options, chunks)
    from dbw.replay_play import play

    with interrupt_on_sigterm():
        play(options, _source(options, chunks))
    return EXIT_OK


def _check_combination(options: ReplayOptions) -> None:
    if options.step and options.log == STANDARD_INPUT:
        raise UserMistake("--step reads standard input, so the log must be a file")
    others = {
        "--onto": options.onto,
        "--step": options.step,
        "--loop": options.loops != 1,
        "a channel": options.buses,
    }
    wrong = next((name for name, is_given in others.items() if is_given), None)
    if options.through is not None and wrong:
        raise UserMistake(f"--through and {wrong}: a node is fed the whole record, once")


def _reader(options: ReplayOptions) -> Callable[[], Iterator[FrameColumns]]:
    """Reads the log from its beginning; what could not be read is told the first time."""
    from dbw.reading import open_log

    is_told = False

    def read() -> Iterator[FrameColumns]:
        nonlocal is_told
        log = open_log(options.log)
        yield from log.between(options.from_s, options.to_s)
        if not is_told:
            for line in log.problems.lines():
                click.echo(f"dbw: {options.log}: {line}", err=True)
        is_told = True

    if options.log != STANDARD_INPUT:
        open_log(options.log)  # a file that cannot be opened is told before a bus is
        return read
    kept: list[FrameColumns] = []

    def read_once() -> Iterator[FrameColumns]:
        if not kept:
            kept.extend(read())
        return iter(kept)

    return read_once


def _source(options: ReplayOptions, chunks: Callable[[], Iterator[FrameColumns]]) -> Source:
    from telemetry.monitor.filters import Source as Channel
    from telemetry.monitor.selection import select
    from telemetry.replay.source import Source

    catalogue = catalogue_of(options.dbc, relaxed=options.relaxed)
    selection = select(
        catalogue,
        [Channel.parse(text) for text in options.buses],
        messages=options.messages,
        nodes=options.nodes,
    )
    return Source(chunks=chunks, selection=selection, catalogue=catalogue)
