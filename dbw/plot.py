"""`dbw plot`: signals of a log over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.options import database_options, signal_option, span_options

if TYPE_CHECKING:
    from telemetry.databases import Databases
    from telemetry.decode.tables import Decoded
    from telemetry.logs.reading import Log

PNG: Final = "plot.png"
HTML: Final = "plot.html"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlotOptions:
    """The command line of `dbw plot`."""

    log: str
    signals: tuple[str, ...]
    out: Path
    from_s: float
    to_s: float
    dbc: tuple[str, ...]
    relaxed: bool


@click.command(
    epilog="""\b
Examples:
  dbw plot out/demo/drive.log -s SteerStatus.steering_wheel_angle_rad
  dbw plot drive.log -s SteerDriver.torque_nm -s SupervisorState.inhibit --from 10 --to 12
  dbw plot drive.blf --dbc other.dbc -s Engine.rpm --out out/engine"""
)
@click.argument("log", metavar="LOG|-")
@signal_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/plot"),
    show_default=True,
    metavar="FOLDER",
    help=f"Folder for {PNG} and {HTML}.",
)
@span_options
@database_options
def plot(**given: object) -> int:
    """Draw signals of a log: a picture, and a page to look closer.

    LOG is of any format that dbw decode reads. Signals of one unit share a panel, a value holds
    until the next frame, a silence is a gap. Below are the driving modes and the error codes, if
    the log has them. Frames whose CRC is wrong are left out and told.
    """
    options = PlotOptions(**given)  # type: ignore[arg-type]
    if not options.signals:
        raise UserMistake("-s is missing: MESSAGE.SIGNAL of what is to be drawn")
    return run_plot(options)


def run_plot(options: PlotOptions) -> int:
    """Draws; answers the exit code.

    Raises:
        LogError, DatabaseError, FolderError, UserMistake: What the user can put right.
    """
    from dbw.reading import open_log, signals_of
    from telemetry.databases import load_databases
    from telemetry.folder import ResultFolder
    from telemetry.plot.model import plot_of
    from telemetry.plot.page import write_page
    from telemetry.plot.png import write_png

    databases = load_databases(options.dbc, relaxed=options.relaxed)
    for note in databases.notes:
        click.echo(f"dbw: {note}", err=True)
    signals = signals_of(databases, options.signals)
    log = open_log(options.log)
    decoded = _decoded(options, databases, signals, log)
    for line in log.problems.lines():
        click.echo(f"dbw: {options.log}: {line}", err=True)
    missing = sorted({message for message, _ in signals} - set(decoded.tables))
    if len(missing) == len({message for message, _ in signals}):
        raise UserMistake(f"{options.log} has no frame of {', '.join(missing)} in that time")
    if missing:
        click.echo(f"dbw: no frame of {', '.join(missing)}", err=True)
    result = plot_of(decoded, signals, title=Path(options.log).name, zero_ns=log.zero_ns)
    if result.left_out:
        click.echo(f"dbw: {result.left_out} frames with a wrong CRC are left out", err=True)
    with ResultFolder(options.out) as folder:
        write_png(folder.path / PNG, result)
        write_page(folder.path / HTML, result)
        files = folder.commit()
    click.echo(f"written to {options.out}/: {', '.join(file.name for file in files)}")
    return EXIT_OK


def _decoded(
    options: PlotOptions, databases: Databases, signals: list[tuple[str, str]], log: Log
) -> Decoded:
    """The messages that are drawn, and on the project's own bus those with modes and codes."""
    from telemetry.decode.tables import Decoder
    from telemetry.logs.frames import joined
    from telemetry.plot.model import BAND_SIGNALS, BAND_SOURCES

    only = [databases.named(message) for message, _ in signals]
    only += [m for m in databases.messages if m.name in BAND_SOURCES and databases.is_own(m)]
    decoder = Decoder(databases, only, {*(name for _, name in signals), *BAND_SIGNALS})
    return decoder.decode(joined(list(log.between(options.from_s, options.to_s))))
