"""`dbw why`: why a drive ended, or never began."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.options import bitrate_option, channel_option, interface_option, vehicle_option

if TYPE_CHECKING:
    from canbus.bus import Bus
    from telemetry.logs.problems import Problems
    from telemetry.why.freeze import FreezeStore
    from telemetry.why.incident import Incident
    from telemetry.why.watch import ModeChange, Told
    from vehicles import Vehicle

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
AROUND_S = 1.0
RECEIVE_NS = 100_000_000
EVERY = "all"
NUMBER_MAX = 999_999


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveOptions:
    """The bus to listen to."""

    interface: str
    channel: str
    bitrate_bps: int | None


@click.command(
    epilog="""\b
Examples:
  dbw why out/demo/drive.log
  dbw why drive.log --from 12 --to 14 --json
  dbw why --live --interface socketcan --channel can0
  dbw why --stored
  dbw why --stored 3"""
)
@click.argument("log", type=click.Path(path_type=Path), required=False)
@click.option("--live", is_flag=True, help="Listen to a bus until Ctrl-C; sends nothing.")
@click.option(
    "--stored",
    is_flag=False,
    flag_value=EVERY,
    default=None,
    metavar="[N]",
    help="List the stored freeze frames, or show number N.",
)
@click.option("--json", "as_json", is_flag=True, help="As JSON; live, one object per line.")
@click.option("--from", "from_s", type=float, default=None, metavar="S", help="From then on.")
@click.option("--to", "to_s", type=float, default=None, metavar="S", help="Until then.")
@interface_option
@channel_option
@bitrate_option
@vehicle_option
@click.option(
    "--store",
    type=click.Path(path_type=Path),
    default=None,
    help="Folder of the freeze frames.  [default: can-by-wire/freeze-frames in $XDG_STATE_HOME]",
)
@click.option("--no-store", is_flag=True, help="Live: store no freeze frames.")
def why(
    log: Path | None,
    live: bool,
    stored: str | None,
    as_json: bool,
    from_s: float | None,
    to_s: float | None,
    interface: str,
    channel: str,
    bitrate_bps: int | None,
    vehicle: str,
    store: Path | None,
    no_store: bool,
) -> int:
    """Tell why a drive ended, or never began.

    LOG: of candump (`-L`, also .gz), ASC, BLF, TRC, MCAP or MF4; `dbw demo` writes one. For each
    emergency brake, disengagement and refused engagement: the cause, the frame or the absence that
    shows it, who said so first, what each node did and when, and times against what is allowed.

    Live, each error code that comes up is stored with all frames of the second before and the
    second after.
    """
    if sum((log is not None, live, stored is not None)) != 1:
        raise UserMistake("one of LOG, --live and --stored is wanted")
    for name, value in (("--from", from_s), ("--to", to_s)):
        if value is not None and not math.isfinite(value):
            raise UserMistake(f"{name} {value}: a number of seconds is wanted")
        if value is not None and log is None:
            raise UserMistake(f"{name} needs a LOG")
    if stored is not None:
        return show_stored(_store(store), stored, as_json=as_json)
    from vehicles import load_vehicle

    car = load_vehicle(vehicle)
    if log is not None:
        span_s = (-math.inf if from_s is None else from_s, math.inf if to_s is None else to_s)
        return explain_log(log, car, span_s, as_json=as_json)
    options = LiveOptions(
        interface=interface, channel=channel,
        bitrate_bps=round(car.bus.bitrate_bps) if bitrate_bps is None else bitrate_bps,
    )
    return listen(options, car, None if no_store else _store(store), as_json=as_json)


def _store(folder: Path | None) -> FreezeStore:
    import os

    from telemetry.why.freeze import FreezeStore, default_folder

    return FreezeStore(folder or default_folder(os.environ))


# A log ----------------------------------------------------------------------------------------


def explain_log(log: Path, vehicle: Vehicle, span_s: tuple[float, float], *, as_json: bool) -> int:
    """Explains a log; answers the exit code.

    Raises:
        LogError, UserMistake: It cannot be read, or is no such log.
    """
    from telemetry.logs.frames import origin_ns
    from telemetry.logs.reading import Log
    from telemetry.why.incident import Incident
    from telemetry.why.watch import ModeChange, Watch

    reader, watch = Log(log), Watch(vehicle)
    told = _kept(watch.follow((item.time_ns, item.frame()) for item in reader.frames()))
    if not watch.frames and reader.problems.count:
        raise UserMistake(f"{log} is no log: {reader.problems.lines()[0]}")
    zero_ns = origin_ns(watch.begin_ns)
    low_ns, high_ns = (zero_ns + s * NS_PER_S for s in span_s)
    incidents = [
        item for item in told if isinstance(item, Incident) and low_ns <= item.time_ns <= high_ns
    ]
    incidents.sort(key=lambda item: item.time_ns)
    modes = [item for item in told if isinstance(item, ModeChange)]
    notes = _notes(reader.problems, watch.frames, watch.known)
    if as_json:
        _print_document(log, incidents, modes, notes, zero_ns, (watch.begin_ns, watch.end_ns))
    else:
        _print_log(log, incidents, modes, notes, zero_ns, watch.end_ns - watch.begin_ns)
    return EXIT_OK


def _kept(told: Iterable[Told]) -> list[Told]:
    """Without the frames of the codes, which a log has itself."""
    from telemetry.why.watch import CodeOnset

    return [item for item in told if not isinstance(item, CodeOnset)]


def _notes(problems: Problems, frames: int, known: int) -> list[str]:
    notes = problems.lines()
    if not frames:
        notes.append("the log holds no frame")
    elif not known:
        notes.append(f"none of the {frames} frames has an identifier of dbc/vehicle.dbc")
    elif known < frames:
        notes.append(f"{frames - known} frames have an identifier that is not of dbc/vehicle.dbc")
    return notes


def _clock(origin_ns: int) -> Any:
    return lambda time_ns: f"{(time_ns - origin_ns) / NS_PER_S:.3f} s"


def _print_log(
    log: Path, incidents: list[Incident], modes: list[ModeChange], notes: list[str],
    origin_ns: int, span_ns: int,
) -> None:
    from telemetry.why.words import lines_of

    clock = _clock(origin_ns)
    count = len(incidents) or "no"
    click.echo(f"{log}: {span_ns / NS_PER_S:.1f} s, {count} incident{'s' * (count != 1)}")
    if origin_ns:
        click.echo(f"  times count from its first frame, at {origin_ns / NS_PER_S:.6f}")
    for note in notes:
        click.echo(f"  note: {note}")
    for incident in incidents:
        click.echo()
        for line in lines_of(incident, clock):
            click.echo(line)
        for change in _afterwards(incident, modes):
            click.echo(f"  then: {change.after.name} at {clock(change.time_ns)}")
        for command in commands_for(log, incident, origin_ns):
            click.echo(f"  $ {command}")


def _afterwards(incident: Incident, modes: list[ModeChange]) -> list[ModeChange]:
    """Where it led: the next mode after its own."""
    if incident.mode_heard is None:
        return [item for item in modes if item.time_ns > incident.time_ns][:1]
    return [item for item in modes if item.time_ns > incident.mode_heard.time_ns][:1]


def commands_for(log: Path, incident: Incident, origin_ns: int) -> list[str]:
    """Command lines that show this stretch of the log, of those that this program has."""
    from shlex import quote

    from dbw.main import COMMANDS

    begin_s = max((incident.time_ns - origin_ns) / NS_PER_S - AROUND_S, 0.0)
    end_s = (incident.time_ns - origin_ns) / NS_PER_S + AROUND_S
    span = f"{quote(str(log))} --from {begin_s:.3f} --to {end_s:.3f}"
    return [f"dbw {name} {span}" for name in ("decode", "replay", "why") if name in COMMANDS]


def _print_document(
    log: Path, incidents: list[Incident], modes: list[ModeChange], notes: list[str],
    origin_ns: int, span_ns: tuple[int, int],
) -> None:
    from telemetry.why.document import VERSION, incident_json

    document = {
        "version": VERSION,
        "log": str(log),
        "origin_unix_s": origin_ns / NS_PER_S,
        "begin_s": round((span_ns[0] - origin_ns) / NS_PER_S, 6),
        "end_s": round((span_ns[1] - origin_ns) / NS_PER_S, 6),
        "notes": notes,
        "modes": [
            {"at_s": round((item.time_ns - origin_ns) / NS_PER_S, 6), "mode": item.after.name}
            for item in modes
        ],
        "incidents": [
            incident_json(
                incident, number, origin_ns, _clock(origin_ns),
                commands_for(log, incident, origin_ns),
            )
            for number, incident in enumerate(incidents, 1)
        ],
    }
    click.echo(json.dumps(document, indent=1))


# Live -----------------------------------------------------------------------------------------


def listen(
    options: LiveOptions, vehicle: Vehicle, store: FreezeStore | None, *, as_json: bool
) -> int:
    """Listens until interrupted; answers the exit code.

    Raises:
        BusError: The bus cannot be opened.
    """
    from canbus.python_can_bus import PythonCanBus
    from dbw.demo import interrupt_on_sigterm
    from dbw.why_live import LiveWatch
    from runtime.clock import monotonic_ns, realtime_ns

    with interrupt_on_sigterm(), PythonCanBus(
        options.interface, options.channel, clock=monotonic_ns, realtime=realtime_ns,
        bitrate=options.bitrate_bps,
    ) as bus:
        click.echo(f"listening to {options.interface} {options.channel}; Ctrl-C ends", err=True)
        watch = LiveWatch(vehicle, store, options.channel, as_json=as_json)
        return _run(bus, watch)


def _run(bus: Bus, watch: Any) -> int:
    from runtime.clock import monotonic_ns

    try:
        while True:
            watch.take(bus.receive(RECEIVE_NS), monotonic_ns())
    finally:
        watch.finish()


# Stored ---------------------------------------------------------------------------------------


def show_stored(store: FreezeStore, which: str, *, as_json: bool) -> int:
    """Lists what is stored, or shows one; answers the exit code.

    Raises:
        FreezeError, UserMistake: There is none of this number, or it cannot be read.
    """
    from dbw.why_stored import list_stored, print_stored

    if which == EVERY:
        return list_stored(store, as_json=as_json)
    if not which.isascii() or not which.isdecimal() or int(which) > NUMBER_MAX:
        raise UserMistake(f"--stored {which}: a number of `dbw why --stored` is wanted")
    return print_stored(store, int(which), as_json=as_json)

