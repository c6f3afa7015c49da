"""Options that several commands share, with messages that name what is allowed."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable
from typing import Any, TypeVar

import click

from dbw.failures import UserMistake
from vehicles import DEFAULT

BITRATE_BPS_MAX = 1_000_000
"""Classical CAN's (ISO 11898-1)."""

STANDARD_INPUT = "-"
"""Name of a log that comes through a pipe."""

VIRTUAL = "virtual"
"""An interface that lives inside one process."""

CommandT = TypeVar("CommandT", bound=Callable[..., Any])


class WholeNumber(click.ParamType[int]):
    """A whole number within a range; says so when it is none."""

    name = "integer"

    def __init__(self, low: int, high: int) -> None:
        self._low = low
        self._high = high

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number; fails as click does, with the range."""
        try:
            number = int(value)
        except ValueError:
            number = self._low - 1
        if not self._low <= number <= self._high:
            self.fail(f"{value!r}: a whole number from {self._low} to {self._high} is wanted")
        return number


class Seconds(click.ParamType[float]):
    """A time in seconds; not NaN, which every comparison would let pass."""

    name = "seconds"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The time; fails as click does."""
        try:
            time_s = float(value)
        except ValueError:
            time_s = math.nan
        if math.isnan(time_s):
            self.fail(f"{value!r}: a number of seconds is wanted")
        return time_s


THOUSANDS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9}


class ByteSize(click.ParamType[int]):
    """A number of bytes, as in 500k, 100M or 2G."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number; fails as click does."""
        found = re.fullmatch(r"([1-9][0-9]{0,11})([kMG]?)B?", str(value))
        if found is None:
            self.fail(f"{value!r}: a number of bytes is wanted, as in 500k, 100M or 2G")
        return int(found[1]) * THOUSANDS[found[2]]


class BusName(click.ParamType[str]):
    """A channel's name: no blanks, since log files and state files carry it."""

    name = "name"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The name; fails as click does."""
        text = str(value)
        if not text or not text.isprintable() or " " in text:
            self.fail(f"{text!r}: a name without blanks is wanted")
        return text


class CpuNumbers(click.ParamType[tuple[int, ...]]):
    """Numbers of processors, as in 1,2."""

    name = "numbers"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        """The numbers; fails as click does."""
        parts = str(value).split(",")
        if not all(part.isascii() and part.isdecimal() and len(part) < 5 for part in parts):
            self.fail(f"{value!r}: numbers of processors with commas are wanted, as in 1,2")
        return tuple(sorted({int(part) for part in parts}))


def bus_options(command: CommandT) -> CommandT:
    """`--channel` and `--harness-channel`."""
    command = click.option(
        "--harness-channel",
        type=BusName(),
        default="vcan1",
        show_default=True,
        help="Bus that stands for the wires between plant and nodes.",
    )(command)
    return channel_option(command)


def channel_option(command: CommandT) -> CommandT:
    """`--channel`."""
    return click.option(
        "--channel",
        type=BusName(),
        default="vcan0",
        show_default=True,
        help="The vehicle bus.",
    )(command)


def interface_option(command: CommandT) -> CommandT:
    """`--interface` of any kind that several processes can open."""
    return click.option(
        "--interface",
        type=BusName(),
        default="socketcan",
        show_default=True,
        help="python-can's name of the interface.",
    )(command)


def vehicle_option(command: CommandT) -> CommandT:
    """`--vehicle`."""
    return click.option(
        "--vehicle",
        default=DEFAULT,
        show_default=True,
        metavar="NAME|FILE.toml",
        help="What the nodes believe about the car.",
    )(command)


def database_options(command: CommandT) -> CommandT:
    """`--dbc` and `--relaxed`, which frames are read with."""
    command = click.option(
        "--relaxed", is_flag=True, help="Load what can be read of a DBC with errors."
    )(command)
    return click.option(
        "--dbc",
        multiple=True,
        metavar="[CHANNEL=]FILE",
        help="DBC to read frames with, several if need be; `vehicle` and `harness` are the "
        "project's.  [default: vehicle]",
    )(command)


def span_options(command: CommandT) -> CommandT:
    """`--from` and `--to`, which part of a log."""
    command = click.option(
        "--to", "to_s", type=Seconds(), default=math.inf, metavar="S", help="The same."
    )(command)
    return click.option(
        "--from",
        "from_s",
        type=Seconds(),
        default=-math.inf,
        metavar="S",
        help="Seconds, of the log's own time, or from its first frame where that is the system's.",
    )(command)


def name_options(command: CommandT) -> CommandT:
    """`--message` and `--node`, handed on as `messages` and `nodes`."""
    command = click.option(
        "--node", "nodes", multiple=True, metavar="NAME", help="Only what these nodes send."
    )(command)
    return click.option(
        "--message", "messages", multiple=True, metavar="NAME", help="Only these messages."
    )(command)


def signal_option(command: CommandT) -> CommandT:
    """`--signal`, handed on as `signals`."""
    return click.option(
        "-s",
        "--signal",
        "signals",
        multiple=True,
        metavar="MESSAGE.NAME",
        help="Only these signals, and messages that carry them.",
    )(command)


def bitrate_option(command: CommandT) -> CommandT:
    """`--bitrate`."""
    return click.option(
        "--bitrate",
        "bitrate_bps",
        type=WholeNumber(1, BITRATE_BPS_MAX),
        default=None,
        metavar="BPS",
        help="For interfaces that set it themselves; SocketCAN has it from `ip link`.  "
        "[default: the vehicle's]",
    )(command)


def realtime_options(command: Callable[..., int]) -> Callable[..., int]:
    """`--realtime`, `--lock-memory` and `--cpus`, handed on together as `realtime`."""

    @click.option(
        "--realtime",
        "scheduling",
        default="auto",
        show_default=True,
        metavar="auto|off|fifo:PRIO|rr:PRIO",
        help="Scheduling and its priority, 1 to 99. What is named must be granted; auto takes "
        "rr:10 if it can have it.",
    )
    @click.option(
        "--lock-memory", is_flag=True, help="Never page memory out (about 150 MB per process)."
    )
    @click.option(
        "--cpus",
        type=CpuNumbers(),
        default=None,
        metavar="N,N",
        help="Processors to run on.  [default: all]",
    )
    @functools.wraps(command)
    def run(
        *, scheduling: str, lock_memory: bool, cpus: tuple[int, ...] | None, **others: Any
    ) -> int:
        from runtime.realtime import RealtimeSettings

        realtime = RealtimeSettings(scheduling=scheduling, lock_memory=lock_memory, cpus=cpus or ())
        return command(realtime=realtime, **others)

    return run


def check_two_buses(channel: str, harness_channel: str) -> None:
    """The wires' frames must never be on the vehicle bus.

    Raises:
        UserMistake: Both are one bus.
    """
    if channel == harness_channel:
        raise UserMistake(
            f"--channel and --harness-channel are both {channel}: two buses are wanted"
        )
