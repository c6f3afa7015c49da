"""Entry of the command line: the group, its help, and how errors reach the user."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

import click

from dbw.failures import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_USER,
    complain,
    is_user_mistake,
)

DISTRIBUTION = "can-by-wire"

COMMANDS = {
    "demo": ("dbw.demo", "Drive a road with the reference planner and draw what happened."),
    "up": ("dbw.stack", "Start all nodes and the car, each in a process of its own."),
    "ecu": ("dbw.stack", "Run a single node until Ctrl-C."),
    "down": ("dbw.stack", "Stop a stack that is up, brakes first."),
    "status": ("dbw.stack", "Tell what is up and what the bus says."),
    "monitor": ("dbw.monitor", "Watch a bus: candump's lines with their meaning, or a screen."),
    "record": ("dbw.record", "Record a bus: candump, ASC, BLF or MCAP."),
    "convert": ("dbw.convert", "Convert a log to another format, with what that cannot hold told."),
    "why": ("dbw.why", "Tell why a drive ended, or never began, from a log or live."),
    "decode": ("dbw.decode", "Decode a log: text, CSV or Parquet."),
    "plot": ("dbw.plot", "Draw signals of a log over time: a picture and a page."),
    "replay": ("dbw.replay", "Play a log once more: as lines, onto a bus, or through a node."),
    "dashboard": ("dbw.dashboard", "Show the car on a web page: watch, drive, brake."),
    "bytes": ("dbw.byte_planner", "Be the gateway of a planner that sends UWA's byte commands."),
    "campaign": ("dbw.campaign", "Drive thousands of simulated hours under faults and report."),
    "reproduce": ("dbw.reproduce", "Run the papers' experiments again and beside this stack."),
    "vehicle": ("dbw.vehicle", "Check a vehicle file: every problem with its line and range."),
    "calibrate": ("dbw.calibrate", "Measure the steering's zero, into the vehicle file."),
    "docs": ("dbw.docs", "Render a DBC to HTML: messages, layouts, timing, codes, nodes."),
    "vm": ("dbw.vm", "Run commands in a virtual machine that has SocketCAN."),
}
"""Command to its module, imported when it is used, and its line in the overview."""


class PlainGroup(click.Group):
    """A group that shows its help when called bare and names its commands when one is wrong."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As click's, but no arguments at all are a question, not a mistake."""
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help())
            ctx.exit()
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click's, but an unknown command's error names the known ones."""
        known = self.list_commands(ctx)
        if args and not args[0].startswith("-") and args[0] not in known:
            raise click.UsageError(f"no command {args[0]!r}: allowed {', '.join(known)}")
        return super().resolve_command(ctx, args)


class LazyGroup(PlainGroup):
    """A group that imports a command's module when the command is wanted, and not for `--help`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names, in the order in which a newcomer needs them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command, its module imported now; None for an unknown name."""
        if cmd_name not in COMMANDS:
            return None
        command = getattr(importlib.import_module(COMMANDS[cmd_name][0]), cmd_name)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The overview, without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version  # as slow as all of click

    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError:
        return "(not installed)"


def _print_version(ctx: click.Context, parameter: click.Parameter, is_wanted: bool) -> None:
    if is_wanted and not ctx.resilient_parsing:
        click.echo(f"dbw {_version()}")
        ctx.exit()


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and exit.",
)
def cli() -> None:
    """Drive-by-wire on CAN: a stack of ECUs, a car to try it on, a planner to drive it.

    Exit codes: 0 done, 1 the drive or the stack failed, 2 a mistake in what was asked for,
    130 interrupted.

    \b
    Example:
      dbw demo
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        arguments: Without the program's name; None for those of this process.

    Returns:
        The exit code.
    """
    try:
        given = sys.argv[1:] if arguments is None else list(arguments)
        result = cli.main(given, prog_name="dbw", standalone_mode=False)
    except click.ClickException as error:
        complain(error.format_message())
        return EXIT_USER
    except (KeyboardInterrupt, click.Abort):
        sys.stderr.write("dbw: interrupted\n")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()  # `dbw status | head`: nobody reads any more
        return EXIT_FAILED
    except Exception as error:
        if not is_user_mistake(error):
            raise
        complain(error)
        return EXIT_USER
    return result if isinstance(result, int) else EXIT_OK
