"""The emergency measure on one seed: times that can be true, and findings that would be told."""

from __future__ import annotations

import math
import multiprocessing

import pytest

from bench import emergency, false_trips
from bench.causes import CAUSES, Budget, brake_budget_ns, bus_budget_ns
from bench.emergency import CauseResult, EmergencyResult, Sample
from bench.rig import TABBY, Rig
from bench.spread import spread
from campaign.fork import in_a_fork
from canbus.node import NODE_IDS

MS = 1_000_000
FREE = false_trips.FaultFree(drives=1, span_s=1.0, frames=1, trips=())

pytestmark = [
    pytest.mark.whole_car,
    pytest.mark.filterwarnings("ignore:.*use of fork.*:DeprecationWarning"),
]


def sample(bus_ns: int | None, brake_ns: int | None, seed: int = 7) -> Sample:
    return Sample(
        cause="bus silent", seed=seed, bus_ns=bus_ns, brake_ns=brake_ns, lead_ns=0, first="-"
    )


def test_each_kind_of_cause_reaches_bus_and_brake_within_plausible_times() -> None:
    names = ["emergency-stop input", "Throttle dead", "planner silent", "NMT stop of Steering",
             "bus silent", "forged STEER_COMMAND"]
    results = emergency.measure_causes([0], names)
    assert [result.cause.name for result in results] == names
    for result in results:
        (only,) = result.samples
        assert only.seed == 0 and only.brake_ns is not None
        assert 0.2e9 < only.brake_ns < 0.5e9
        if result.cause.is_heard:
            assert only.bus_ns is not None and 0 < only.bus_ns < 0.12e9
            assert " ER" in only.first
        else:
            assert only.first == "-"
    tables = EmergencyResult(
        quick=True, seeds=1, causes=results, losses=(), fault_free=FREE
    ).tables()
    assert len(tables) == 2
    assert all(len(row) == len(table.headers) for table in tables for row in table.rows)


def test_one_seed_gives_the_same_times_twice() -> None:
    names = ["steering motor dead in a turn"]
    first, second = (emergency.samples_of_seed(3, names) for _ in range(2))
    assert first == second
    assert first[0].lead_ns > 0


def test_the_budgets_are_the_designs() -> None:
    budgets = {
        Budget.SENSED: 20.54 * MS,
        Budget.SILENT: 75 * MS,
        Budget.PLANNER: 100 * MS,
    }
    for cause in CAUSES.values():
        if cause.budget is Budget.MONITOR:
            assert bus_budget_ns(cause, TABBY) == cause.hold_ns + budgets[Budget.SENSED]
        else:
            assert bus_budget_ns(cause, TABBY) == budgets[cause.budget]
        assert brake_budget_ns(cause, TABBY) - bus_budget_ns(cause, TABBY) == 290 * MS


def test_every_node_dies_and_falls_silent_in_the_measure() -> None:
    assert {f"{node} {how}" for node in NODE_IDS for how in ("dead", "mute")} <= CAUSES.keys()


def test_a_cause_that_brakes_late_or_never_is_told_with_its_seed() -> None:
    cause = CAUSES["Throttle dead"]
    good, late = sample(70 * MS, 350 * MS), sample(76 * MS, 350 * MS, seed=13)
    assert CauseResult(cause=cause, samples=(good,)).is_within_budget
    for bad in (late, sample(70 * MS, 366 * MS), sample(None, 350 * MS), sample(70 * MS, None)):
        assert not CauseResult(cause=cause, samples=(good, bad)).is_within_budget
    result = CauseResult(cause=cause, samples=(good, late))
    assert result.worst("bus_ns").seed == 13
    assert result.median_ns("bus_ns") == 73 * MS
    table = EmergencyResult(
        quick=True, seeds=2, causes=(result,), losses=(), fault_free=FREE
    ).tables()[0]
    assert "**MISSED**" in table.rows[0] and "13" in table.rows[0]


def test_a_silent_bus_is_judged_by_the_brake_alone() -> None:
    result = CauseResult(cause=CAUSES["bus silent"], samples=(sample(None, 350 * MS),))
    assert result.is_within_budget
    assert math.isinf(result.median_ns("bus_ns"))


@pytest.mark.parametrize("situation", list(false_trips.Situation), ids=lambda s: s.name)
def test_some_lost_frames_trip_nothing(situation: false_trips.Situation) -> None:
    run = false_trips.LossRun(situation=situation, seed=1, stride=61, one_receiver=False)
    losses = false_trips.losses_of(run)
    assert len(losses) == 4
    assert all(loss.can_id is not None and not loss.trip for loss in losses)


def test_a_lost_frame_that_trips_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here the planner falls silent at the same time."""
    run = false_trips.LossRun(
        situation=false_trips.Situation.DRIVING, seed=1, stride=200, one_receiver=False
    )
    drive_to = Rig.drive_to

    def drive_and_fall_silent(rig: Rig, speed_mps: float, curvature_per_m: float) -> None:
        drive_to(rig, speed_mps, curvature_per_m)
        rig.is_silent = True

    monkeypatch.setattr(Rig, "drive_to", drive_and_fall_silent)
    losses = false_trips.losses_of(run)
    assert all("ER5 PLANNER_SILENT" in loss.trip and "seed 1" in loss.trip for loss in losses)


def test_a_drive_without_faults_is_counted() -> None:
    result = false_trips.measure_fault_free([0], 3.0)
    assert result.trips == () and result.span_s == 3.0
    assert result.frames > 3000


def test_a_fork_answers_and_leaves_its_parent_as_it_was() -> None:
    box = [1]

    def work() -> int:
        box.append(2)
        return sum(box)

    assert in_a_fork(work) == 3
    assert box == [1]


def test_a_fork_that_fails_is_not_taken_for_an_answer(capfd: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        raise ValueError("no answer")

    with pytest.raises(RuntimeError, match="forked run failed"):
        in_a_fork(work)
    assert "no answer" in capfd.readouterr().err


def test_work_is_spread_in_order() -> None:
    assert spread(abs, [-3, 2, -1]) == [3, 2, 1]
    assert spread(abs, []) == []


def test_work_that_fails_ends_its_workers() -> None:
    with pytest.raises(ValueError, match="no number"):
        spread(int, ["no number", "none either"])
    assert multiprocessing.active_children() == []
