"""`dbw record`: what is on a bus, into a log."""

from __future__ import annotations

import gc
import select
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Final, Protocol

import click

from dbw.failures import EXIT_FAILED, EXIT_OK, UserMistake, complain
from dbw.listening import channels_of, listener_of, sources_of
from dbw.options import (
    ByteSize,
    WholeNumber,
    bitrate_option,
    database_options,
    interface_option,
)

if TYPE_CHECKING:
    from canbus.heard import Heard
    from canbus.listener import Listener
    from telemetry.monitor.selection import Selection
    from telemetry.record.formats import Format, Setting

SECONDS_MAX: Final = 366 * 86_400
FILES_MAX: Final = 9_999
WAIT_NS: Final = 100_000_000
"""How soon a signal or the end of the duration is seen on a silent bus."""
GATHER_S: Final = 0.005
"""Frames gather in the kernel's queue for so long, a tenth of what its default has room for on a
full bus: to wake up for each costs as much as to read it."""


class Recording(Protocol):
    """What takes the frames: `telemetry.record.recorder.Recorder`."""

    frames: int

    def add(self, frames: list[Heard], now_ns: int) -> None:
        """Takes what was heard."""
        ...

    def close(self, now_ns: int) -> None:
        """Completes the file."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordOptions:
    """The command line of `dbw record`."""

    buses: tuple[str, ...]
    interface: str
    bitrate_bps: int | None
    dbc: tuple[str, ...]
    relaxed: bool
    out: Path | None
    rotate_bytes: int | None
    rotate_s: int | None
    files_max: int | None
    duration_s: int | None


@click.command(
    epilog="""\b
