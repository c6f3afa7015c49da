"""`dbw docs`: a DBC as a page for people."""

from __future__ import annotations

from pathlib import Path

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.options import BITRATE_BPS_MAX, WholeNumber

EXTRA = frozenset({"jinja2"})


@click.command(
    epilog="""\b
Examples:
  dbw docs
  dbw docs my_car.dbc other.dbc --out out/bus
  dbw docs --relaxed foreign.dbc"""
)
@click.argument("dbc", nargs=-1, metavar="[FILE.dbc|vehicle|harness ...]")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/docs"),
    show_default=True,
    help="Folder that gets an HTML page for each file.",
)
@click.option(
    "--bitrate",
    "bitrate_bps",
    type=WholeNumber(1, BITRATE_BPS_MAX),
    default=None,
    metavar="BPS",
    help="For the timing.  [default: the file's, else 500000]",
)
@click.option(
    "--relaxed", is_flag=True, help="Leave out what cannot be read, and tell it on the page."
)
def docs(dbc: tuple[str, ...], out: Path, bitrate_bps: int | None, relaxed: bool) -> int:
    """Render a bus to HTML: messages, layout pictures, timing, codes, nodes.

    Without a file, the project's own two. Each page is one file that loads nothing from elsewhere.
    """
    try:
        from telemetry.bus_docs.page import page_of
    except ModuleNotFoundError as error:
        if error.name not in EXTRA:
            raise
        raise UserMistake(f"dbw docs needs {error.name}: pip install can-by-wire[demo]") from error
    from telemetry.bus_docs.model import document
    from telemetry.bus_docs.own import parameters, words
    from telemetry.databases import load_databases
    from telemetry.folder import ResultFolder

    names = dbc or ("vehicle", "harness")
    pages: dict[str, str] = {}
    for name in names:
        found = load_databases([name], relaxed=relaxed)
        (database,) = found.databases
        is_own = found.is_own(found.messages[0])
        bus = document(
            database, Path(name).name, bitrate_bps=bitrate_bps, notes=found.notes
        )
        file = f"{Path(name).name.removesuffix('.dbc')}.html"
        if file in pages:
            raise UserMistake(f"{name}: another file of this name would get the same page")
        pages[file] = page_of(bus, words(), parameters()) if is_own else page_of(bus)
    with ResultFolder(out) as folder:
        for file, text in pages.items():
            folder.path.joinpath(file).write_text(text, encoding="utf-8")
        folder.commit()
    click.echo(f"written to {out}/: {', '.join(pages)}")
    return EXIT_OK
