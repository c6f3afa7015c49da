"""The formats that can be written: which file ending, what they cannot hold, who writes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

from canbus.candump import NS_PER_US
from canbus.heard import ERROR_FLAG, REMOTE_FLAG, Heard
from telemetry.record.channels import ChannelNumbers
from telemetry.record.log_file import LogFile

if TYPE_CHECKING:
    from telemetry.databases import Databases



ASC_START_NS: Final = 1_000_000_000
"""The format has milliseconds, which python-can writes without leading zeros: 0.001 as 0.1."""
BLF_START_NS: Final = 1_000_000
UNIX_NS_MIN: Final = 631_152_000 * 1_000_000_000
"""1990."""
_KIND: Final = REMOTE_FLAG | ERROR_FLAG


class Writer(Protocol):
    """Writes one log."""

    def write(self, frames: Sequence[Heard]) -> None:
        """Takes a batch, which is then in the file, but for MF4.

        Raises:
            LogFullError: It did not fit; the file holds what it held before.
        """
        ...

    def close(self) -> int:
        """Completes the file; answers how many frames of its end had to make room for that.

        Raises:
            LogFullError: It cannot be completed.
        """
        ...


@dataclass(slots=True, kw_only=True)
class Setting:
    """What writers need to know.

    Attributes:
        databases: For formats with decoded values.
        numbers: Of the channels, for formats without names; filled as they come.
    """

    databases: Databases | None
    numbers: ChannelNumbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """One format.

    Attributes:
        name: As a person calls it.
        open: Begins a log in an empty file.
        is_live: Whether it is in the file batch by batch, so that a crash leaves a log.
        has_names: Of channels; otherwise they have numbers.
        has_ns: Otherwise times are cut to the microsecond.
        start_ns: Times count from the first frame's, rounded down to a multiple of this, and none
            is before it; 0: they do not.
        is_sorted: Frames are in order of time, those of one time in the order of their kinds.
        is_decoded: What the frames say is in it too.
        lost_of_errors: What of an error frame is lost.
        needs: The library that writes it, if not everybody has it.
    """

    name: str
    open: Callable[[LogFile, Setting], Writer]
    is_live: bool = True
    has_names: bool = True
    has_ns: bool = False
    start_ns: int = 0
    is_sorted: bool = False
    is_decoded: bool = False
    lost_of_errors: str = ""
    needs: str = ""


def start_of(first_ns: int, round_ns: int) -> int:
    """The start of a log whose first frame has this time: 0 where that is not the system's time.

    python-can writes no start before 1990 into a BLF.
    """
    return 0 if first_ns < UNIX_NS_MIN else first_ns // round_ns * round_ns


class Losses:
    """Counts what a format cannot hold of the frames that it is given.

    Args:
        kind: The format.
        with_times: Whether times that are cut to the microsecond count. Of a bus they do not: what
            is stamped to the nanosecond is not known so well.
    """

    def __init__(self, kind: Format, *, with_times: bool = True) -> None:
        self._format = kind
        self._with_times = with_times
        self._errors = self._cut = self._early = self._unsorted = 0
        self._start_ns: int | None = None
        self._last = (0, 0)

    def count(self, frames: Sequence[Heard]) -> None:
        """Takes a batch, in order."""
        if self._start_ns is None and frames:
            self._start_ns = frames[0].time_ns
        kind = self._format
        if kind.lost_of_errors:
            self._errors += sum(item.word & ERROR_FLAG != 0 for item in frames)
        if self._with_times and not kind.has_ns:
            self._cut += sum(item.time_ns % NS_PER_US != 0 for item in frames)
        if kind.start_ns and self._start_ns is not None:
            start_ns = start_of(self._start_ns, kind.start_ns)
            self._early += sum(item.time_ns < start_ns for item in frames)
        if kind.is_sorted:
            for item in frames:
                place = item.time_ns // NS_PER_US, item.word & _KIND
                self._unsorted += place < self._last
                self._last = max(self._last, place)

    def lines(self, numbers: ChannelNumbers) -> list[str]:
        """What was lost, a line for each kind."""
        name = self._format.name
        renamed = [] if self._format.has_names else numbers.renamed()
        order = f"{name} has data, error and remote frames apart, by time"
        kinds = (
            (self._cut, f"frames: their times are cut to the microsecond in {name}"),
            (self._early, f"frames are from before the first, where {name} begins to count"),
            (self._unsorted, f"frames change their place: {order}"),
            (self._errors, f"error frames lose {self._format.lost_of_errors} in {name}"),
        )
        lines = [f"{count} {text}" for count, text in kinds if count]
        if renamed:
            lines.append(f"{name} has numbers for channels: {', '.join(renamed)}")
        return lines


def _open_candump(file: LogFile, setting: Setting) -> Writer:
    from telemetry.record.candump_writer import CandumpWriter

    return CandumpWriter(file)


def _open_asc(file: LogFile, setting: Setting) -> Writer:
    from telemetry.record.python_can_writers import AscWriter

    return AscWriter(file, setting.numbers, ASC_START_NS)


def _open_blf(file: LogFile, setting: Setting) -> Writer:
    from telemetry.record.python_can_writers import BlfWriter

    return BlfWriter(file, setting.numbers, BLF_START_NS)


def _open_mcap(file: LogFile, setting: Setting) -> Writer:
    from telemetry.record.mcap_writer import McapWriter

    assert setting.databases is not None, "a decoding format"
    return McapWriter(file, setting.databases)


def _open_mf4(file: LogFile, setting: Setting) -> Writer:
    from telemetry.record.mf4_writer import Mf4Writer

    return Mf4Writer(file, setting.numbers)


FORMATS: Final = {
    ".log": Format(name="candump", open=_open_candump),
    ".asc": Format(
        name="ASC", open=_open_asc, has_names=False, start_ns=ASC_START_NS,
        lost_of_errors="all but their time and channel",
    ),
    ".blf": Format(
        name="BLF", open=_open_blf, has_names=False, start_ns=BLF_START_NS,
        lost_of_errors="their direction",
    ),
    ".mcap": Format(name="MCAP", open=_open_mcap, has_ns=True, is_decoded=True, needs="mcap"),
    ".mf4": Format(
        name="MF4", open=_open_mf4, is_live=False, has_names=False, is_sorted=True,
        needs="asammdf",
    ),
}  # fmt: skip
"""By the ending of the file's name."""


class FormatError(ValueError):
    """A file whose ending says no format that can be written; one line with those that can."""


def format_of(path: Path, *, is_live: bool = False) -> Format:
    """The format that a file's ending asks for.

    Args:
        path: The file.
        is_live: Whether it has to be written batch by batch.

    Raises:
        FormatError: There is none.
    """
    found = FORMATS.get(path.suffix.lower())
    if found is None or (is_live and not found.is_live):
        known = ", ".join(end for end, kind in FORMATS.items() if kind.is_live or not is_live)
        if found is not None:
            raise FormatError(
                f"{path}: {found.name} would lose everything in a crash: record {known}, "
                "and convert it"
            )
        raise FormatError(f"{path}: the ending says the format: {known}")
    if found.needs and find_spec(found.needs) is None:
        advice = "pip install can-by-wire[logs]"
        raise FormatError(f"{path}: {found.name} needs {found.needs}: {advice}")
    return found
