"""The frames of `dbw replay`: when each is due, as a line or onto a bus."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final

import click

from canbus.heard import ERROR_FLAG, EXTENDED_ID_MAX, Heard
from dbw.failures import UserMistake
from runtime.clock import NS_PER_S, local_text, monotonic_ns, realtime_ns
from telemetry.replay.schedule import Schedule

if TYPE_CHECKING:
    from canbus.python_can_bus import PythonCanBus
    from dbw.monitor_lines import LineOutput
    from dbw.replay import ReplayOptions
    from telemetry.replay.source import Source

LISTEN_NS: Final = 200_000_000
"""How long a bus is listened to before anything is sent there: longer than any cycle of ours."""
RETRY_S: Final = 0.001
RETRIES_MAX: Final = 2000
"""A bus that takes no frame for so many tries is down."""
EVERY: Final = ""
SHOWN_MAX: Final = 3


def play(options: ReplayOptions, source: Source) -> None:
    """Plays the frames of a source.

    Raises:
        UserMistake, BusError: The bus cannot be used; nothing was sent.
    """
    schedule = Schedule(
        speed=options.speed,
        loops=options.loops or None,
        gap_ns_max=None if options.gap_s is None else round(options.gap_s * NS_PER_S),
    )
    with ExitStack() as stack:
        sink: Callable[[Heard], None] | None = None
        if options.onto:
            outlet = _Outlet(options, source, stack)
            sink = outlet.send
        output = _output(options, source) if sink is None or options.step else None
        _Player(output, sink, with_steps=options.step).run(schedule, source)
        if options.onto:
            outlet.tell()
    if schedule.backwards:
        click.echo(f"dbw: the log's time goes back {schedule.backwards} times", err=True)


def _output(options: ReplayOptions, source: Source) -> LineOutput:
    from dbw.monitor import wants_colours
    from dbw.monitor_lines import LineOutput
    from telemetry.monitor.meaning import Interpreter
    from telemetry.monitor.plain import LineWriter, Stamp, StampWriter

    writer = LineWriter(
        interpreter=Interpreter(source.catalogue),
        selection=source.selection,
        stamps=StampWriter(Stamp(options.stamp), local_text),
        channel_width=0,
        with_meaning=True,
        as_log=False,
    )
    return LineOutput(writer=writer, with_colours=wants_colours("auto"), count=None)


class _Player:
    """Waits until each frame is due, or until a person asks for it."""

    def __init__(
        self, output: LineOutput | None, sink: Callable[[Heard], None] | None, *, with_steps: bool
    ) -> None:
        self._output = output
        self._sink = sink
        self._left = 0 if with_steps else None
        self._pause = threading.Event()

    def run(self, schedule: Schedule, source: Source) -> None:
        """Plays everything, or until a person has seen enough."""
        start_ns = monotonic_ns()
        for due_ns, frame in schedule.frames(source.frames):
            if self._left is not None:
                if not self._is_asked_for():
                    return
            else:
                wait_ns = start_ns + due_ns - monotonic_ns()
                if wait_ns > 0:
                    self._pause.wait(wait_ns / NS_PER_S)
            heard = frame.heard()
            if self._output is not None:
                self._output.write([heard])
            if self._sink is not None:
                self._sink(heard)

    def _is_asked_for(self) -> bool:
        """Whether the next frame is wanted; asks where it does not know."""
        assert self._left is not None
        while self._left == 0:
            line = sys.stdin.readline()
            text = line.strip()
            if not line or text == "q":
                return False
            if not text or (text.isascii() and text.isdecimal()):
                self._left = int(text or 1)
            else:
                click.echo("dbw: Enter, a number and Enter, or q and Enter is wanted", err=True)
        self._left -= 1
        return True


class _Outlet:
    """Sends onto buses, each channel of the log to its own."""

    def __init__(self, options: ReplayOptions, source: Source, stack: ExitStack) -> None:
        self._fd = options.fd
        self._buses: dict[str, PythonCanBus] = {}
        self._left_out: dict[str, int] = {}
        self._pause = threading.Event()
        self._sent = 0
        targets = _targets(options.onto)
        opened = {name: _opened(options, name, stack) for name in set(targets.values())}
        self._buses = {channel: opened[target] for channel, target in targets.items()}
        if not options.force:
            self._refuse_second_senders(source, targets)

    def _refuse_second_senders(self, source: Source, targets: dict[str, str]) -> None:
        end_ns = monotonic_ns() + LISTEN_NS
        taken: set[tuple[str, int]] = set()
        while monotonic_ns() < end_ns:
            for name, bus in zip(targets.values(), self._buses.values(), strict=True):
                taken |= {(name, heard.word) for heard in bus.hear()}
            self._pause.wait(LISTEN_NS / NS_PER_S / 20)
        known = source.catalogue
        wrong = sorted(
            {
                (targets.get(channel, targets.get(EVERY, "")), word)
                for channel, word in source.words()
                if not word & ERROR_FLAG
            }
            & taken
        )
        if wrong:
            shown = ", ".join(
                f"{word & EXTENDED_ID_MAX:03X}"
                + (f" {message.name}" if (message := known.find(name, word)) else "")
                for name, word in wrong[:SHOWN_MAX]
            )
            more = f" and {len(wrong) - SHOWN_MAX} more" * (len(wrong) > SHOWN_MAX)
            raise UserMistake(
                f"somebody on {wrong[0][0]} sends {shown}{more} already, and two senders of one "
                "identifier collide: stop them, choose other frames, or use --force"
            )

    def send(self, heard: Heard) -> None:
        """Sends a frame; waits while the bus takes none.

        Raises:
            UserMistake: It takes none for a long time.
        """
        bus = self._buses.get(heard.channel) or self._buses.get(EVERY)
        if bus is None:
            return
        if heard.is_error or (heard.is_fd and not self._fd):
            what = "error frames: none can be sent" if heard.is_error else "FD frames: see --fd"
            self._left_out[what] = self._left_out.get(what, 0) + 1
            return
        for _ in range(RETRIES_MAX):
            if bus.repeat(heard):
                self._sent += 1
                return
            self._pause.wait(RETRY_S)
        raise UserMistake(
            f"the bus took no frame for {RETRIES_MAX * RETRY_S:g} s, after {self._sent} frames: "
            "is it up, and does somebody acknowledge?"
        )

    def tell(self) -> None:
        """What was sent, and what was not."""
        click.echo(f"{self._sent} frames sent")
        for what, count in self._left_out.items():
            click.echo(f"dbw: left out {count} {what}", err=True)


def _targets(onto: Iterable[str]) -> dict[str, str]:
    """The log's channels, EVERY for all others, and where each goes.

    Raises:
        UserMistake: A channel is named twice, or not at all.
    """
    targets: dict[str, str] = {}
    for text in onto:
        channel, _, target = text.rpartition("=")
        if not target or channel in targets or not text.isprintable() or " " in text:
            raise UserMistake(f"--onto {text}: [CHANNEL=]CHANNEL is wanted, each one once")
        targets[channel] = target
    return targets


def _opened(options: ReplayOptions, channel: str, stack: ExitStack) -> PythonCanBus:
    from canbus.python_can_bus import PythonCanBus

    bus = PythonCanBus(
        options.interface,
        channel,
        clock=monotonic_ns,
        realtime=realtime_ns,
        bitrate=options.bitrate_bps,
        fd=options.fd,
    )
    return stack.enter_context(bus)
