"""A lap with the reference planner, through the public gateway API alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from dbc.messages import Mode
from dbw.plan import DrivePlan
from dbw.stage import DriveFailed, Stage
from gateway.api import Car
from gateway.errors import DisengageFailed, EngageRefused, LinkFailed
from gateway.sentences import ONLY_THE_BUTTON
from gateway.state import CarState
from planner.localisation import Localiser
from planner.pure_pursuit import DONE_SPEED_MPS, PurePursuit

TICK_NS_MAX: Final = 20_000_000
"""Odometry and samples come at least this often, however slow the planner is."""

READY_S_MAX: Final = 15.0
"""Longest wait for the stack to be healthy: six processes start within some 5 s on two cores."""

STAND_S_MAX: Final = 8.0
"""Longest wait for the car to stand after an early end: a stop takes 3 s on the worst road."""

SETTLE_S: Final = 1.0
"""Least time watched after an early end."""

NS_PER_S: Final = 1_000_000_000


@dataclass(slots=True, kw_only=True, init=False, unsafe_hash=True)
class DriveProgress:
    """What there is to show at a tick."""

    progress_m: Final[float]
    state: Final[CarState]

    def __init__(self, *, progress_m: float, state: CarState) -> None:
        self.progress_m = progress_m
        self.state = state


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveEnd:
    """How a drive ended."""

    ended_early: str
    """Why before its goal; empty when not."""
    fixes_used: int
    fixes_rejected: int


Show = Callable[[DriveProgress], None]


def drive(stage: Stage, plan: DrivePlan, show: Show) -> DriveEnd:
    """Starts up, engages, drives to the goal, disengages.

    Args:
        stage: The stack and the car, entered.
        plan: Where to go.
        show: Called at every tick.

    Raises:
        DriveFailed: The car did not become AUTOMATIC; nothing was driven.
    """
    car = stage.car
    get_ready(stage)
    try:
        car.engage()
    except EngageRefused as error:
        raise DriveFailed(f"the car did not engage: {error}") from error
    session = Session(stage, plan, show)
    try:
        ended_early = session.run()
        stage.recorder.close()
        if ended_early:
            _wait_for_standstill(car)
        else:
            car.disengage()
    except (DriveFailed, LinkFailed) as error:
        ended_early = str(error)
    except DisengageFailed as error:
        ended_early = f"the car did not disengage: {error}"
    return DriveEnd(
        ended_early=ended_early,
        fixes_used=session.localiser.fixes_used,
        fixes_rejected=session.localiser.fixes_rejected,
    )


def get_ready(stage: Stage) -> None:
    """Waits until nothing but the button is missing, and presses it.

    Raises:
        DriveFailed: Something else is missing; says what.
    """
    car = stage.car
    start_ns = car.state.time_ns
    for state in car.ticks(TICK_NS_MAX / NS_PER_S):
        stage.check()
        if state.mode is Mode.READY:
            return
        if state.mode is Mode.MANUAL and state.why_not_engaged == ONLY_THE_BUTTON:
            stage.press_button()
        elif state.time_ns - start_ns > READY_S_MAX * NS_PER_S:
            raise DriveFailed(f"the car did not get ready: {state.why_not_engaged}")


def _wait_for_standstill(car: Car) -> None:
    """Watches the car come to a stand by itself, so that log and pictures show how it did."""
    start_ns = car.state.time_ns
    for state in car.ticks(TICK_NS_MAX / NS_PER_S):
        is_standing = abs(state.speed_mps) < DONE_SPEED_MPS
        waited_ns = state.time_ns - start_ns
        if (is_standing and waited_ns > SETTLE_S * NS_PER_S) or waited_ns > STAND_S_MAX * NS_PER_S:
            return


class Session:
    """From the first decision to the last.

    Args:
        stage: The stack and the car, entered.
        plan: Where to go.
        show: Called at every tick.
    """

    def __init__(self, stage: Stage, plan: DrivePlan, show: Show) -> None:
        self._stage = stage
        self._car: Car = stage.car
        self._plan = plan
        self._show = show
        self._planner = PurePursuit(plan.line, plan.speeds_mps, plan.pursuit)
        self._start_ns = stage.car.state.time_ns
        self._progress_m = 0.0
        self.localiser = Localiser(plan.line.start, self._start_ns)

    def run(self) -> str:
        """Drives; answers why it ended early, or nothing."""
        ticks_per_decision = -(-self._plan.planner_period_ns // TICK_NS_MAX)
        tick_s = self._plan.planner_period_ns / ticks_per_decision / NS_PER_S
        for number, state in enumerate(self._car.ticks(tick_s)):
            self._stage.check()
            if not state.is_engaged:
                return f"mode {_mode_name(state)}: {state.why_not_engaged}"
            if state.time_ns - self._start_ns > self._plan.time_s_max * NS_PER_S:
                return f"not at the goal after {self._plan.time_s_max:.0f} s"
            self.locate(state)
            if number % ticks_per_decision == 0:
                ending = self.decide(state)
                if ending is not None:
                    return ending
            self._show(DriveProgress(progress_m=self._progress_m, state=state))
        return "the connection was closed"

    def locate(self, state: CarState) -> None:
        """Takes in what has been heard of fixes and motion; at every tick."""
        for fix in self._stage.observe():
            self.localiser.fix(fix)
        measured = state.odometry
        if math.isfinite(measured.speed_mps) and math.isfinite(state.curvature_per_m):
            self.localiser.odometry(
                measured.time_ns, measured.speed_mps, state.curvature_per_m
            )

    def decide(self, state: CarState) -> str | None:
        """One decision; answers "" at the goal, a reason when lost, None to go on."""
        if not math.isfinite(state.speed_mps):
            return "the speed is not known: no fresh THROTTLE_STATUS"
        pose = self.localiser.pose(state.time_ns)
        decision = self._planner.decide(
            pose, state.speed_mps, self.localiser.odometry_correction
        )
        self._stage.recorder.add_estimate(state.time_ns, pose.x_m, pose.y_m)
        self._progress_m = decision.progress_m
        is_at_goal = not self._plan.is_whole_lap and decision.progress_m >= self._plan.goal_m
        is_standing = state.speed_mps < DONE_SPEED_MPS
        if decision.done or (is_at_goal and is_standing):
            return ""
        if decision.lost and is_standing:
            return f"the planner lost its line ({decision.lateral_error_m:+.1f} m off it)"
        speed_mps = 0.0 if is_at_goal else decision.speed_mps
        self._car.command(speed_mps=speed_mps, curvature_per_m=decision.curvature_per_m)
        return None


def _mode_name(state: CarState) -> str:
    return "unknown" if state.mode is None else state.mode.name
