"""The codec generated from the DBC against cantools' strict one, on the same messages.

Equal bytes are checked first; what is not equal is not timed. The dictionaries that cantools takes
and the dataclasses that ours takes are made beforehand, for both alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import fmean
from typing import Any

import numpy as np
from cantools.database.can import Message, Signal

from bench.machine import cpu_s, reference_loop_s
from bench.table import Table, command_line, met
from canbus.frame import Frame
from dbc.codec import Decoded, decode_anew, decode_data, encode, frame_data
from dbc.database import VEHICLE_DBC, load
from dbc.messages import SPECS
from dbc.protection import COUNTER_MODULO, COUNTER_SHIFT, is_intact, protect
from dbc.spec import MessageSpec, SignalRangeError

NAME = "codec"
GOAL_RATIO = 0.1
"""Encoding takes a tenth of cantools' strict encoding."""

PROTECTION = ("crc", "alive_counter")
CONTENTS, QUICK_CONTENTS = 20, 3
ROUNDS, QUICK_ROUNDS = 9, 3
REPEATS, QUICK_REPEATS = 20, 4
DRAWS_MAX = 10_000



@dataclass(frozen=True, slots=True, kw_only=True)
class CodecCost:
    """CPU time of one operation on one message, microseconds, mean over messages and contents."""

    operation: str
    goal_ratio: float
    """NaN for an operation without a goal."""
    ours_us: float
    cantools_us: float
    message_of_worst_ratio: str
    worst_ratio: float

    @property
    def ratio(self) -> float:
        """Ours over cantools'."""
        return self.ours_us / self.cantools_us


