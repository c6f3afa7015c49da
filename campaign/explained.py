"""What `telemetry.why` says of every fault of the matrix, beside what was injected.

`python -m campaign.explained` writes `docs/why-faults.md`; a test compares. Each fault strikes
alone in a car that drives itself; the log is all that is looked at.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path

from campaign.fork import in_a_fork
from campaign.matrix import ALL, BEGIN_NS, BEGIN_S, SEEDS, WATCH_S, column, drives
from campaign.run import Scenario
from dbc.endpoint import SPEC_OF_NAME
from simulation.fault_kinds import KINDS, FaultKind
from simulation.faults import Fault
from telemetry.bus_log import BusLog
from telemetry.why.drives import ECU_OF_DRIVE
from telemetry.why.incident import Cause, CauseKind, Incident, Kind
from telemetry.why.watch import Watch
from vehicles import Vehicle

PATH = Path(__file__).parents[1] / "docs" / "why-faults.md"
NS_PER_S = 1_000_000_000

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What was said of one fault that ended a drive.

    Attributes:
        seed: Of the drive.
        fault: Injected.
        cause: Named first; None: no incident.
    """

    seed: int
    fault: Fault
    cause: Cause | None

    @property
    def verdict(self) -> Verdict:
        """The comparison."""
        if self.cause is None:
            return Verdict.NOTHING
        if place_of(self.cause) != column(self.fault):
            return Verdict.WRONG
        is_kind = self.cause.kind in TELLS.get(self.fault.kind, frozenset())
        is_message = self.cause.kind in OF_MESSAGE and self.fault.target in SPEC_OF_NAME
        is_named = is_message or self.fault.target in ECU_OF_DRIVE
        if is_named and self.cause.subject != self.fault.target:
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


def first_cause(log: BusLog, vehicle: Vehicle, from_s: float) -> Cause | None:
    """The cause of the first incident from a time on that ended a drive."""
    watch = Watch(vehicle)
    told = [item for time_ns, frame in log.frames() for item in watch.take(time_ns, frame)]
    told += watch.finish()
    for item in told:
        if (
            isinstance(item, Incident)
            and item.kind is not Kind.REFUSED_ENGAGEMENT
            and item.time_ns >= from_s * NS_PER_S
        ):
            return item.cause
    return None


def answers(seeds: Sequence[int] = SEEDS) -> Iterator[Answer]:
    """One for every fault of the matrix that ended a drive, by the ledger or by the log."""
    for seed, scenario, faults in drives(seeds):
        log = BusLog()
        scenario.world.wire.witnesses.append(log)
        scenario.world.run_until(BEGIN_NS)
        for fault in faults:
            has_ended, cause = in_a_fork(partial(_future, scenario, log, fault))
            if has_ended or cause is not None:
                yield Answer(seed=seed, fault=fault, cause=cause)


def _future(scenario: Scenario, log: BusLog, fault: Fault) -> tuple[bool, Cause | None]:
    """Whether the drive ended in an emergency, by the campaign's own ledger, and what was said."""
    scenario.injector.begin(fault)
    scenario.world.run_until(round((BEGIN_S + WATCH_S) * NS_PER_S))
    return scenario.ledger.stops > 0, first_cause(log, scenario.world.vehicle, BEGIN_S)


HEAD = """# What `dbw why` says of each fault

Written by `python -m campaign.explained`; a test compares it with what happens. Every fault of the
[fault matrix](fault-matrix.md) that ends a drive, alone, in {seeds} drives; `dbw why` is given the
log and nothing else. *Right*: it names the part and what is wrong with it, as far as frames can
tell (a node that has crashed, hangs or is cut off is "silent" to all). *Place*: it names the part,
and not the kind of fault.

**{right} of {total} right ({right_share:.1%}), {place} more the right place, {wrong} wrong.**

| fault | ends drives | right | place | wrong | otherwise said |
|---|---|---|---|---|---|
"""


def document(found: Iterable[Answer], seeds: int = len(SEEDS)) -> str:
    """`docs/why-faults.md`."""
    by_kind: dict[FaultKind, list[Answer]] = {}
    for answer in found:
        by_kind.setdefault(answer.fault.kind, []).append(answer)
    every = [answer for answers in by_kind.values() for answer in answers]
    lines = [_row(kind, by_kind[kind]) for kind in KINDS if kind in by_kind]
    right = _count(every, Verdict.RIGHT)
    place = _count(every, Verdict.PLACE)
    head = HEAD.format(
        seeds=seeds, right=right, total=len(every), right_share=right / max(len(every), 1),
        place=place, wrong=len(every) - right - place,
    )
    return head + "\n".join(lines) + "\n"


def _count(answers: Sequence[Answer], verdict: Verdict) -> int:
    return sum(answer.verdict is verdict for answer in answers)


def _row(kind: FaultKind, answers: Sequence[Answer]) -> str:
    right, place = _count(answers, Verdict.RIGHT), _count(answers, Verdict.PLACE)
    others = sorted(
        {
            f"{answer.fault.target or kind}: {_said(answer.cause)}"
            for answer in answers if answer.verdict is not Verdict.RIGHT
        }
    )
    wrong = len(answers) - right - place
    return f"| {kind} | {len(answers)} | {right} | {place} | {wrong} | {'; '.join(others)} |"


def _said(cause: Cause | None) -> str:
    return "nothing" if cause is None else f"{cause.kind} {cause.subject}".strip()


def main() -> int:
    """Writes the document."""
    PATH.write_text(document(answers()), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