Examples:
  dbw record vcan0
  dbw record can0 can1 --out drive.mcap --dbc can1=other.dbc
  dbw record can0,180:780 --out drive.log --rotate-size 100M --max-files 20"""
)
@click.argument("buses", nargs=-1, metavar="[CHANNEL[,FILTER]...]...")
@interface_option
@bitrate_option
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), metavar="FILE",
    help="A new file; the ending says the format: .log (candump), .asc, .blf or .mcap.  "
    "[default: dbw-DATE_TIME.log]",
)
@click.option(
    "--rotate-size", "rotate_bytes", type=ByteSize(), metavar="BYTES",
    help="Begin a new file when one is so large; k, M and G are thousands.",
)
@click.option(
    "--rotate-every", "rotate_s", type=WholeNumber(1, SECONDS_MAX), metavar="S",
    help="Begin a new file after so many seconds.",
)
@click.option(
    "--max-files", "files_max", type=WholeNumber(1, FILES_MAX), metavar="N",
    help="Keep the newest N files of this recording.",
)
@click.option(
    "--duration", "duration_s", type=WholeNumber(1, SECONDS_MAX), metavar="S",
    help="End after so many seconds.  [default: Ctrl-C]",
)
@database_options
def record(**given: object) -> int:
    """Record a bus: candump, ASC, BLF or MCAP.

    CHANNEL is an interface such as vcan0 (the default), or any, with filters as for dbw monitor.
    Sends nothing. Ctrl-C and SIGTERM end it well; kill -9 costs less than a second. In MCAP, for
    Foxglove, each message of the DBC is decoded as well. What is lost is told on stderr.
    """
    return run_record(RecordOptions(**given))  # type: ignore[arg-type]


def run_record(options: RecordOptions) -> int:
    """Records until it is stopped; answers the exit code.

    Raises:
        UserMistake, FormatError, FilterError, DatabaseError, BusError, RecordingError: What the
            user can put right; nothing is recorded then.
    """
    from runtime.clock import NS_PER_S, monotonic_ns
    from telemetry.monitor.selection import Selection
    from telemetry.record.formats import format_of
    from telemetry.record.recorder import Recorder, RecordingError, Rotation

    sources = sources_of(options.buses)
    out = options.out or _default_path()
    kind = format_of(out, is_live=True)
    rotation = Rotation(
        size_bytes=options.rotate_bytes,
        age_ns=None if options.rotate_s is None else options.rotate_s * NS_PER_S,
        files_max=options.files_max,
    )
    if rotation.files_max is not None and not rotation.is_wanted:
        raise UserMistake("--max-files without --rotate-size or --rotate-every: there is one file")
    setting = setting_of(kind, options.dbc, relaxed=options.relaxed)
    with (
        until_signal() as is_stopped,
        listener_of(options.interface, sources, options.bitrate_bps) as listener,
    ):
        recorder = Recorder(out, kind, setting, rotation, monotonic_ns())
        gc.freeze()  # what is there will stay
        click.echo(f"recording {', '.join(channels_of(sources))} to {recorder.paths[-1]}", err=True)
        try:
            selection = Selection(sources=tuple(sources))
            record_from(listener, recorder, selection, options.duration_s, is_stopped)
            code = EXIT_OK
        except RecordingError as error:
            complain(error)
            code = EXIT_FAILED
    for line in recorder.losses.lines(setting.numbers):
        click.echo(f"dbw: {line}", err=True)
    names = f"{len(recorder.paths)} files" if rotation.is_wanted else str(out)
    click.echo(f"{recorder.frames} frames recorded, {names}")
    return code


def setting_of(kind: Format, dbc: tuple[str, ...], *, relaxed: bool) -> Setting:
    """What writers of a format need; the DBC is loaded if it decodes.

    Raises:
        UserMistake, DatabaseError: A DBC for a format that does not decode, or that is none.
    """
    from telemetry.record.channels import ChannelNumbers
    from telemetry.record.formats import Setting

    numbers = ChannelNumbers()
    if not kind.is_decoded:
        if dbc:
            raise UserMistake(f"--dbc: {kind.name} holds frames as they are; MCAP is decoded")
        return Setting(databases=None, numbers=numbers)
    from telemetry.databases import load_databases

    databases = load_databases(dbc, relaxed=relaxed)
    for note in databases.notes:
        click.echo(f"dbw: {note}", err=True)
    return Setting(databases=databases, numbers=numbers)


def _default_path() -> Path:
    from runtime.clock import NS_PER_S, local_text, realtime_ns

    text = local_text(realtime_ns() // NS_PER_S).replace(" ", "_").replace(":", "-")
    return Path(f"dbw-{text}.log")


def record_from(
    listener: Listener,
    recorder: Recording,
    selection: Selection,
    duration_s: int | None,
    is_stopped: Callable[[], bool],
) -> None:
    """Listens until it is stopped, or the end of the duration; the file is complete then.

    What has come until then is recorded, however early that is.

    Raises:
        RecordingError: It had to end before; the file is closed.
    """
    from runtime.clock import NS_PER_S, monotonic_ns

    end_ns = sys.maxsize if duration_s is None else monotonic_ns() + duration_s * NS_PER_S
    is_filtered = any(source.filters for source in selection.sources)
    lost = 0
    now_ns = monotonic_ns()
    is_last = False
    while not is_last:
        is_last = is_stopped() or now_ns >= end_ns
        if not is_last:
            select.select([], [], [], GATHER_S)
        heard = listener.hear(0 if is_last else min(WAIT_NS, end_ns - now_ns))
        if is_filtered:
            heard = [item for item in heard if selection.passes(item, None)]
        now_ns = monotonic_ns()
        recorder.add(heard, now_ns)
        if listener.lost != lost:
            new, lost = listener.lost - lost, listener.lost
            click.echo(f"dbw: {new} frames lost, not read in time ({lost} in all)", err=True)
        for note in listener.notes():
            click.echo(f"dbw: {note}", err=True)
    recorder.close(now_ns)


@contextmanager
def until_signal() -> Iterator[Callable[[], bool]]:
    """Ctrl-C and SIGTERM between two batches, not within one."""
    came: list[int] = []

    def take(number: int, frame: FrameType | None) -> None:
        came.append(number)

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, take) for number in numbers]
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