@dataclass(frozen=True, slots=True, kw_only=True)
class CodecResult:
    """What `measure` answers."""

    quick: bool
    messages: int
    """Whose bytes were compared: all with content."""
    contents_compared: int
    messages_timed: int
    """The protected ones among them."""
    costs: tuple[CodecCost, ...]
    reference_s: float

    def tables(self) -> list[Table]:
        """One row per operation."""
        rows = []
        for cost in self.costs:
            goal = f"<= {cost.goal_ratio:g}: {met(cost.ratio <= cost.goal_ratio)}"
            goal = "" if math.isnan(cost.goal_ratio) else goal
            worst = f"{cost.worst_ratio:.3f} ({cost.message_of_worst_ratio})"
            rows.append(
                (cost.operation, f"{cost.ours_us:.2f}", f"{cost.cantools_us:.2f}",
                 f"{cost.ratio:.3f}", worst, goal)
            )
        return [
            Table(
                title="Codec against cantools, CPU time per frame",
                command=command_line(NAME, quick=self.quick),
                headers=("operation", "ours, us", "cantools strict, us", "ratio",
                         "worst message", "goal"),
                rows=rows,
                notes=(
                    f"Before anything was timed {self.contents_compared} random contents of all "
                    f"{self.messages} messages with content gave equal bytes and equal values in "
                    f"both. Timed: the {self.messages_timed} protected messages, weighed equally; "
                    "the least of several rounds that alternate. cantools computes neither CRC nor "
                    "counter: where the row does not say so, ours has that work on top. Reference "
                    f"loop: {self.reference_s * 1e3:.0f} ms.",
                ),
            )
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One content of one message in the forms that both codecs take and give."""

    content: Any
    values: dict[str, Any]
    """For cantools; CRC and counter zero."""
    payload: bytes
    """Without protection."""
    data: bytes
    """As on the wire."""


def measure(*, quick: bool = False) -> CodecResult:
    """Compares, then times.

    Raises:
        AssertionError: The two codecs disagree; names the message.
    """
    rng = np.random.default_rng(0)
    count = QUICK_CONTENTS if quick else CONTENTS
    samples = {
        message.frame_id: [_sample(message, rng) for _ in range(count)]
        for message in load(VEHICLE_DBC).messages
        if any(signal.name not in PROTECTION for signal in message.signals)
    }
    protected = {spec.can_id for spec in SPECS.values() if spec.data_id is not None}
    timed = {can_id: group for can_id, group in samples.items() if can_id in protected}
    rounds, repeats = (QUICK_ROUNDS, QUICK_REPEATS) if quick else (ROUNDS, REPEATS)
    return CodecResult(
        quick=quick,
        messages=len(samples),
        contents_compared=sum(map(len, samples.values())),
        messages_timed=len(timed),
        costs=tuple(_cost(pair, timed, rounds, repeats) for pair in PAIRS),
        reference_s=reference_loop_s(),
    )


# Contents ----------------------------------------------------------------------------------------


def _sample(message: Message, rng: np.random.Generator) -> Sample:
    spec = SPECS[message.frame_id]
    content = _content(message, spec, rng)
    counter = int(rng.integers(COUNTER_MODULO))
    fields = {s.name: s for s in message.signals if s.name not in PROTECTION}
    values = {name: _for_cantools(getattr(content, name)) for name in fields}
    values |= {s.name: 0 for s in message.signals if s.name in PROTECTION}
    payload = spec.pack(content).to_bytes(spec.length, "little")
    data = encode(spec, content, counter).data
    assert message.encode(values, strict=True) == payload, message.name
    if spec.data_id is not None:
        sealed = {**values, "crc": data[0], "alive_counter": counter}
        assert message.encode(sealed, strict=True) == data, message.name
    decoded = decode_anew(spec, data)
    assert isinstance(decoded, Decoded), message.name
    read = message.decode(data, decode_choices=False)
    assert isinstance(read, dict)
    for name, signal in fields.items():
        assert _is_same(signal, read[name], getattr(decoded.message, name)), (message.name, name)
    return Sample(content=content, values=values, payload=payload, data=data)


def _content(message: Message, spec: MessageSpec, rng: np.random.Generator) -> Any:
    """A random valid content: raw values are drawn until the DBC allows them."""
    bits = 0
    for signal in message.signals:
        if signal.name in PROTECTION:
            continue
        mask = (1 << signal.length) - 1
        for _ in range(DRAWS_MAX):
            raw = int(rng.integers(1 << signal.length)) & mask
            if _is_allowed(signal, raw):
                break
        bits |= raw << signal.start
    try:
        return spec.unpack(bits)
    except (SignalRangeError, KeyError) as error:
        raise AssertionError(f"{message.name}: no valid content found") from error


def _is_allowed(signal: Signal, raw: int) -> bool:
    if signal.is_signed and raw >> signal.length - 1:
        raw -= 1 << signal.length
    names = {int(number): str(name) for number, name in (signal.choices or {}).items()}
    if names and set(names.values()) != {"not_available"}:
        return raw in names
    assert signal.minimum is not None and signal.maximum is not None
    return signal.minimum <= raw * signal.scale <= signal.maximum


def _for_cantools(value: Any) -> Any:
    return "not_available" if isinstance(value, float) and math.isnan(value) else value


def _is_same(signal: Signal, theirs: Any, ours: Any) -> bool:
    if isinstance(ours, float) and math.isnan(ours):
        names = {str(name): int(number) for number, name in (signal.choices or {}).items()}
        return bool(theirs == names["not_available"] * signal.scale)
    return math.isclose(float(theirs), float(ours), rel_tol=1e-12, abs_tol=1e-12)


# Timing ------------------------------------------------------------------------------------------

Work = Callable[[MessageSpec, Message, Sample], object]
"""One operation on one content."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """One operation, ours and theirs."""

    operation: str
    ours: Work
    theirs: Work
    goal_ratio: float = math.nan


def _cantools_encode(spec: MessageSpec, message: Message, sample: Sample) -> object:
    return message.encode(sample.values, strict=True)


def _cantools_protect(spec: MessageSpec, message: Message, sample: Sample) -> object:
    assert spec.data_id is not None
    return protect(bytearray(message.encode(sample.values, strict=True)), spec.data_id, 7)


def _cantools_decode(spec: MessageSpec, message: Message, sample: Sample) -> object:
    return message.decode(sample.data, allow_excess=False)


def _cantools_check(spec: MessageSpec, message: Message, sample: Sample) -> object:
    assert spec.data_id is not None
    return is_intact(sample.data, spec.data_id) and message.decode(sample.data, allow_excess=False)


def _encode_payload(spec: MessageSpec, message: Message, sample: Sample) -> object:
    return spec.pack(sample.content).to_bytes(8, "little")


def _encode_frame(spec: MessageSpec, message: Message, sample: Sample) -> object:
    return Frame(spec.can_id, frame_data(spec, spec.pack(sample.content) | 7 << COUNTER_SHIFT))


def _decode_payload(spec: MessageSpec, message: Message, sample: Sample) -> object:
    return spec.unpack(int.from_bytes(sample.payload, "little"))


def _decode_frame(spec: MessageSpec, message: Message, sample: Sample) -> object:
    return decode_anew(spec, sample.data)


def _decode_again(spec: MessageSpec, message: Message, sample: Sample) -> object:
    return decode_data(spec.can_id, sample.data)


PAIRS = (
    Pair(operation="encode the payload", ours=_encode_payload, theirs=_cantools_encode,
         goal_ratio=GOAL_RATIO),
    Pair(operation="encode a frame, protection in", ours=_encode_frame, theirs=_cantools_encode),
    Pair(operation="encode a frame, protection in both", ours=_encode_frame,
         theirs=_cantools_protect),
    Pair(operation="decode the payload", ours=_decode_payload, theirs=_cantools_decode),
    Pair(operation="decode a frame, protection checked", ours=_decode_frame,
         theirs=_cantools_decode),
    Pair(operation="decode a frame, protection checked in both", ours=_decode_frame,
         theirs=_cantools_check),
    Pair(operation="decode it again, for the next receiver", ours=_decode_again,
         theirs=_cantools_decode),
)


def _run(work: Work, can_id: int, message: Message, samples: list[Sample], repeats: int) -> None:
    spec = SPECS[can_id]
    for _ in range(repeats):
        for sample in samples:
            work(spec, message, sample)


def _nothing(spec: MessageSpec, message: Message, sample: Sample) -> None:
    """What calling an operation costs alone; subtracted from both sides."""


def _cost(pair: Pair, groups: dict[int, list[Sample]], rounds: int, repeats: int) -> CodecCost:
    """The least of several rounds that alternate, so that a busy moment hurts both or neither."""
    database = load(VEHICLE_DBC)
    ours_us, theirs_us = {}, {}
    for can_id, group in groups.items():
        message = database.get_message_by_frame_id(can_id)
        per_call = 1e6 / (repeats * len(group))
        runs = [
            [
                cpu_s(partial(_run, work, can_id, message, group, repeats)) * per_call
                for work in (pair.ours, pair.theirs, _nothing)
            ]
            for _ in range(rounds)
        ]
        ours, theirs, nothing = (min(times) for times in zip(*runs, strict=True))
        ours_us[can_id], theirs_us[can_id] = ours - nothing, theirs - nothing
    worst = max(groups, key=lambda can_id: ours_us[can_id] / theirs_us[can_id])
    return CodecCost(
        operation=pair.operation,
        goal_ratio=pair.goal_ratio,
        ours_us=fmean(ours_us.values()),
        cantools_us=fmean(theirs_us.values()),
        message_of_worst_ratio=SPECS[worst].name,
        worst_ratio=ours_us[worst] / theirs_us[worst],
    )
