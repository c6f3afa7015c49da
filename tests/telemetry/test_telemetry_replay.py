"""A log played once more: when frames are due, and what a node's code makes of its record."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from itertools import islice

import pytest

from canbus.frame import Frame, ReceivedFrame
from canbus.node import PERIOD_NS
from runtime.nodes import NODES, build_node, build_wires
from telemetry.logs.frames import FrameFlag, LogFrame
from telemetry.replay.comparison import Match
from telemetry.replay.schedule import LOOP_PAUSE_NS, Schedule
from telemetry.replay.source import record_of
from telemetry.replay.steps import boot_up_of, cyclic_id, find_steps
from telemetry.replay.through_node import NodeReplay, Record, ReplayError, replay_node
from tests.scenarios.driving import TABBY
from tests.telemetry.replayed import Recorded
from vehicles import Vehicle

pytestmark = pytest.mark.whole_car

MS = 1_000_000
EVERY_NODE = pytest.mark.parametrize("name", NODES)


def at(time_ms: float, can_id: int = 0x123) -> LogFrame:
    return LogFrame(round(time_ms * MS), "can0", can_id, FrameFlag(0), 0, b"")


def due_ms(schedule: Schedule, frames: Iterable[LogFrame], most: int = 100) -> list[float]:
    kept = list(frames)
    return [due_ns / MS for due_ns, _ in islice(schedule.frames(lambda: kept), most)]


# When frames are due ------------------------------------------------------------------------------


def test_frames_are_due_at_the_distances_of_the_log() -> None:
    frames = [at(1000), at(1001.5), at(1500)]
    assert due_ms(Schedule(), frames) == [0.0, 1.5, 500.0]
    assert due_ms(Schedule(speed=2.0), frames) == [0.0, 0.75, 250.0]
    assert due_ms(Schedule(speed=math.inf), frames) == [0.0, 0.0, 0.0]


def test_a_loop_begins_a_cycle_after_the_last_frame_and_may_go_on_for_ever() -> None:
    frames = [at(5), at(7)]
    pause = LOOP_PAUSE_NS / MS
    assert due_ms(Schedule(loops=2), frames) == [0.0, 2.0, 2.0 + pause, 4.0 + pause]
    assert len(due_ms(Schedule(loops=None), frames, most=51)) == 51
    assert due_ms(Schedule(loops=None), []) == []


def test_silences_are_cut_and_time_that_goes_back_is_counted() -> None:
    schedule = Schedule(gap_ns_max=10 * MS)
    assert due_ms(schedule, [at(0), at(5000), at(4000), at(4002)]) == [0.0, 10.0, 10.0, 12.0]
    assert schedule.backwards == 1


# Through a node -----------------------------------------------------------------------------------


@cache
def drive() -> Record:
    """Engaged, into a bend, braked by the planner; the steering node restarted after that."""
    recorded = Recorded()
    recorded.drive.go(4.0, 0.02)
    recorded.drive.stop_node("Throttle")
    recorded.drive.run(1.5)
    recorded.drive.world.stations["Steering"].restart()
    recorded.drive.run(0.5)
    return recorded.record


def through(name: str, record: Record, vehicle: Vehicle = TABBY) -> NodeReplay:
    node = NODES[name].node
    return replay_node(
        node, record, lambda: build_node(name, vehicle), lambda: build_wires(name)
    )


def total(outcome: NodeReplay) -> dict[Match, int]:
    counts: dict[Match, int] = dict.fromkeys(Match, 0)
    for comparison in (outcome.vehicle_bus, outcome.harness):
        for of_message in comparison.counts.values():
            for match, count in of_message.items():
                counts[match] += count
    return counts


@EVERY_NODE
def test_every_node_does_on_its_recorded_inputs_what_the_record_says(name: str) -> None:
    outcome = through(name, drive())
    assert outcome.is_equal, outcome.vehicle_bus.differences[:3] + outcome.harness.differences[:3]
    counts = total(outcome)
    assert counts[Match.EQUAL] > 0.8 * sum(counts.values()) > 500


def test_a_node_that_was_started_again_is_started_again() -> None:
    outcome = through("steering", drive())
    assert len(outcome.restarts) == 1
    assert outcome.is_equal


def test_emergency_brakes_and_emcys_are_among_the_frames_compared() -> None:
    counts = through("supervisor", drive()).vehicle_bus.counts
    assert counts["SUPERVISOR_EMERGENCY_BRAKE"][Match.EQUAL] >= 1
    assert counts["SUPERVISOR_EMCY"][Match.EQUAL] >= 1


def test_code_that_drives_otherwise_is_found() -> None:
    steering = replace(TABBY.steering, position_gain_per_s=TABBY.steering.position_gain_per_s * 1.5)
    outcome = through("steering", drive(), replace(TABBY, steering=steering))
    assert not outcome.is_equal
    first = outcome.harness.differences[0]
    assert first.name == "STEERING_ACTUATOR" and first.match is Match.DIFFERS
    assert set(first.signals) == {"motor_duty_ratio"}


def test_a_reaction_that_the_record_does_not_have_is_found() -> None:
    record = drive()
    status = cyclic_id("Throttle")
    silent_sooner = [
        item for item in record.vehicle_bus
        if item.frame.can_id != status or item.arrival_ns < 5_000 * MS
    ]  # fmt: skip
    outcome = through("supervisor", Record(vehicle_bus=silent_sooner, harness=record.harness))
    early = [one for one in outcome.vehicle_bus.differences if one.match is Match.ONLY_REPLAYED]
    assert "SUPERVISOR_EMERGENCY_BRAKE" in {one.name for one in early}


def test_a_frame_that_a_stranger_sent_in_the_nodes_name_is_an_input() -> None:
    recorded = Recorded()
    recorded.drive.go(4.0)
    forged = next(
        item.frame for item in reversed(recorded.vehicle_bus)
        if item.frame.can_id == cyclic_id("Steering")
    )  # fmt: skip
    recorded.drive.world.run_for(0.004)
    recorded.drive.world.inject(forged)
    recorded.drive.run(0.3)
    outcome = through("steering", recorded.record)
    assert outcome.is_equal, outcome.vehicle_bus.differences[:3]
    assert outcome.vehicle_bus.counts["STEER_EMERGENCY_BRAKE"][Match.EQUAL] >= 1


@pytest.mark.parametrize("node", ["steering", "safety_monitor"])
def test_a_log_without_the_nodes_start_is_refused(node: str) -> None:
    late = [item for item in drive().vehicle_bus if item.arrival_ns > 300 * MS]
    late = [item for item in late if item.frame.can_id != 0x702]
    with pytest.raises(ReplayError, match=r"does not hold the start of .*70\d#00"):
        through(node, Record(vehicle_bus=late, harness=drive().harness))


def test_both_buses_are_wanted() -> None:
    with pytest.raises(ReplayError, match="the harness, vcan1, is not in this log, which has can0"):
        record_of(iter([at(1)]), "can0", "vcan1")


# When a node stepped ------------------------------------------------------------------------------


def steering_frames() -> list[ReceivedFrame]:
    """The node's boot-up, and its first cyclic frames."""
    wanted = (cyclic_id("Steering"), boot_up_of("Steering").can_id)
    frames = [item for item in drive().vehicle_bus if item.frame.can_id in wanted]
    return [frames[0], *(item for item in frames if item.frame.can_id == wanted[0])][:20]


