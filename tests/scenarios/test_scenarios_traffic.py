"""Loss, jitter and repetition on the wire; determinism of the whole world."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from canbus.frame import Frame
from dbc.messages import SPECS, Mode
from tests.scenarios.driving import Drive

pytestmark = pytest.mark.whole_car

CYCLIC = sorted(spec.can_id for spec in SPECS.values() if spec.cycle_ns)


def loses_first(lost: list[Frame], can_id: int, frame: Frame) -> bool:
    """Loses the first frame of an identifier, for every receiver that is asked about it."""
    if frame.can_id == can_id and not lost:
        lost.append(frame)
    return bool(lost) and frame is lost[0]


@pytest.mark.parametrize("can_id", CYCLIC, ids=lambda can_id: SPECS[can_id].name)
def test_one_lost_frame_of_any_kind_never_trips(can_id: int) -> None:
    drive = Drive().go(4.0, 0.03)
    for _ in range(6):
        lost: list[Frame] = []
        with drive.losing(partial(loses_first, lost, can_id)):
            drive.run(0.1)
        assert lost
        drive.run(0.057)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert not drive.emergencies


def test_a_frame_repeated_on_the_wire_moves_nothing_and_brakes_as_a_stranger() -> None:
    drive = Drive().go(5.0)
    rows = drive.world.trace.rows
    old = next(frame for _, _, frame in reversed(rows) if frame.can_id == 0x202)
    angle = drive.car.truth.column_angle_rad
    drive.world.inject(old)
    drive.run(0.05)
    assert abs(drive.car.truth.column_angle_rad - angle) < 0.05


def test_frames_far_more_often_than_the_dbc_allows_stop_the_car() -> None:
    drive = Drive().go(5.0)
    for _ in range(15):
        for _ in range(3):  # with the gateway's own frame 200 a second
            drive.world.inject(Frame(0x202, b"\x00" * 8))
        drive.run(0.02)
    assert drive.is_in(Mode.EMERGENCY), drive.log()


def trace_of(seed: int) -> str:
    drive = Drive(seed).go(4.0, 0.03)
    return drive.world.trace.sha256


def test_one_seed_one_trace_and_another_seed_another() -> None:
    assert trace_of(3) == trace_of(3)
    assert trace_of(3) != trace_of(4)


def test_the_trace_does_not_depend_on_the_hash_seed_of_the_interpreter() -> None:
    code = "from tests.scenarios.test_scenarios_traffic import trace_of; print(trace_of(5))"
    root = Path(__file__).parents[2]
    hashes = set()
    for hash_seed in ("0", "4711"):
        paths = os.pathsep.join([str(root), *sys.path])
        environment = {**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": paths}
        run = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True,
            check=True, timeout=300,
        )
        hashes.add(run.stdout.strip())
    assert len(hashes) == 1


@pytest.mark.parametrize("seed", range(5))
def test_no_false_trip_in_a_fault_free_drive(seed: int) -> None:
    drive = Drive(seed).go(6.0)
    for curvature_per_m in (0.02, -0.03, 0.05, 0.0):
        drive.curvature_per_m = curvature_per_m
        drive.run(2.0)
    drive.speed_mps = 2.0
    drive.run(4.0)
    drive.speed_mps = 0.0
    drive.run(4.0)
    drive.speed_mps = 4.0
    drive.run(5.0)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert not drive.emergencies
