"""Manual and automatic in turn (UAH 5.3, Fig. 28): the driver takes the lap's car over twice.

At 12 s he turns the wheel, drives for 15 s and changes lane by hand; at 73 s he steps on the
throttle and drives faster for 15 s. Each time he gives it back while it rolls. The planner decides
all the time, as it would; no ECU obeys.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from canbus.frame import Frame
from dbc.codec import Decoded, decode
from dbc.endpoint import ID_OF_NAME
from dbc.messages import Mode
from dbw.drive import TICK_NS_MAX, DriveProgress, Session, get_ready
from dbw.plan import DrivePlan
from dbw.virtual_stage import VirtualStage
from experiments.drawing import BASELINE, OURS, SETPOINT, picture
from experiments.response import FloatArray
from experiments.result import (
    Goal,
    Outcome,
    Row,
    Setting,
    ours_at_most,
    ours_within,
)
from experiments.uah.baseline import WHEEL_RADIUS_M
from experiments.uah.path import arc_to, campus_plan, our_stage
from planner.errors import tracking_errors
from planner.pose import Pose
from planner.tracker import LineTracker
from simulation.hands import hand_torque_nm

MANUAL_S: Final = 15.0
WHEEL_S: Final = 12.0
PEDAL_S: Final = 73.0
"""UAH 5.3: when the driver takes over, since AUTOMATIC, and for how long."""
GRIP_NM: Final = 4.0
"""With which he turns a wheel that the motor holds."""
STEP_RATIO: Final = 0.3
"""Of the throttle pedal."""
LANE_CHANGE_M: Final = 1.5
LANE_CHANGE_S: Final = 4.0
FASTER_MPS: Final = 7.4
"""The planned speed is 6.9 m/s; above 7.5 m/s the car would not engage."""
LOOKAHEAD_M: Final = 10.0
PEDAL_PER_MPS: Final = 0.35
CRUISE_RATIO: Final = 0.07
PEDAL_RATIO_MAX: Final = 0.5
HANDOVER_S_MAX: Final = 0.1
SETTLED_M: Final = 0.3
SETTLED_S_MAX: Final = 8.0
AFTER_S: Final = 3.0
"""So long after a switch the ride is looked at."""
JERK_WINDOW_S: Final = 0.5
"""As the envelope's lateral jerk is averaged (ISO 11270)."""
DRIVING: Final = frozenset({Mode.AUTOMATIC, Mode.STOPPING})
SETPOINT_OF: Final = {
    ID_OF_NAME["STEER_STATUS"]: "applied_steering_wheel_angle_rad",
    ID_OF_NAME["THROTTLE_STATUS"]: "applied_wheel_speed_radps",
    ID_OF_NAME["BRAKE_STATUS"]: "applied_position_ratio",
}
ECU_HEARS_NS: Final = 20_000_000
"""A cycle of the supervisor and one of an ECU: then it knows the mode."""


@dataclass(slots=True)
class Wire:
    """What the run needs of the frames, with their true times."""

    mode: Mode | None = None
    switched: list[tuple[int, Mode]] = field(default_factory=list)
    setpoints: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    stray: int = 0
    """Setpoints in force while a human drove."""

    def hear(self, true_ns: int, sender: str, frame: Frame) -> None:
        """A witness of the wire."""
        name = SETPOINT_OF.get(frame.can_id)
        if name is None and frame.can_id != ID_OF_NAME["SUPERVISOR_STATE"]:
            return
        decoded = decode(frame)
        assert isinstance(decoded, Decoded), sender
        if name is None:
            if decoded.message.mode is not self.mode:
                self.mode = decoded.message.mode
                self.switched.append((true_ns, decoded.message.mode))
            return
        value = getattr(decoded.message, name)
        self.setpoints.setdefault(name, []).append((true_ns, value))
        is_known = bool(self.switched) and true_ns - self.switched[-1][0] > ECU_HEARS_NS
        self.stray += self.mode not in DRIVING and is_known and not math.isnan(value)


