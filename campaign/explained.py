"""What `telemetry.why` says of every fault of the matrix, beside what was injected.

Each fault strikes alone in a car that drives itself; the log is all that is looked at. As
`docs/why-faults.md` has it, written by `make matrix`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import StrEnum

from campaign.futures import SEEDS, Future
from campaign.matrix import ALL, column
from dbc.endpoint import SPEC_OF_NAME
from simulation.fault_kinds import KINDS, FaultKind
from telemetry.why.drives import ECU_OF_DRIVE
from telemetry.why.incident import Cause, CauseKind

_K, _C = FaultKind, CauseKind
TELLS: dict[FaultKind, frozenset[CauseKind]] = {
    _K.DROP: frozenset({_C.MESSAGE_MISSING}),
    _K.DUPLICATE: frozenset({_C.MESSAGE_REPEATED}),
    _K.CORRUPT_BEFORE_CRC: frozenset({_C.MESSAGE_UNUSABLE}),
    # The sender tries again and again, and goes bus-off; nobody hears it meanwhile.
    _K.CORRUPT_ON_WIRE: frozenset({_C.MESSAGE_MISSING, _C.NODE_SILENT, _C.NODE_BUS_OFF}),
    _K.TRUNCATE: frozenset({_C.MESSAGE_UNUSABLE}),
    _K.REPLAY: frozenset({_C.FOREIGN_SENDER}),
    _K.SPOOF: frozenset({_C.FOREIGN_SENDER}),
    _K.CRASH: frozenset({_C.NODE_SILENT}),
    _K.FREEZE: frozenset({_C.NODE_SILENT}),
    _K.SLOW_STEP: frozenset({_C.NODE_LATE}),
    _K.RESTART: frozenset({_C.NODE_RESTARTED}),
    _K.CLOCK_JUMP: frozenset({_C.NODE_LATE}),
    _K.MUTE: frozenset({_C.NODE_SILENT}),
    _K.DEAF: frozenset({_C.NODE_DEAF}),
    _K.BUS_OFF: frozenset({_C.NODE_SILENT, _C.NODE_BUS_OFF}),
    _K.BABBLE: frozenset({_C.MESSAGE_REPEATED}),
    _K.FLOOD: frozenset({_C.BUS_FLOODED}),
    _K.NOISE: frozenset({_C.BUS_SILENT}),
    _K.BROWN_OUT: frozenset({_C.POWER_LOST}),
    _K.SENSOR_STUCK: frozenset({_C.SENSOR, _C.NOT_FOLLOWING}),
    _K.SENSOR_OFFSET: frozenset({_C.SENSOR, _C.NOT_FOLLOWING}),
    _K.SENSOR_NOISE: frozenset({_C.SENSOR, _C.NOT_FOLLOWING}),
    _K.SENSOR_OUT_OF_BOUNDS: frozenset({_C.SENSOR}),
    _K.SENSOR_NAN: frozenset({_C.SENSOR}),
    _K.SENSOR_SWAPPED: frozenset({_C.SENSOR, _C.NOT_FOLLOWING}),
    _K.ENCODER_DEAD: frozenset({_C.SENSOR, _C.NOT_FOLLOWING}),
    _K.ACTUATOR_STUCK: frozenset({_C.NOT_FOLLOWING}),
    _K.ACTUATOR_WEAK: frozenset({_C.NOT_FOLLOWING}),
    _K.ACTUATOR_SLOW: frozenset({_C.NOT_FOLLOWING}),
    _K.ACTUATOR_HOT: frozenset({_C.NOT_FOLLOWING}),
    _K.DRIVE_FAULT: frozenset({_C.MOTOR_FAULT}),
    _K.DRIVE_DEAD: frozenset({_C.NODE_SILENT}),
    _K.DRIVE_MUTE: frozenset({_C.NODE_SILENT}),
    _K.DRIVE_DEAF: frozenset({_C.MOTOR_FAULT}),  # it misses its ECU
    _K.PLANNER_FROZEN: frozenset({_C.PLANNER_SILENT}),
    _K.PLANNER_LATE: frozenset({_C.PLANNER_SILENT}),
    _K.PLANNER_NAN: frozenset({_C.PLANNER_SILENT}),
    _K.DRIVER_GRABS: frozenset({_C.DRIVER, _C.BUTTON, _C.EMERGENCY_STOP}),
}
"""What a log can show of a fault, at best. Of the others, that it stops the car is a surprise."""

PLACE_OF = {
    "steering_wheel": "Steering", "throttle_pedal": "Throttle", "brake_pedal": "BrakeServo",
    "button": "Supervisor", **ECU_OF_DRIVE,
}
PLACELESS = frozenset(
    {_C.BUS_FLOODED, _C.BUS_SILENT, _C.POWER_LOST, _C.PLANNER_SILENT, _C.PLANNER_REQUEST}
)


class Verdict(StrEnum):
    """How what was said compares with what was injected."""

    RIGHT = "right"
    PLACE = "right place, another kind"
    WRONG = "wrong"
    NOTHING = "nothing said"


def verdict_of(future: Future) -> Verdict:
    """The comparison."""
    fault, cause = future.fault, future.cause
    if cause is None:
        return Verdict.NOTHING
    if place_of(cause) != column(fault):
        return Verdict.WRONG
    is_kind = cause.kind in TELLS.get(fault.kind, frozenset())
    is_message = cause.kind in OF_MESSAGE and fault.target in SPEC_OF_NAME
    is_named = is_message or fault.target in ECU_OF_DRIVE
    if is_named and cause.subject != fault.target:
        return Verdict.PLACE
    return Verdict.RIGHT if is_kind else Verdict.PLACE


OF_MESSAGE = frozenset(
    {_C.MESSAGE_MISSING, _C.MESSAGE_UNUSABLE, _C.MESSAGE_REPEATED, _C.FOREIGN_SENDER}
)


def place_of(cause: Cause) -> str:
    """The column of the matrix that a cause belongs to."""
    if cause.kind in PLACELESS:
        return ALL
    if cause.kind is CauseKind.EMERGENCY_STOP:
        return "Supervisor"
    name = cause.subject.partition(".")[0]
    if name in SPEC_OF_NAME:
        return SPEC_OF_NAME[name].sender or ALL
    return PLACE_OF.get(name, name)


HEAD = """# What `dbw why` says of each fault

