"""What is going on on a bus: a row per message, and the load per channel. Fed with frames and time.

All times inside are monotonic: whoever feeds tells how far the system's clock, on which frames are
stamped, is from the monotonic one. Memory is bounded whatever comes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import Final

from canbus.heard import ANY, ERROR_FLAG, REMOTE_FLAG, Heard
from canbus.timing import frame_bits
from telemetry.monitor.known import Known
from telemetry.monitor.meaning import Interpreter
from telemetry.monitor.protection import Protection

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
ROWS_MAX: Final = 2_500
"""All 11-bit identifiers and some more; what does not fit is counted as unlisted."""
RATE_SPAN_NS: Final = NS_PER_S
"""Rates and load are those of about the last second."""
LATE_CYCLES: Final = 2
"""A message is late when it is older than so many of its cycles: one frame did not come."""
MISSING_CYCLES: Final = 10
"""A message whose DBC tells a cycle and no time-out is missing when it is older than this."""
PLOT_SAMPLES_MAX: Final = 2_000
PLOT_INTERVAL_NS: Final = 10_000_000
"""Samples of a plotted signal are at least this far apart."""
_ODD: Final = ERROR_FLAG | REMOTE_FLAG


class Presence(Enum):
    """Whether a message comes as its DBC says."""

    ALIVE = "alive"
    LATE = "late"
    MISSING = "missing"
    EVENT = "event"
    """Nothing is said of when it comes."""


class Row:
    """One message on one channel; unknown identifiers, remote and error frames have rows as well.

    Attributes:
        heard: The newest frame; None for a message that is only expected.
        count: Frames so far.
        newest_ns: Time of the newest frame.
        missing_after_ns: Age at which the message is missing; 0 if nothing is said of its times.
        rate_hz: Frames per second, over about the last second.
        gap_ns_max: Longest time between two frames.
        timeouts: How often the DBC's time-out passed between two frames.
        protection: Judgement of counter and CRC; None for a message that has none.
        changed_ns: When each byte changed last.
    """

    __slots__ = (
        "_bits", "_changes", "_mark_count", "_mark_ns", "_tick_ns", "changed_ns", "channel",
        "count", "gap_ns_max", "heard", "known", "missing_after_ns", "newest_ns", "protection",
        "rate_hz", "timeouts", "word",
    )  # fmt: skip

    def __init__(self, channel: str, word: int, known: Known | None) -> None:
        self.channel = channel
        self.word = word
        self.known = known
        self.heard: Heard | None = None
        self.count = 0
        self.newest_ns = 0
        self.rate_hz = 0.0
        self.protection: Protection | None = None
        if known is not None and known.data_id is not None and not word & _ODD:
            self.protection = Protection(known.data_id)
        self.missing_after_ns = 0
        if known is not None and known.cycle_ns and not word & _ODD:
            self.missing_after_ns = known.timeout_ns or MISSING_CYCLES * known.cycle_ns
        self.changed_ns: list[int] = []
        self._bits = self._changes = 0
        self._mark_count = self._mark_ns = self._tick_ns = 0
        self.reset()

    def reset(self) -> None:
        """Forgets faults and gaps."""
        self.gap_ns_max = self.timeouts = 0
        if self.protection is not None:
            self.protection.faults = 0

    @property
    def name(self) -> str:
        """Of the message; empty for an unknown one."""
        return "" if self.known is None else self.known.name

    def presence(self, now_ns: int) -> Presence:
        """Whether it comes as its DBC says."""
        if not self.missing_after_ns:
            return Presence.EVENT
        assert self.known is not None
        age_ns = now_ns - self.newest_ns
        if not self.count or age_ns > self.missing_after_ns:
            return Presence.MISSING
        is_late = age_ns > LATE_CYCLES * self.known.cycle_ns
        return Presence.LATE if is_late else Presence.ALIVE

    def take(self, heard: Heard, time_ns: int) -> None:
        """The next frame."""
        if self.count:
            gap_ns = time_ns - self.newest_ns
            if gap_ns > self.gap_ns_max:
                self.gap_ns_max = gap_ns
            if 0 < self.missing_after_ns < gap_ns:
                self.timeouts += 1
        data = heard.data
        before = self.heard
        if before is None or data != before.data:
            bits = int.from_bytes(data, "little")
            if before is not None:
                self._changes |= bits ^ self._bits
            self._bits = bits
        self.heard = heard
        self.count += 1
        self.newest_ns = time_ns
        if self.protection is not None:
            self.protection.take(data)

    def tick(self, now_ns: int) -> None:
        """Brings rate and changed bytes up to date; a few times a second."""
        if self.heard is None:
            return
        length = len(self.heard.data)
        if len(self.changed_ns) != length:
            self.changed_ns = (self.changed_ns + [0] * length)[:length]
        if self._changes:
            for place in range(length):
                if self._changes >> 8 * place & 0xFF:
                    self.changed_ns[place] = now_ns
            self._changes = 0
        if now_ns - self._tick_ns >= RATE_SPAN_NS:
            self._tick_ns = now_ns
            frames, span_ns = self.count - self._mark_count, self.newest_ns - self._mark_ns
            if frames and self._mark_count:
                self.rate_hz = frames * NS_PER_S / max(span_ns, 1)
            elif now_ns - self.newest_ns > 2 * RATE_SPAN_NS:
                self.rate_hz = 0.0
            self._mark_count, self._mark_ns = self.count, self.newest_ns


class Channel:
    """Traffic of one channel.

    Attributes:
        frames: Frames so far, error frames apart.
        bits: Bits on the wire so far, stuff bits and interframe space in; FD frames apart.
        fd_frames: FD frames so far, whose length is not counted.
        errors: Error frames so far.
        bits_per_s, frames_per_s: Over about the last second.
        bits_per_s_max: The most so far.
    """

    __slots__ = (
        "_samples", "bits", "bits_per_s", "bits_per_s_max", "errors", "fd_frames", "frames",
        "frames_per_s",
    )  # fmt: skip

    def __init__(self) -> None:
        self.frames = self.bits = self.fd_frames = self.errors = 0
        self.bits_per_s = self.frames_per_s = self.bits_per_s_max = 0.0
        self._samples: deque[tuple[int, int, int]] = deque()

    def tick(self, now_ns: int) -> None:
        """Brings the rates up to date."""
        samples = self._samples
        samples.append((now_ns, self.bits, self.frames))
        while len(samples) > 2 and now_ns - samples[1][0] >= RATE_SPAN_NS:
            samples.popleft()
        then_ns, bits, frames = samples[0]
        span_ns = now_ns - then_ns
        if span_ns > 0:
            self.bits_per_s = (self.bits - bits) * NS_PER_S / span_ns
            self.frames_per_s = (self.frames - frames) * NS_PER_S / span_ns
        if span_ns >= RATE_SPAN_NS:
            self.bits_per_s_max = max(self.bits_per_s_max, self.bits_per_s)


class BusModel:
    """Everything that a screen shows.

    Args:
        interpreter: Finds the messages.
        channels: Channels that are listened to; messages with a cycle are expected on the first,
            and on others where a known message was heard.

    Attributes:
        rows: By channel and identifier with its flags.
        channels: By name.
        unlisted: Frames for which there was no row left.
        plotted: Row and signal that are plotted, if any.
        samples: Time and value of the plotted signal.
    """

    def __init__(self, interpreter: Interpreter, channels: Sequence[str]) -> None:
        self.interpreter = interpreter
        self.rows: dict[tuple[str, int], Row] = {}
        self.channels: dict[str, Channel] = {}
        self.unlisted = 0
        self.plotted: tuple[Row, str] | None = None
        self.samples: deque[tuple[int, float]] = deque(maxlen=PLOT_SAMPLES_MAX)
        self._expecting: set[str] = set()
        for name in channels:
            if name != ANY:
                self.channels[name] = Channel()
        if channels and channels[0] != ANY:
            self._expect(channels[0])

    def feed(self, heard: Iterable[Heard], offset_ns: int) -> None:
        """Takes frames in.

        Args:
            heard: In order of time.
            offset_ns: Monotonic time minus system time, to be added to their stamps.
        """
        rows = self.rows
        for item in heard:
            time_ns, name, word = item.time_ns + offset_ns, item.channel, item.word
            channel = self.channels.get(name)
            if channel is None:
                channel = self.channels[name] = Channel()
            row = rows.get((name, word))
            if row is None:
                row = self._new_row(item)
            if word & ERROR_FLAG:
                channel.errors += 1
            else:
                channel.frames += 1
                if item.fd_flags >= 0:
                    channel.fd_frames += 1
                else:
                    channel.bits += frame_bits(item.frame())
            if row is None:
                self.unlisted += 1
                continue
            row.take(item, time_ns)
            if self.plotted is not None and row is self.plotted[0]:
                self._sample(row, item, time_ns)

    def tick(self, now_ns: int) -> None:
        """Brings rates and loads up to date; a few times a second."""
        for row in self.rows.values():
            row.tick(now_ns)
        for channel in self.channels.values():
            channel.tick(now_ns)

    def plot(self, row: Row | None, signal: str = "") -> None:
        """Begins to keep a signal's values; None ends it."""
        self.plotted = None if row is None else (row, signal)
        self.samples.clear()

    def reset(self) -> None:
        """Forgets faults, gaps, and the largest load."""
        for row in self.rows.values():
            row.reset()
        for channel in self.channels.values():
            channel.bits_per_s_max = 0.0

    def row_of(self, name: str) -> Row | None:
        """The row of a message of the project's own, on whatever channel it was heard last."""
        found = [
            row
            for row in self.rows.values()
            if row.known is not None and row.known.is_own and row.known.name == name
        ]
        return max(found, key=lambda row: row.newest_ns, default=None)

    def _new_row(self, heard: Heard) -> Row | None:
        if len(self.rows) >= ROWS_MAX:
            return None
        known = self.interpreter.known(heard)
        row = Row(heard.channel, heard.word, known)
        self.rows[heard.channel, heard.word] = row
        if known is not None and known.cycle_ns:
            self._expect(heard.channel)
        return row

    def _expect(self, channel: str) -> None:
        """Rows for messages with a cycle, so that those that never come are seen to be missing."""
        if channel in self._expecting:
            return
        self._expecting.add(channel)
        for word, message in self.interpreter.catalogue.messages.items():
            known = self.interpreter.catalogue.find(channel, word)
            if message.cycle_ns and known is not None and len(self.rows) < ROWS_MAX:
                self.rows.setdefault((channel, word), Row(channel, word, known))

    def _sample(self, row: Row, heard: Heard, time_ns: int) -> None:
        if self.samples and time_ns - self.samples[-1][0] < PLOT_INTERVAL_NS:
            return
        assert row.known is not None and self.plotted is not None
        for value in row.known.read(heard.data).values:
            if value.name == self.plotted[1]:
                self.samples.append((time_ns, value.number))