@dataclass(slots=True, kw_only=True)
class Takeover:
    """One time at which the driver takes the car, and gives it back."""

    start_s: float
    speed_mps: float
    offset_m: float
    """How far left of the planned line he goes."""
    grip_nm: float = 0.0
    step_ratio: float = 0.0
    touched_ns: int = 0
    """True time of his touch."""
    is_over: bool = False


class Driver:
    """The human: takes over, drives along the road, gives back.

    Args:
        stage: The car's.
        plan: Whose line he looks along.
    """

    def __init__(self, stage: VirtualStage, plan: DrivePlan) -> None:
        self._stage = stage
        self._wheelbase_m = plan.vehicle.geometry.wheelbase_m
        self._tracker = LineTracker(plan.line)
        self.takeovers = (
            Takeover(start_s=WHEEL_S, speed_mps=float(plan.speeds_mps.max()),
                     offset_m=LANE_CHANGE_M, grip_nm=GRIP_NM),
            Takeover(start_s=PEDAL_S, speed_mps=FASTER_MPS, offset_m=0.0, step_ratio=STEP_RATIO),
        )  # fmt: skip

    def act(self, time_s: float) -> None:
        """What he does at this time since the first AUTOMATIC."""
        truth = self._stage.world.car.truth
        self._tracker.advance(truth.pose.x_m, truth.pose.y_m)
        for takeover in self.takeovers:
            if takeover.start_s <= time_s < takeover.start_s + MANUAL_S:
                self._drive(takeover, time_s - takeover.start_s)
            elif time_s >= takeover.start_s + MANUAL_S and not takeover.is_over:
                takeover.is_over = True
                self._give_back()

    def _drive(self, takeover: Takeover, since_s: float) -> None:
        world = self._stage.world
        truth, driver = world.car.truth, world.car.driver
        takeover.touched_ns = takeover.touched_ns or world.now_ns
        if truth.relay_closed:  # not his yet
            driver.steering_torque_nm = takeover.grip_nm
            driver.throttle_pedal_ratio = takeover.step_ratio
            return
        share = min(1.0, since_s / LANE_CHANGE_S)
        goal = self._tracker.pose_at(self._tracker.progress_m + LOOKAHEAD_M)
        offset_m = takeover.offset_m * 0.5 * (1.0 - math.cos(math.pi * share))
        goal = Pose(x_m=goal.x_m - offset_m * math.sin(goal.heading_rad),
                    y_m=goal.y_m + offset_m * math.cos(goal.heading_rad),
                    heading_rad=goal.heading_rad)  # fmt: skip
        here = Pose(x_m=truth.pose.x_m, y_m=truth.pose.y_m, heading_rad=truth.pose.heading_rad)
        road_wheel_rad = math.atan(self._wheelbase_m * arc_to(here, goal))
        driver.steering_torque_nm = hand_torque_nm(
            world.car.params.steering, truth, road_wheel_rad
        )
        pedal = CRUISE_RATIO + PEDAL_PER_MPS * (takeover.speed_mps - truth.speed_mps)
        driver.throttle_pedal_ratio = min(PEDAL_RATIO_MAX, max(0.0, pedal))

    def _give_back(self) -> None:
        """Hands and feet off, the button, and the planner's request."""
        driver = self._stage.world.car.driver
        driver.steering_torque_nm = driver.throttle_pedal_ratio = 0.0
        self._stage.press_button()
        self._stage.car.engage()


Sample = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Switched:
    """The run."""

    wire: Wire
    takeovers: tuple[Takeover, ...]
    ended_early: str
    start_ns: int
    """True time of the first AUTOMATIC."""
    time_s: FloatArray
    """Since then, as all of shape (N,)."""
    x_m: FloatArray
    y_m: FloatArray
    speed_mps: FloatArray
    column_angle_rad: FloatArray
    lateral_m: FloatArray
    """Of the planned line."""

    def seconds(self, true_ns: int) -> float:
        """Since the first AUTOMATIC."""
        return (true_ns - self.start_ns) * 1e-9

    def switches(self, mode: Mode) -> list[float]:
        """When the car came into a mode."""
        return [self.seconds(time_ns) for time_ns, found in self.wire.switched if found is mode]


