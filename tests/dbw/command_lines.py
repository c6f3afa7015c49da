"""Command lines as people read them, parsed as `dbw` would and not run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click

from dbw.main import cli

LINE = re.compile(
    r"^ *((?:sudo -u \w+ )?(?:[A-Z_]+=\S+ )?(?:\S*/)?dbw [a-z](?:[^\n\\]|\\\n)*)", re.MULTILINE
)
BLOCK = re.compile(r"^( *)```sh\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:^    [^\n]+\n)+", re.MULTILINE)


def in_blocks(text: str) -> list[str]:
    """Every `dbw` line of a page's code blocks, without comments and what it is piped into."""
    blocks = [block for _, block in BLOCK.findall(text)] + INDENTED.findall(text)
    return [line for block in blocks for line in LINE.findall(block)]


def options(line: str) -> dict[str, object]:
    """What the command line makes of `dbw COMMAND ...`; nothing is started.

    Raises:
        click.UsageError: It is no command line of ours.
    """
    words = shlex.split(line.replace("\\\n", " "), comments=True)
    place = next(n for n, word in enumerate(words) if Path(word).name == "dbw" and "=" not in word
                 and words[n - 1] != "-u")
    arguments = words[place + 1 :]
    for mark in ("|", ">", "&", "&&"):
        if mark in arguments:
            arguments = arguments[: arguments.index(mark)]
    context = click.Context(cli)
    command: click.Command = cli
    with context:
        while isinstance(command, click.Group):
            name, *arguments = arguments
            found = command.get_command(context, name)
            assert found is not None, f"no command {name}"
            command = found
        return command.make_context(command.name, arguments, parent=context).params
