"""What a node sent in a recorded drive beside what its code sends now, frame by frame."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Any, Final

from canbus.frame import Frame
from dbc.codec import Decoded, decode
from dbc.protection import PROTECTED_LENGTH
from dbc.spec import MessageSpec
from telemetry.databases import load_databases

HEAD_BYTES: Final = PROTECTED_LENGTH // 2
"""CRC and counter are in the first half of a protected frame, its content in the second."""
CLOSE_RATIO: Final = 0.01
CLOSE_BITS: Final = 2
"""A number that is as recorded but for a hundredth, or for two of its smallest steps, is close."""

Resolutions = Mapping[str, Mapping[str, float]]
"""The smallest step of each signal, by message and signal."""


class Match(StrEnum):
    """How a frame of the record and one of the replay go together."""

    EQUAL = "equal"
    """Every byte."""
    CLOSE = "close"
    """Numbers differ by no more than the time of a step that a log leaves open explains."""
    CYCLE_OFF = "a cycle off"
    """The same content one step sooner or later: whether a frame came before or after the step
    began is not always to be seen in a log."""
    DIFFERS = "differs"
    ONLY_RECORDED = "only recorded"
    ONLY_REPLAYED = "only replayed"


DIFFERENCES: Final = frozenset({Match.DIFFERS, Match.ONLY_RECORDED, Match.ONLY_REPLAYED})


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One frame that is not as recorded; `recorded` or `replayed` is None where there is none."""

    step: int
    time_ns: int
    name: str
    match: Match
    recorded: Frame | None
    replayed: Frame | None
    signals: Mapping[str, tuple[Any, Any]]
    """Recorded and replayed value of each signal that differs."""


def resolutions_of(dbc: str) -> Resolutions:
    """Of one of the project's own DBC files, by its name."""
    return {
        message.name: {
            signal.name: float(signal.conversion.scale)
            for signal in message.signals
        }
        for message in load_databases([dbc]).messages
    }


@dataclass(slots=True)
class Comparison:
    """Counts of all frames by message and match, and the differences themselves.

    Attributes:
        specs: Messages by identifier.
        resolutions: Of their signals.
        counts: By the message's name.
        differences: In order of time.
    """

    specs: Mapping[int, MessageSpec]
    resolutions: Resolutions
    counts: dict[str, Counter[Match]] = field(default_factory=lambda: defaultdict(Counter))
    differences: list[Difference] = field(default_factory=list)

    @property
    def is_equal(self) -> bool:
        """Whether no frame differs, or by a cycle or next to nothing."""
        return not self.differences

    def add(
        self,
        times_ns: Sequence[int],
        recorded: Sequence[Sequence[Frame]],
        replayed: Sequence[Sequence[Frame]],
    ) -> None:
        """Compares all steps of a run.

        Args:
            times_ns: When each step began; the other two are of the same length.
            recorded: What the node sent after each step.
            replayed: What its code sent now.
        """
        for can_id in sorted({f.can_id for frames in (*recorded, *replayed) for f in frames}):
            pairs = list(_pairs(_of_id(can_id, recorded), _of_id(can_id, replayed)))
            for pair in pairs:
                match = self._match(pair, pairs)
                name = self._name(can_id)
                self.counts[name][match] += 1
                if match in DIFFERENCES:
                    self.differences.append(self._difference(times_ns, pair, name, match))
        self.differences.sort(key=lambda one: (one.time_ns, one.name))

    def _name(self, can_id: int) -> str:
        spec = self.specs.get(can_id)
        return f"0x{can_id:03X}" if spec is None else spec.name

    def _content(self, frame: Frame) -> bytes:
        spec = self.specs.get(frame.can_id)
        protected = spec is not None and spec.data_id is not None
        return frame.data[HEAD_BYTES:] if protected else frame.data

    def _match(self, pair: _Pair, pairs: Sequence[_Pair]) -> Match:
        recorded, replayed = pair.recorded, pair.replayed
        if recorded is not None and replayed is not None:
            if recorded == replayed:
                return Match.EQUAL
            if self._is_close(recorded, replayed):
                return Match.CLOSE
        if self._is_cycle_off(pair, pairs):
            return Match.CYCLE_OFF
        if recorded is None:
            return Match.ONLY_REPLAYED
        return Match.DIFFERS if replayed is not None else Match.ONLY_RECORDED

    def _is_close(self, recorded: Frame, replayed: Frame) -> bool:
        steps = self.resolutions[self._name(recorded.can_id)]
        signals = self._signals(recorded, replayed)
        return bool(signals) and all(
            _is_number(was) and _is_number(now)
            and abs(now - was) <= max(CLOSE_BITS * steps[name], CLOSE_RATIO * abs(was))
            for name, (was, now) in signals.items()
        )  # fmt: skip

    def _is_cycle_off(self, pair: _Pair, pairs: Sequence[_Pair]) -> bool:
        """Whether what was recorded here is replayed one step before or after, or the reverse."""
        around = pairs[max(0, pair.place - 1) : pair.place + 2]
        near = [o for o in around if o is not pair and abs(o.step - pair.step) <= 1]
        both = [(pair.recorded, other.replayed) for other in near]
        both += [(pair.replayed, other.recorded) for other in near]
        return any(
            mine is not None and theirs is not None and self._content(mine) == self._content(theirs)
            for mine, theirs in both
        )

    def _difference(
        self, times_ns: Sequence[int], pair: _Pair, name: str, match: Match
    ) -> Difference:
        return Difference(
            step=pair.step,
            time_ns=times_ns[pair.step],
            name=name,
            match=match,
            recorded=pair.recorded,
            replayed=pair.replayed,
            signals=self._signals(pair.recorded, pair.replayed),
        )

    def _signals(
        self, recorded: Frame | None, replayed: Frame | None
    ) -> Mapping[str, tuple[Any, Any]]:
        """The signals whose values differ; none where one frame cannot be decoded."""
        if recorded is None or replayed is None:
            return {}
        was, now = self._message(recorded), self._message(replayed)
        if was is None or now is None:
            return {}
        names = self.specs[recorded.can_id].units
        both = {name: (getattr(was, name, None), getattr(now, name, None)) for name in names}
        return {name: values for name, values in both.items() if values[0] != values[1]}

    def _message(self, frame: Frame) -> object | None:
        spec = self.specs.get(frame.can_id)
        if spec is None:
            return None
        if spec.data_id is not None:
            decoded = decode(frame)
            return decoded.message if isinstance(decoded, Decoded) else None
        if len(frame.data) != spec.length:
            return None
        message: object = spec.unpack(int.from_bytes(frame.data, "little"))
        return message


@dataclass(frozen=True, slots=True)
class _Pair:
    """Frames of one identifier that stand at the same place of the same step."""

    place: int
    step: int
    recorded: Frame | None
    replayed: Frame | None


def _is_number(value: object) -> bool:
    """Whether a value can be close to another: neither a name of something nor a yes or no."""
    return isinstance(value, (int, float)) and not isinstance(value, (bool, Enum))


def _of_id(can_id: int, steps: Iterable[Sequence[Frame]]) -> list[list[Frame]]:
    return [[frame for frame in frames if frame.can_id == can_id] for frames in steps]


def _pairs(recorded: Sequence[list[Frame]], replayed: Sequence[list[Frame]]) -> Iterator[_Pair]:
    place = 0
    for step, (was, now) in enumerate(zip(recorded, replayed, strict=True)):
        for n in range(max(len(was), len(now))):
            yield _Pair(
                place,
                step,
                was[n] if n < len(was) else None,
                now[n] if n < len(now) else None,
            )
            place += 1
