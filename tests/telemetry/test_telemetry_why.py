"""Why a drive ended: the cause from the frames alone, against what was injected."""

from __future__ import annotations

import pytest

from campaign.futures import BEGIN_NS
from canbus.frame import Frame, FrameKind
from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import Mode, ModeRequest, Request
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from telemetry.why.incident import CauseKind, Deed, Incident, Kind
from telemetry.why.watch import FRAMES_MAX, CodeOnset, ModeChange, Watch
from telemetry.why.window import Silence
from telemetry.why.words import lines_of, summary
from tests.telemetry.why_drives import VEHICLE, frames_with, incidents_of, told_of

pytestmark = pytest.mark.whole_car

NS_PER_S = 1_000_000_000
CRASH = Fault(kind=FaultKind.CRASH, target="Throttle")


def clock(time_ns: int) -> str:
    return f"{time_ns / NS_PER_S:.3f} s"


def the_end(*faults: Fault) -> Incident:
    """The first incident that ended the drive."""
    return next(
        item for item in incidents_of(frames_with(*faults))
        if item.kind is not Kind.REFUSED_ENGAGEMENT and item.time_ns >= BEGIN_NS
    )


def test_a_node_that_dies_is_named_with_its_last_frame_and_the_time_it_was_overdue() -> None:
    end = the_end(CRASH)
    trigger = end.cause.trigger
    assert (end.cause.kind, end.cause.subject) == (CauseKind.NODE_SILENT, "Throttle")
    assert isinstance(trigger, Silence)
    assert trigger.spec.name == "THROTTLE_STATUS"
    assert trigger.timeout_ns == SPEC_OF_NAME["THROTTLE_STATUS"].timeout_ns
    assert trigger.last.time_ns < BEGIN_NS < trigger.overdue_ns < end.time_ns
    assert trigger.back_ns is None
    assert summary(end, clock).startswith(
        "The car braked because the throttle ECU fell silent: its last THROTTLE_STATUS came at "
        f"{clock(trigger.last.time_ns)} and was overdue 60 ms later. At {clock(end.time_ns)} "
    )


def test_who_said_so_first_and_what_each_node_did_are_told_in_order() -> None:
    end = the_end(CRASH)
    assert end.first_said is not None and end.first_said.node == "SafetyMonitor"
    assert (end.mode_before, end.mode_after) == (Mode.AUTOMATIC, Mode.EMERGENCY)
    times_ns = [action.time_ns for action in end.actions]
    assert times_ns == sorted(times_ns)
    did = {(action.node, action.deed) for action in end.actions}
    assert {
        ("Throttle", Deed.SILENT), ("SafetyMonitor", Deed.CALLED), ("Supervisor", Deed.MODE),
        ("BrakeServo", Deed.SET_BRAKE), ("BrakeServo", Deed.BRAKE_FULL),
    } <= did
    assert [budget.is_kept for budget in end.budgets] == [True, True]
    assert "\n".join(lines_of(end, clock)).count("kept") == 2


@pytest.mark.parametrize(
    ("fault", "kind", "subject"),
    [
        (Fault(kind=FaultKind.DROP, target="STEER_STATUS"), "message_missing", "STEER_STATUS"),
        (Fault(kind=FaultKind.TRUNCATE, target="BRAKE_STATUS"), "message_unusable", "BRAKE_STATUS"),
        (Fault(kind=FaultKind.SPOOF, target="SUPERVISOR_STATE"), "foreign_sender",
         "SUPERVISOR_STATE"),
        (Fault(kind=FaultKind.RESTART, target="BrakeServo"), "node_restarted", "BrakeServo"),
        (Fault(kind=FaultKind.DEAF, target="Steering"), "node_deaf", "Steering"),
        (Fault(kind=FaultKind.CLOCK_JUMP, target="Gateway"), "node_late", "Gateway"),
        (Fault(kind=FaultKind.BABBLE, target="Throttle"), "message_repeated", "THROTTLE_STATUS"),
        (Fault(kind=FaultKind.BROWN_OUT), "power_lost", ""),
        (Fault(kind=FaultKind.NOISE, for_s=1.0), "bus_silent", ""),
        (Fault(kind=FaultKind.FLOOD, for_s=1.0), "bus_flooded", "0x000"),
        (Fault(kind=FaultKind.SENSOR_NAN, target="Throttle.pedal_ratio"), "sensor",
         "THROTTLE_DRIVER.pedal_ratio"),
        (Fault(kind=FaultKind.PLANNER_FROZEN), "planner_silent", ""),
        (Fault(kind=FaultKind.DRIVER_GRABS, target="emergency_stop"), "emergency_stop", ""),
        (Fault(kind=FaultKind.DRIVER_GRABS, target="steering"), "driver", "steering_wheel"),
        (Fault(kind=FaultKind.DRIVER_GRABS, target="button"), "button", "button"),
    ],
    ids=str,
)
def test_the_cause_is_what_was_injected(fault: Fault, kind: str, subject: str) -> None:
    cause = the_end(fault).cause
    assert (cause.kind, cause.subject) == (kind, subject)


def test_a_drivers_touch_ends_a_drive_and_is_no_emergency() -> None:
    end = the_end(Fault(kind=FaultKind.DRIVER_GRABS, target="brake"))
    assert end.kind is Kind.DISENGAGEMENT and end.mode_after is Mode.MANUAL
    (budget,) = end.budgets
    assert budget.name == "touch to MANUAL" and budget.is_kept
    assert summary(end, clock).startswith("The drive ended because the driver pressed the brake")