def _show_nothing(_: DriveProgress) -> None:
    """The run is noted tick by tick."""


def switched_lap(plan: DrivePlan, seed: int) -> Switched:
    """One lap with both takeovers."""
    stage, wire = our_stage(plan, seed), Wire()
    stage.world.wire.witnesses.append(wire.hear)
    driver, samples = Driver(stage, plan), list[Sample]()

    def note() -> None:
        truth = stage.world.car.truth
        samples.append((truth.time_ns * 1e-9, truth.pose.x_m, truth.pose.y_m, truth.speed_mps,
                        truth.column_angle_rad))  # fmt: skip

    ending: str | None = None
    with stage:
        get_ready(stage)
        stage.car.engage()
        start_ns = stage.world.now_ns
        session = Session(stage, plan, _show_nothing)
        for state in stage.car.ticks(TICK_NS_MAX * 1e-9):
            if (stage.world.now_ns - start_ns) * 1e-9 > plan.time_s_max:
                ending = "too late"
            session.locate(state)
            ending = ending if ending is not None else session.decide(state)
            note()
            if ending is not None:
                break
            driver.act((stage.world.now_ns - start_ns) * 1e-9)
    time_s, x_m, y_m, speed_mps, column_angle_rad = np.array(samples).T
    return Switched(
        wire=wire, takeovers=driver.takeovers, ended_early=str(ending), start_ns=start_ns,
        time_s=time_s - start_ns * 1e-9, x_m=x_m, y_m=y_m, speed_mps=speed_mps,
        column_angle_rad=column_angle_rad,
        lateral_m=tracking_errors(plan.line, x_m, y_m).lateral_m,
    )  # fmt: skip


def lateral_jerk_mps3(run: Switched, wheelbase_m: float, ratio: float) -> FloatArray:
    """Change of the lateral acceleration per second, over half a second each."""
    curvature = np.tan(run.column_angle_rad / ratio) / wheelbase_m
    window = round(JERK_WINDOW_S / (TICK_NS_MAX * 1e-9))
    lateral = run.speed_mps**2 * curvature
    return np.asarray((lateral[window:] - lateral[:-window]) / JERK_WINDOW_S)


def run(setting: Setting, file: Path) -> Outcome:
    """One lap, in the paper's order."""
    plan = campus_plan()
    lap = switched_lap(plan, setting.seed)
    _draw(file, lap)
    hands = [found for found in lap.switches(Mode.MANUAL) if found > 0.0]
    back = [found for found in lap.switches(Mode.AUTOMATIC) if found > AFTER_S]
    touched = [lap.seconds(takeover.touched_ns) for takeover in lap.takeovers]
    assert len(hands) == len(back) == len(touched), (hands, back, touched)
    geometry, ratio = plan.vehicle.geometry, plan.vehicle.steering.ratio
    jerk = lateral_jerk_mps3(lap, geometry.wheelbase_m, ratio)
    jerk_s = lap.time_s[: jerk.size] + JERK_WINDOW_S
    near = np.any([(jerk_s > at_s) & (jerk_s < at_s + AFTER_S) for at_s in back], axis=0)
    settled = [_settled_s(lap, at_s) for at_s in back]
    limit = plan.vehicle.envelope.lateral_jerk_mps3_max
    figures: tuple[tuple[str, str, str, float, float, Goal], ...] = (
        ("wheel_s", "the wheel is turned", "s", WHEEL_S, touched[0], ours_within(0.01)),
        ("wheel_handover_s", "from the turned wheel to MANUAL", "s", math.nan,
         hands[0] - touched[0], ours_at_most(HANDOVER_S_MAX, "s")),
        ("wheel_manual_s", "by hand after the wheel", "s", MANUAL_S, back[0] - hands[0],
         ours_within(0.05)),
        ("pedal_s", "the throttle pedal is pressed", "s", PEDAL_S, touched[1], ours_within(0.01)),
        ("pedal_handover_s", "from the pressed pedal to MANUAL", "s", math.nan,
         hands[1] - touched[1], ours_at_most(HANDOVER_S_MAX, "s")),
        ("pedal_manual_s", "by hand after the pedal", "s", MANUAL_S, back[1] - hands[1],
         ours_within(0.05)),
        ("null_setpoints", "setpoints in force while a human drives", "", 0.0,
         float(lap.wire.stray), ours_at_most(0.0)),
        ("settled_s", "from AUTOMATIC to within 0.3 m of the line for good", "s", math.nan,
         max(settled), ours_at_most(SETTLED_S_MAX, "s")),
        ("jerk_mps3", "largest lateral jerk in 3 s after AUTOMATIC", "m/s3", math.nan,
         float(abs(jerk[near]).max()), ours_at_most(limit, "m/s3")),
        ("early_count", "runs that ended early", "", 0.0, float(bool(lap.ended_early)),
         ours_at_most(0.0)),
    )  # fmt: skip
    rows = tuple(
        Row(id=f"uah.switching.{name}", paper="uah", quantity=quantity, unit=unit,
            paper_value=paper, ours_value=value, goals=(goal,))
        for name, quantity, unit, paper, value, goal in figures
    )  # fmt: skip
    return Outcome(rows=rows, notes=_NOTES)


