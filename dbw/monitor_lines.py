"""The lines of `dbw monitor`: from a bus, or from a log."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from canbus.candump import parse_log_line
from canbus.heard import Heard
from dbw.failures import UserMistake
from dbw.options import STANDARD_INPUT
from runtime.clock import NS_PER_MS, monotonic_ns
from telemetry.logs.formats import CANDUMP, GZIP, format_of, head_of
from telemetry.monitor.style import coloured, plain_text

if TYPE_CHECKING:
    from canbus.listener import Listener
    from telemetry.monitor.plain import LineWriter

CHUNK_BYTES = 1 << 16
WAIT_NS = 500_000_000
"""How often a silent bus is asked for losses."""


class LineOutput:
    """Writes frames as lines to standard output: whole lines, at once, never more than asked for.

    Args:
        writer: Makes the lines.
        with_colours: Whether to colour them.
        count: Most lines to write; None for all.
    """

    def __init__(self, *, writer: LineWriter, with_colours: bool, count: int | None) -> None:
        self._writer = writer
        self._text = coloured if with_colours else plain_text
        self._left = sys.maxsize if count is None else count

    @property
    def is_done(self) -> bool:
        """Whether as many lines were written as were asked for."""
        return self._left <= 0

    def write(self, heard: Iterable[Heard]) -> None:
        """Writes what is to be shown of these frames."""
        lines: list[str] = []
        for item in heard:
            spans = self._writer.line(item)
            if spans is not None:
                lines.append(self._text(spans).rstrip() + "\n")
                if len(lines) >= self._left:
                    break
        self._left -= len(lines)
        if lines:
            sys.stdout.write("".join(lines))
            sys.stdout.flush()


def write_bus(output: LineOutput, listener: Listener, timeout_ms: int | None) -> None:
    """Writes what is heard, until as much was written as wanted, or after a silence."""
    lost = 0
    silent_since_ns = monotonic_ns()
    while not output.is_done:
        heard = listener.hear(WAIT_NS if timeout_ms is None else timeout_ms * NS_PER_MS)
        output.write(heard)
        now_ns = monotonic_ns()
        if heard:
            silent_since_ns = now_ns
        elif timeout_ms is not None and now_ns - silent_since_ns >= timeout_ms * NS_PER_MS:
            return
        if listener.lost != lost:
            new, lost = listener.lost - lost, listener.lost
            click.echo(f"dbw: {new} frames lost, not read in time ({lost} in all)", err=True)
        for note in listener.notes():
            click.echo(f"dbw: {note}", err=True)


def write_log(output: LineOutput, name: str) -> None:
    """Writes the frames of a log; what of it cannot be read is counted and told.

    Raises:
        UserMistake, LogError: The file cannot be read, or not one of its lines is a frame.
    """
    if name != STANDARD_INPUT and not _is_plain(name):
        _write_other_log(output, name)
        return
    number = frames = 0
    wrong: list[int] = []
    with _opened(name) as file:
        for lines in _lines(file):
            heard = []
            for line in lines:
                number += 1
                item = parse_log_line(line)
                if item is not None:
                    heard.append(item)
                elif line.strip():
                    wrong.append(number)
            frames += len(heard)
            output.write(heard)
            if output.is_done:
                return
    if wrong and not frames:
        raise UserMistake(f"{name}: no line is one of candump -L, as in (12.5) vcan0 123#11")
    if wrong:
        many = f"{len(wrong)} lines are no frames, the first is line {wrong[0]}"
        click.echo(f"dbw: {name}: {many}", err=True)


def _is_plain(name: str) -> bool:
    """Whether a log is candump's text, which is shown as soon as the first line is read."""
    if not Path(name).is_file():
        return True
    head = head_of(Path(name))
    return format_of(head) == CANDUMP and not head.startswith(GZIP)


def _write_other_log(output: LineOutput, name: str) -> None:
    from telemetry.logs.reading import Log

    log = Log(name)
    for chunk in log.chunks():
        output.write(frame.heard() for frame in chunk.frames())
        if output.is_done:
            return
    for line in log.problems.lines():
        click.echo(f"dbw: {name}: {line}", err=True)


@contextmanager
def _opened(name: str) -> Iterator[int]:
    """A file descriptor to read from."""
    if name == STANDARD_INPUT:
        yield sys.stdin.fileno()
        return
    try:
        with open(name, "rb", buffering=0) as file:
            yield file.fileno()
    except OSError as error:
        if error.filename is None:
            raise
        raise UserMistake(f"{name}: {error.strerror}") from error


def _lines(file: int) -> Iterator[list[str]]:
    """Lines as they come: what a slow pipe has written is not kept waiting for more."""
    rest = b""
    while chunk := os.read(file, CHUNK_BYTES):
        *lines, rest = (rest + chunk).split(b"\n")
        yield [line.decode("ascii", errors="replace") for line in lines]
    if rest:
        yield [rest.decode("ascii", errors="replace")]