def test_two_causes_at_once_are_both_told() -> None:
    end = the_end(CRASH, Fault(kind=FaultKind.CRASH, target="Steering"))
    assert {cause.subject for cause in end.causes} == {"Throttle", "Steering"}
    assert {cause.kind for cause in end.causes} == {CauseKind.NODE_SILENT}


def test_a_log_that_begins_in_an_emergency_says_that_its_cause_is_not_there() -> None:
    late_ns = BEGIN_NS + 500_000_000
    frames = [item for item in frames_with(CRASH) if item[0] >= late_ns]
    first = incidents_of(frames)[0]
    assert first.kind is Kind.EMERGENCY_BRAKE and first.mode_before is None
    assert first.remarks[0].startswith("the frames begin in the middle")
    assert first.codes


def test_a_log_that_ends_at_once_tells_how_far_it_goes() -> None:
    end_ns = the_end(CRASH).time_ns + 50_000_000
    frames = [item for item in frames_with(CRASH) if item[0] <= end_ns]
    (cut,) = (item for item in incidents_of(frames) if item.time_ns >= BEGIN_NS)
    assert cut.cause.subject == "Throttle"
    assert cut.remarks[-1].startswith("the frames end 4") or "50 ms" in cut.remarks[-1]
    assert cut.budgets[-1].took_ns is None


def test_a_gap_in_a_log_is_no_silent_bus_where_the_mode_tells_of_a_drive_that_ended_in_it() -> None:
    frames = frames_with(Fault(kind=FaultKind.DRIVER_GRABS, target="brake"))
    begin_ns, end_ns = BEGIN_NS - 200_000_000, BEGIN_NS + 300_000_000
    kept = [item for item in frames if not begin_ns < item[0] < end_ns]
    end = next(item for item in incidents_of(kept) if item.time_ns >= begin_ns)
    assert end.kind is Kind.DISENGAGEMENT and end.mode_before is Mode.AUTOMATIC
    assert any(remark.startswith("nothing was heard for 5") for remark in end.remarks)


def test_an_ordinary_drive_has_no_incident() -> None:
    assert [i for i in incidents_of(frames_with()) if i.time_ns > BEGIN_NS - NS_PER_S] == []


def test_an_empty_log_and_a_foreign_one_tell_nothing() -> None:
    assert told_of([]) == []
    foreign = [(n * 1_000_000, Frame(0x4A0 + n % 7, bytes([n % 256]))) for n in range(2000)]
    foreign += [(3 * NS_PER_S, Frame(0x181, bytes(8), FrameKind.EXTENDED))]
    assert told_of(foreign) == []


def test_a_refused_engagement_tells_in_the_gateways_words_what_stood_against_it() -> None:
    quiet = [item for item in frames_with() if item[0] < 400_000_000]
    spec = SPEC_OF_NAME["MODE_REQUEST"]
    request = ModeRequest(request=Request.ENGAGE, planner_period_ms=20, sequence=7)
    asked = [
        (100_000_000 + n * 20_000_000, encode(spec, request, n % 15)) for n in range(10)
    ]
    (refused,) = incidents_of(sorted([*quiet, *asked], key=lambda item: item[0]))
    assert refused.kind is Kind.REFUSED_ENGAGEMENT
    assert refused.time_ns == asked[0][0]
    assert refused.cause.kind is CauseKind.INHIBITED
    assert refused.cause.text == refused.refusals[-1].text
    assert refused.cause.trigger is not None


def test_each_code_comes_with_the_second_before_and_the_second_after() -> None:
    onsets = [item for item in told_of(frames_with(CRASH)) if isinstance(item, CodeOnset)]
    assert {onset.code.name for onset in onsets} >= {"ER1", "ER2"}
    for onset in onsets:
        first_ns, last_ns = onset.frames[0][0], onset.frames[-1][0]
        assert 0.98 * NS_PER_S < onset.time_ns - first_ns <= NS_PER_S
        assert 0.98 * NS_PER_S < last_ns - onset.time_ns <= NS_PER_S


def test_every_change_of_the_mode_is_told_at_once() -> None:
    modes = [item.after for item in told_of(frames_with(CRASH)) if isinstance(item, ModeChange)]
    assert modes[-1] is Mode.EMERGENCY
    assert Mode.AUTOMATIC in modes


def test_what_is_remembered_is_bounded_however_much_comes_at_once() -> None:
    watch = Watch(VEHICLE)
    for _ in range(FRAMES_MAX + 5000):
        assert list(watch.take(0, Frame(0x4A0))) == []
    assert len(watch._ring) == FRAMES_MAX
    for n in range(20_000):  # ten seconds of a full bus: only the last ones stay
        list(watch.take(n * 500_000, Frame(0x4A0)))
    assert len(watch._ring) < 9_000


def test_a_bus_that_falls_silent_is_told_of_when_time_has_passed() -> None:
    end_ns = the_end(CRASH).time_ns
    watch = Watch(VEHICLE)
    told = [
        item for time_ns, frame in frames_with(CRASH) if time_ns <= end_ns + 100_000_000
        for item in watch.take(time_ns, frame)
    ]
    assert not any(isinstance(i, Incident) and i.time_ns >= BEGIN_NS for i in told)
    assert any(isinstance(item, Incident) for item in watch.elapse(end_ns + 2 * NS_PER_S))