_NOTES = (
    "The paper prints the times of its switches and calls them smooth; it gives no other number. "
    f"The driver is a model: {GRIP_NM:g} N m on the wheel, {100 * STEP_RATIO:g} % of the pedal, "
    f"hands that follow the road, {LANE_CHANGE_M:g} m to the left after the first takeover and "
    f"{FASTER_MPS:g} m/s after the second.",
    "The planner goes on deciding while a human drives. The setpoints are those that the ECUs say "
    "are in force: there are none meanwhile. The planner knows its pose all the time, by fixes and "
    "odometry, and takes up the line from where it finds the car.",
)


def _settled_s(lap: Switched, at_s: float) -> float:
    """From a switch until the error stays small, before the next takeover."""
    later = [takeover.start_s for takeover in lap.takeovers if takeover.start_s > at_s]
    until_s = min([*later, float(lap.time_s[-1])])
    watched = (lap.time_s > at_s) & (lap.time_s < until_s)
    far = lap.time_s[watched & (abs(lap.lateral_m) > SETTLED_M)]
    return float(far[-1] - at_s) if far.size else 0.0


def _draw(file: Path, lap: Switched) -> None:
    """As Fig. 28: path, steering wheel, wheel speed; what a human drove in another colour."""
    spans = list(zip(lap.switches(Mode.MANUAL)[-2:], lap.switches(Mode.AUTOMATIC)[-2:],
                     strict=True))  # fmt: skip
    by_hand = np.any([(lap.time_s > a) & (lap.time_s < b) for a, b in spans], axis=0)
    with picture(file, 10.0, rows=3) as (road, wheel, speed):
        road.plot(lap.x_m, lap.y_m, color=OURS, label="automatic")
        road.plot(np.where(by_hand, lap.x_m, np.nan), lap.y_m, color=BASELINE, linewidth=3.0,
                  label="manual")  # fmt: skip
        road.set_aspect("equal")
        road.set_ylabel("y, m")
        road.legend(loc="lower right")
        for axis, name, value in (
            (wheel, "applied_steering_wheel_angle_rad", lap.column_angle_rad),
            (speed, "applied_wheel_speed_radps", lap.speed_mps / WHEEL_RADIUS_M),
        ):
            sent = np.array(lap.wire.setpoints[name])
            axis.plot((sent[:, 0] - lap.start_ns) * 1e-9, np.degrees(sent[:, 1]), color=SETPOINT,
                      linewidth=1.0, linestyle=(0, (4, 2)), label="setpoint in force")
            axis.plot(lap.time_s, np.degrees(value), color=OURS, label="car")
            for begin_s, end_s in spans:
                axis.axvspan(begin_s, end_s, color=BASELINE, alpha=0.15)
            axis.set_xlim(lap.time_s[0], lap.time_s[-1])
        wheel.set_ylabel("steering wheel, deg")
        wheel.legend(loc="upper center")
        speed.set_ylabel("wheel speed, deg/s")
        speed.set_xlabel("time since AUTOMATIC, s")