Written by `make matrix`; a test compares it with what happens. Every fault of the
[fault matrix](fault-matrix.md) that ends a drive, alone, in {seeds} drives; `dbw why` is given the
log and nothing else. *Right*: it names the part and what is wrong with it, as far as frames can
tell (a node that has crashed, hangs or is cut off is "silent" to all). *Place*: it names the part,
and not the kind of fault.

**{right} of {total} right ({right_share:.1%}), {place} more the right place, {wrong} wrong.**

| fault | ends drives | right | place | wrong | otherwise said |
|---|---|---|---|---|---|
"""


def explained(found: Iterable[Future], seeds: int = len(SEEDS)) -> str:
    """The document: of every fault that ended a drive, by the ledger or by the log."""
    by_kind: dict[FaultKind, list[Future]] = {}
    for future in found:
        if future.result.stops or future.cause is not None:
            by_kind.setdefault(future.fault.kind, []).append(future)
    every = [future for futures in by_kind.values() for future in futures]
    lines = [_row(kind, by_kind[kind]) for kind in KINDS if kind in by_kind]
    right = _count(every, Verdict.RIGHT)
    place = _count(every, Verdict.PLACE)
    head = HEAD.format(
        seeds=seeds, right=right, total=len(every), right_share=right / max(len(every), 1),
        place=place, wrong=len(every) - right - place,
    )
    return head + "\n".join(lines) + "\n"


def _count(futures: Sequence[Future], verdict: Verdict) -> int:
    return sum(verdict_of(future) is verdict for future in futures)


def _row(kind: FaultKind, futures: Sequence[Future]) -> str:
    right, place = _count(futures, Verdict.RIGHT), _count(futures, Verdict.PLACE)
    others = sorted(
        {
            f"{future.fault.target or kind}: {_said(future.cause)}"
            for future in futures if verdict_of(future) is not Verdict.RIGHT
        }
    )
    wrong = len(futures) - right - place
    return f"| {kind} | {len(futures)} | {right} | {place} | {wrong} | {'; '.join(others)} |"


def _said(cause: Cause | None) -> str:
    return "nothing" if cause is None else f"{cause.kind} {cause.subject}".strip()
