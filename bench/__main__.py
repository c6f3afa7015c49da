"""`python -m bench [NAME...] [--quick]`: prints each measure's tables as markdown."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Protocol, cast

import click

from bench.table import Table
from dbw.demo import interrupt_on_sigterm

NAMES = (
    "codec", "speed", "demo", "reproduce", "lap", "emergency", "monitor", "dashboard", "record",
    "decode", "socketcan",
)  # fmt: skip
"""In this order: what times comes before what only computes."""

ONLY_BY_NAME = ("socketcan",)
"""Takes an hour or more where SocketCAN is emulated."""


class Result(Protocol):
    """What a measure answers."""

    def tables(self) -> list[Table]:
        """For printing."""
        ...


class Measure(Protocol):
    """A module of this package."""

    def measure(self, *, quick: bool = False) -> Result:
        """Does it."""
        ...


@click.command(
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  python -m bench
  python -m bench codec speed
  python -m bench emergency --quick""",
)
@click.argument("names", nargs=-1, type=click.Choice(NAMES), metavar="[NAME]...")
@click.option("--quick", is_flag=True, help="Tiny sizes: shows that it works, measures little.")
def main(names: tuple[str, ...], quick: bool) -> None:
    """Measure what the project claims and print markdown tables.

    NAME is one or more of codec, speed, demo, reproduce, lap, emergency, monitor, dashboard,
    record, decode, socketcan; without any, all but the last, which takes an hour or more in the
    virtual machine (`dbw vm`).
    """
    with interrupt_on_sigterm():  # workers end with their parent
        for name in names or [name for name in NAMES if name not in ONLY_BY_NAME]:
            click.echo(f"measuring {name} ...", err=True)
            measure = cast("Measure", import_module(f"bench.{name}"))
            for table in measure.measure(quick=quick).tables():
                click.echo(table.markdown())


if __name__ == "__main__":
    sys.exit(main())
