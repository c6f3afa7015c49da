"""The stack as a user has it: `dbw up`, `dbw status`, a planner, `dbw down`, on vcan0.

One story on one stack, in the order of the tests: starting seven Pythons is what takes time.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from statistics import mean
from typing import Any

import pytest

from canbus.node import NODE_IDS, PERIOD_NS
from dbc.endpoint import ID_OF_NAME, sent_by
from dbc.harness import BrakeActuatorWire, PlantMotionWire
from dbc.messages import SPECS, Heartbeat, HeartbeatState, Mode, Verdict
from dbw.drive import drive, get_ready
from dbw.plan import DrivePlan, make_plan
from dbw.wall_stage import WallStage
from planner.errors import tracking_errors
from planner.road import open_road
from runtime.launch import known_channels
from runtime.nodes import NODES, STOP_ORDER
from runtime.realtime import keep_collections_short
from tests.vcan import LOAD_S_MAX
from tests.vcan.bus_log import HARNESS_BUS, Line, candump, read_log
from tests.vcan.forked import said_by_dbw
from tests.vcan.shell import cansend
from tests.vcan.stack import VEHICLE, VEHICLE_BUS, pause
from vehicles import load_vehicle

DBW = [sys.executable, "-m", "dbw"]
UP = ["up", "--interface", "socketcan", "--channel", VEHICLE_BUS, "--harness-channel", HARNESS_BUS]
DOWN_S_MAX = 30.0
PLANNER_PERIOD_NS = 100_000_000
"""The emulated processor is too slow for a first decision within 85 ms, the limit at 20 ms."""
SEGMENT_M = 20.0
ERROR_M_MAX = 0.15
HEARTBEAT_ID = 0x700
MARK_ID = 0x7FE
"""Nobody's."""
STANDING_MPS = 0.01


class Launched:
    """A `dbw up`, and what is on its buses."""

    def __init__(self, folder: Path) -> None:
        self.bus_log, self.output = folder / "bus.log", folder / "up.txt"
        with self.output.open("wb") as sink:
            self.process = subprocess.Popen([*DBW, *UP], stdout=sink, stderr=sink)

    def log(self, since_s: float = 0.0, channel: str = VEHICLE_BUS) -> list[Line]:
        """What was on a bus."""
        return [line for line in read_log(self.bus_log, since_s) if line.channel == channel]

    def whole_log(self, channel: str) -> list[Line]:
        """The same, to the last frame: candump may be late, so that its end is marked."""
        since_s = cansend(f"{MARK_ID:03X}#", channel)
        while not any(line.can_id == MARK_ID for line in self.log(since_s, channel)):
            pause(0.05)
        return [line for line in self.log(channel=channel) if line.can_id != MARK_ID]

    def newest(self, name: str) -> Any:
        """A message's content; None when it has not come of late."""
        lines = reversed(self.log(time.time() - 0.5))
        return next((line.content for line in lines if line.can_id == ID_OF_NAME[name]), None)

    def wait(self, condition: Callable[[], bool], limit_s: float) -> None:
        """Until the condition holds."""
        deadline_s = time.monotonic() + limit_s
        while not condition():
            assert self.process.poll() is None, self.output.read_text()
            assert time.monotonic() < deadline_s, self.output.read_text()
            pause(0.2)

    def is_in_manual(self) -> bool:
        """Whether the supervisor has seen every node."""
        state = self.newest("SUPERVISOR_STATE")
        return state is not None and state.mode is Mode.MANUAL


@pytest.fixture(scope="module")
def plan() -> DrivePlan:
    plan = make_plan(
        vehicle=load_vehicle(VEHICLE), road=open_road("campus"),
        planner_period_ns=PLANNER_PERIOD_NS, distance_m=SEGMENT_M,
    )
    keep_collections_short()
    return plan


@pytest.fixture(scope="module")
def up(plan: DrivePlan, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launched]:
    """Up, in MANUAL."""
    folder = tmp_path_factory.mktemp("up")
    with candump(folder / "bus.log", VEHICLE_BUS, HARNESS_BUS):
        launched = Launched(folder)
        try:
            launched.wait(launched.is_in_manual, LOAD_S_MAX)
            yield launched
        finally:
            launched.process.terminate()
            launched.process.wait()


def stage_on(plan: DrivePlan) -> WallStage:
    """A planner and a driver's hand for a stack that others have started."""
    return WallStage(
        plan, 0, interface="socketcan", channel=VEHICLE_BUS, harness_channel=HARNESS_BUS,
        stack=nullcontext(), check_stack=lambda: None,
    )


def said(folder: Path, *arguments: str) -> str:
    """A `dbw` that must succeed; answers what it says."""
    code, out, errors = said_by_dbw(*arguments, folder=folder)
    assert code == 0, out + errors
    return out


def beats(lines: list[Line], node: str) -> list[float]:
    """Times between a node's heartbeats."""
    can_id = HEARTBEAT_ID + NODE_IDS[node]
    times_s = [line.time_s for line in lines if line.can_id == can_id]
    return [after - before for before, after in pairwise(times_s)]


