"""`dbw convert`: a log in another format."""

from __future__ import annotations

from pathlib import Path

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.options import database_options
from dbw.record import setting_of


@click.command(
    epilog="""\b
Examples:
  dbw convert drive.log drive.mcap
  dbw convert drive.blf drive.log
  dbw convert drive.mcap drive.mf4"""
)
@click.argument("log", metavar="LOG", type=click.Path(path_type=Path))
@click.argument("out", metavar="OUT", type=click.Path(path_type=Path))
@database_options
def convert(log: Path, out: Path, dbc: tuple[str, ...], relaxed: bool) -> int:
    """Convert a log to another format, with what that cannot hold told.

    LOG is of candump (also .gz), ASC, BLF, TRC, MCAP of this program, or MF4. OUT is a new file;
    its ending says the format: .log (candump), .asc, .blf, .mcap or .mf4. What of LOG cannot be
    read, and what OUT cannot hold, is told on stderr with its number.
    """
    from telemetry.record.convert import convert_log
    from telemetry.record.formats import format_of

    kind = format_of(out)
    setting = setting_of(kind, dbc, relaxed=relaxed)
    done = convert_log(log, out, kind, setting)
    for line in done.problems:
        click.echo(f"dbw: {log}: {line}", err=True)
    if not done.frames and done.problems:
        raise UserMistake(f"{log}: no frame in it can be read")
    for line in done.losses:
        click.echo(f"dbw: {out}: {line}", err=True)
    click.echo(f"{done.frames} frames written to {out}")
    return EXIT_OK