def test_each_cyclic_frame_is_a_step() -> None:
    frames = steering_frames()
    steps = find_steps("Steering", frames)
    cyclic = [item.arrival_ns for item in frames if item.frame.can_id == cyclic_id("Steering")]
    assert [step.frame_ns for step in steps] == [None, *cyclic]


@pytest.mark.parametrize("missing", [1, 3, 6])
def test_steps_whose_frames_are_missing_are_counted_by_the_alive_counter(missing: int) -> None:
    frames = steering_frames()
    steps = find_steps("Steering", [*frames[:5], *frames[5 + missing :]])
    assert len(steps) == len(frames)
    inferred = [step for step in steps if step.frame_ns is None]
    assert len(inferred) == 1 + missing  # the first step has the boot-up alone
    for step, item in zip(steps, frames, strict=True):
        assert abs(step.now_ns - item.arrival_ns) < PERIOD_NS // 5


def test_a_reset_beside_a_cyclic_frame_is_no_step_of_its_own() -> None:
    frames = steering_frames()
    beside = ReceivedFrame(frames[5].arrival_ns - PERIOD_NS // 10, boot_up_of("Steering"))
    assert len(find_steps("Steering", [*frames[:5], beside, *frames[5:]])) == len(frames)


def status(counter: int, time_ms: float) -> ReceivedFrame:
    wanted = cyclic_id("Supervisor")
    frames = (item.frame for item in drive().vehicle_bus if item.frame.can_id == wanted)
    found = next(frame for frame in frames if frame.data[1] & 0x0F == counter)
    return ReceivedFrame(round(time_ms * MS), found)


def test_a_node_that_is_late_after_its_first_step_has_no_steps_between() -> None:
    boot = ReceivedFrame(0, boot_up_of("Supervisor"))
    steps = find_steps("Supervisor", [boot, status(0, 0.1), status(1, 57.0), status(2, 67.0)])
    assert [step.frame_ns for step in steps] == [100_000, 57 * MS, 67 * MS]


def test_a_node_that_is_silent_after_its_boot_up_steps_meanwhile() -> None:
    boot = ReceivedFrame(0, boot_up_of("Supervisor"))
    steps = find_steps("Supervisor", [boot, status(0, 57.0)])
    assert len(steps) == 7
    command = ReceivedFrame(0, Frame(0x101, b"\0"))
    assert len(find_steps("Supervisor", [boot, status(0, 57.0)], [command])) == 2


def test_a_broken_frame_in_the_nodes_name_is_no_step() -> None:
    frames = steering_frames()
    broken = Frame(frames[0].frame.can_id, bytes(8))
    noise = ReceivedFrame(frames[3].arrival_ns + 5 * MS, broken)
    assert len(find_steps("Steering", [*frames[:4], noise, *frames[4:]])) == len(frames)
