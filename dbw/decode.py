"""`dbw decode`: a log as text, or as a table for each message."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.options import database_options, name_options, signal_option, span_options
from dbw.reading import open_log, signals_of

if TYPE_CHECKING:
    from telemetry.databases import Databases
    from telemetry.decode.tables import Decoder
    from telemetry.logs.reading import Log


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodeOptions:
    """The command line of `dbw decode`."""

    log: str
    dbc: tuple[str, ...]
    relaxed: bool
    messages: tuple[str, ...]
    signals: tuple[str, ...]
    nodes: tuple[str, ...]
    from_s: float
    to_s: float
    csv: Path | None
    parquet: Path | None


@click.command(
    epilog="""\b
Examples:
  dbw decode drive.log | less
  dbw decode drive.log --message SteerStatus --from 10 --to 12
  candump -L can0 | dbw decode - --dbc other.dbc
  dbw decode drive.log --parquet out/tables"""
)
@click.argument("log", metavar="LOG|-")
@database_options
@name_options
@signal_option
@span_options
@click.option(
    "--csv", type=click.Path(path_type=Path), metavar="FOLDER", help="A CSV for each message."
)
@click.option(
    "--parquet", type=click.Path(path_type=Path), metavar="FOLDER",
    help="A Parquet file for each message.",
)  # fmt: skip
def decode(**given: object) -> int:
    """Decode a log: text on standard output, CSV or Parquet.

    LOG is of candump (`-L`, also .gz), ASC, BLF, TRC, MCAP of dbw record, or MF4; - is candump's
    text on standard input. A frame is a line or a row: nothing is interpolated. Frames that are in
    no DBC stay, as they are; what could not be read is told on stderr.
    """
    options = DecodeOptions(**given)  # type: ignore[arg-type]
    if options.csv and options.parquet:
        raise UserMistake("--csv and --parquet: one of them is wanted")
    return run_decode(options)


def run_decode(options: DecodeOptions) -> int:
    """Decodes; answers the exit code.

    Raises:
        LogError, DatabaseError, UserMistake: What the user can put right.
    """
    from telemetry.databases import load_databases

    databases = load_databases(options.dbc, relaxed=options.relaxed)
    for note in databases.notes:
        click.echo(f"dbw: {note}", err=True)
    decoder, is_all = _decoder(databases, options)
    log = open_log(options.log)
    if options.csv or options.parquet:
        _write_tables(log, decoder, options)
    else:
        _write_lines(log, decoder, options, with_others=is_all)
    for line in log.problems.lines():
        click.echo(f"dbw: {options.log}: {line}", err=True)
    return EXIT_OK


def _decoder(databases: Databases, options: DecodeOptions) -> tuple[Decoder, bool]:
    """What reads the wanted messages, and whether that is all of them."""
    from telemetry.decode.tables import Decoder

    only = [databases.named(name) for name in options.messages]
    for node in options.nodes:
        only += databases.of_node(node)
    chosen = signals_of(databases, options.signals)
    only += [databases.named(message) for message, _ in chosen]
    signals = {name for _, name in chosen}
    return Decoder(databases, only, signals), not only


def _write_lines(
    log: Log, decoder: Decoder, options: DecodeOptions, *, with_others: bool
) -> None:
    from telemetry.decode.lines import lines_of

    wrong: dict[str, int] = {}
    for chunk in log.between(options.from_s, options.to_s):
        decoded = decoder.decode(chunk)
        for name, count in decoded.wrong_lengths.items():
            wrong[name] = wrong.get(name, 0) + count
        lines = lines_of(decoded, with_others=with_others)
        if lines:
            sys.stdout.write("\n".join(lines) + "\n")
            sys.stdout.flush()
    _tell_lengths(wrong)


def _write_tables(log: Log, decoder: Decoder, options: DecodeOptions) -> None:
    try:
        import pyarrow  # noqa: F401
    except ModuleNotFoundError as error:
        raise UserMistake(
            "--csv and --parquet need pyarrow: pip install can-by-wire[logs]"
        ) from error
    from telemetry.decode.export import write_csv, write_parquet
    from telemetry.folder import ResultFolder
    from telemetry.logs.frames import joined

    decoded = decoder.decode(joined(list(log.between(options.from_s, options.to_s))))
    destination = options.csv or options.parquet
    assert destination is not None
    write = write_csv if options.csv else write_parquet
    with ResultFolder(destination) as folder:
        files = write(decoded, folder.path)
        folder.commit()
    rows = sum(len(table.rows) for table in decoded.tables.values())
    click.echo(f"written to {destination}/: {len(files)} files, {rows} rows")
    if decoded.unknown:
        click.echo(f"dbw: {decoded.unknown} frames are in no DBC", err=True)
    _tell_lengths(decoded.wrong_lengths)


def _tell_lengths(wrong: dict[str, int]) -> None:
    for name, count in sorted(wrong.items()):
        click.echo(f"dbw: {count} frames of {name} have another length than the DBC says", err=True)
