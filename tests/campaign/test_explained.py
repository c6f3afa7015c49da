"""What `dbw why` says of a fault, beside what was injected."""

from __future__ import annotations

import pytest

from campaign.explained import Verdict, explained, verdict_of
from campaign.futures import Future
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from telemetry.why.incident import Cause, CauseKind
from tests.campaign.fakes import result_of

CRASH = Fault(kind=FaultKind.CRASH, target="Throttle")
DEAD = Fault(kind=FaultKind.DRIVE_DEAD, target="LeftWheelDrive")
DROP = Fault(kind=FaultKind.DROP, target="STEER_STATUS")
STOPPED = result_of(1)
assert STOPPED.stops


def future(fault: Fault, kind: CauseKind, subject: str) -> Future:
    cause = Cause(kind=kind, subject=subject, since_ns=None, trigger=None, text="")
    return Future(fault=fault, result=STOPPED, cause=cause)


@pytest.mark.parametrize(
    ("fault", "kind", "subject", "verdict"),
    [
        (CRASH, CauseKind.NODE_SILENT, "Throttle", Verdict.RIGHT),
        (CRASH, CauseKind.NODE_LATE, "Throttle", Verdict.PLACE),
        (CRASH, CauseKind.NODE_SILENT, "Steering", Verdict.WRONG),
        (DROP, CauseKind.MESSAGE_MISSING, "STEER_STATUS", Verdict.RIGHT),
        (DROP, CauseKind.MESSAGE_MISSING, "STEER_DRIVER", Verdict.PLACE),
        (DEAD, CauseKind.NODE_SILENT, "LeftWheelDrive", Verdict.RIGHT),
        (DEAD, CauseKind.NODE_SILENT, "RightWheelDrive", Verdict.PLACE),
        (DEAD, CauseKind.NODE_SILENT, "Throttle", Verdict.PLACE),
        (DEAD, CauseKind.NODE_SILENT, "SteeringDrive", Verdict.WRONG),
    ],
)
def test_the_part_and_what_is_wrong_with_it_must_both_be_named(
    fault: Fault, kind: CauseKind, subject: str, verdict: Verdict
) -> None:
    assert verdict_of(future(fault, kind, subject)) is verdict


def test_the_document_counts_what_is_not_right() -> None:
    right = future(CRASH, CauseKind.NODE_SILENT, "Throttle")
    nothing = Future(fault=CRASH, result=STOPPED, cause=None)
    went_on = Future(fault=CRASH, result=result_of(0), cause=None)
    assert verdict_of(nothing) is Verdict.NOTHING
    text = explained([right, nothing, went_on])
    assert "**1 of 2 right (50.0%), 0 more the right place, 1 wrong.**" in text
    assert "| crash | 2 | 1 | 0 | 1 | Throttle: nothing |" in text