def period_s(node: str) -> float:
    """What the DBC says of a node's heartbeat."""
    return SPECS[HEARTBEAT_ID + NODE_IDS[node]].cycle_ns / 1e9


def test_every_node_boots_becomes_operational_and_beats_at_the_dbcs_period(up: Launched) -> None:
    since_s = time.time()
    pause(2.0)
    quiet = up.log(since_s)
    for entry in NODES.values():
        can_id = HEARTBEAT_ID + NODE_IDS[entry.node]
        states = [line.content for line in up.log() if line.can_id == can_id]
        assert states[0] == Heartbeat(state=HeartbeatState.BOOT_UP), entry.node
        assert states[-1] == Heartbeat(state=HeartbeatState.OPERATIONAL), entry.node
        measured_s = beats(quiet, entry.node)
        # Sent by the node's own cycle of 10 ms: one may leave a cycle later, the next is on time.
        assert mean(measured_s) == pytest.approx(period_s(entry.node), abs=0.001), entry.node
        assert max(measured_s) < 1.5 * period_s(entry.node), entry.node


def test_status_hears_everybody(up: Launched, tmp_path: Path) -> None:
    text = said(tmp_path, "status", "--channel", VEHICLE_BUS)
    assert "mode MANUAL" in text and "codes none" in text
    for name, entry in NODES.items():
        assert any(line.split()[0] == name and line.endswith("runs") for line in text.splitlines())
        assert any(entry.node in line and "OPERATIONAL" in line for line in text.splitlines())


def test_a_planner_drives_a_piece_of_the_campus_and_gives_the_car_back(
    up: Launched, plan: DrivePlan
) -> None:
    since_s = time.time()
    with stage_on(plan) as stage:
        end = drive(stage, plan, lambda progress: None)
        assert not end.ended_early, end.ended_early + up.output.read_text()
        assert stage.car.state.mode in (Mode.READY, Mode.MANUAL)
    path = stage.recorder.path()
    errors = tracking_errors(plan.line, path.x_m[path.moving], path.y_m[path.moving])
    assert path.distance_m == pytest.approx(SEGMENT_M, abs=3.0)
    assert errors.max_error_m < ERROR_M_MAX
    log = up.log(since_s)
    verdicts = [line.content for line in log if line.can_id == ID_OF_NAME["SAFETY_VERDICT"]]
    assert Verdict.PERMIT in {verdict.verdict for verdict in verdicts}
    assert mean(beats(log, "Gateway")) == pytest.approx(period_s("Gateway"), abs=0.001)


def test_sigterm_stops_a_driving_car_before_it_ends_anything_and_the_brakes_last(
    up: Launched, plan: DrivePlan
) -> None:
    with stage_on(plan) as stage:
        get_ready(stage)
        stage.car.engage()
        is_told = False
        for state in stage.car.ticks():
            assert state.is_engaged or is_told, up.output.read_text()
            stage.car.command(speed_mps=3.0, curvature_per_m=0.0)  # goes on, whatever happens
            if not is_told and state.speed_mps > 2.0:
                up.process.send_signal(signal.SIGTERM)
                is_told = True
            if up.process.poll() is not None:
                break
    assert up.process.returncode == 0, up.output.read_text()
    assert known_channels() == []
    log, wires = up.whole_log(VEHICLE_BUS), up.whole_log(HARNESS_BUS)
    ended_s = {
        name: max(line.time_s for line in log if line.can_id in sent_by(entry.node))
        for name, entry in NODES.items()
    }
    assert tuple(sorted(NODES, key=lambda name: ended_s[name])) == STOP_ORDER[:-1]
    first_s = min(ended_s.values())
    contents = [line.content for line in wires if line.time_s > first_s]
    motions = [wire for wire in contents if isinstance(wire, PlantMotionWire)]
    brakes = [wire for wire in contents if isinstance(wire, BrakeActuatorWire)]
    assert motions and all(abs(motion.speed_mps) < STANDING_MPS for motion in motions)
    assert brakes and all(brake.servo_position_ratio == 1.0 for brake in brakes)
    # The car's own hardware is stopped last: until the brake ECU's end it missed no cycle.
    assert wires[-1].time_s > ended_s["brake_servo"] - PERIOD_NS / 1e9


def test_down_ends_a_stack_that_is_still_starting(up: Launched, tmp_path: Path) -> None:
    assert up.process.poll() is not None  # ended by the test before
    again = Launched(tmp_path)
    again.bus_log.touch()
    try:
        again.wait(lambda: "stop with Ctrl-C" in again.output.read_text(), LOAD_S_MAX)
        told = said(tmp_path, "down", "--channel", VEHICLE_BUS)
        assert "stopped launcher, plant, steering" in told
        assert again.process.wait(DOWN_S_MAX) == 0, again.output.read_text()
    finally:
        again.process.terminate()
        again.process.wait()
    assert known_channels() == []
