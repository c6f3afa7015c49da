"""Figures as markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

from bench.machine import this_machine


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """One table with what is needed to repeat it."""

    title: str
    command: str
    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()

    def markdown(self) -> str:
        """Title, command and machine, table, notes."""
        lines = [f"### {self.title}", "", f"`{self.command}` on {this_machine()}", ""]
        lines += [_row(self.headers), "|" + "---|" * len(self.headers)]
        lines += [_row(row) for row in self.rows]
        lines += chain.from_iterable(("", note) for note in self.notes)
        return "\n".join(lines) + "\n"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def met(is_met: bool) -> str:
    """Whether a goal was reached, in a word that is found by searching."""
    return "met" if is_met else "**MISSED**"


def command_line(name: str, *, quick: bool) -> str:
    """How to repeat a measure."""
    return f"python -m bench {name}" + " --quick" * quick
