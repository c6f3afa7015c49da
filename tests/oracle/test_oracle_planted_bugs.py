"""Every property catches a bug that is planted in a node, and nothing where there is none."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import pytest

import dbc.codec
import ecus.common.actuator_ecu as actuator_ecu
import ecus.supervisor.ecu as supervisor_ecu
import ecus.throttle.ecu as throttle_ecu
from canbus.frame import Frame
from dbc.codec import DECODED, encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import ErrorCode, Inhibit, Mode, NodeState, Request, SteerCommand, Verdict
from ecus.brake_servo.control import ServoRest
from ecus.brake_servo.mode import ACTION as BRAKE_ACTION
from ecus.brake_servo.mode import BrakeAction
from ecus.brake_servo.mode import Situation as BrakeSituation
from ecus.common.actuator_ecu import ActuatorEcu
from ecus.common.codes import REPORT_NS, CodeLatch
from ecus.common.node_state import NODE_STATE_AFTER, NodeEvent
from ecus.steering.ecu import SteeringEcu
from ecus.supervisor.ecu import SupervisorEcu
from ecus.supervisor.mode import AUTHORISED, MODE_AFTER, RELAY_CLOSED, ModeEvent
from ecus.supervisor.standstill import Standstill
from ecus.throttle.direction import Direction
from ecus.throttle.ecu import ThrottleEcu
from ecus.throttle.mode import ACTION as THROTTLE_ACTION
from ecus.throttle.mode import Situation as ThrottleSituation
from ecus.throttle.mode import ThrottleAction
from gateway.direction import TurningRound
from oracle.braking import (
    BrakeKept,
    NoDriveWhileBraking,
    NoFalseEmergency,
    RegenerationReplacesServo,
)
from oracle.commands import NoOldDecision, OnlyIntactCommandsApplied, PathBounded
from oracle.driver import (
    DriverSteersInEmergency,
    DriverWins,
    NothingMovesUnderDriver,
    RelayOpenUnderDriver,
    SteeringCoasts,
)
from oracle.engaging import EngagedInOrder, StartsUp
from oracle.hazards import HazardAnswered, HazardEndsBraked
from oracle.judge import PROPERTIES
from oracle.latches import CodesLatched, EmergencyLatched
from oracle.modes import Authorisation, ModeOrder
from oracle.nodes import OneSender, RejoinsByRearming
from oracle.property import Property
from oracle.reverse import TurnsRoundStanding
from safety_monitor.monitor import SafetyMonitor
from safety_monitor.verdict import VERDICT_OF, Phase, Severity
from simulation.world import in_time
from tests.oracle.watched import Watched

pytestmark = pytest.mark.whole_car

Patch = pytest.MonkeyPatch


@dataclass(frozen=True)
class Planted:
    """A bug, the property that must catch it, and a scenario that brings it to light."""

    name: str
    kind: type[Property]
    plant: Callable[[Patch], None]
    play: Callable[[Watched], object]


# Scenarios ---------------------------------------------------------------------------------------


def planner_turns_round(drive: Watched) -> None:
    drive.away(2.0)
    drive.speed_mps = -1.0
    drive.run(1.0)


def steering_motor_fails(drive: Watched) -> None:
    drive.away(6.0, 0.03)
    drive.break_part("steering_motor_fault", budget_ns=21_000_000)
    drive.run(3.0)


def emergency(drive: Watched) -> None:
    drive.away(6.0).stop().run(3.0)


def servo_sticks(drive: Watched) -> None:
    drive.away(6.0)
    excuses = frozenset({HazardEndsBraked.name})
    drive.break_part("servo_stuck", budget_ns=None, may_stop=False, excuses=excuses)
    drive.stop().run(2.0)


def driver_touches(drive: Watched) -> None:
    drive.away(4.0).touch(throttle_pedal_ratio=0.3)
    drive.run(1.0)
    drive.touch(throttle_pedal_ratio=0.0)
    drive.run(1.5)


def driver_steers_in_emergency(drive: Watched) -> None:
    drive.away(7.0).stop().touch(steering_torque_nm=6.0)
    drive.run(1.0)


def controlled_stop(drive: Watched) -> None:
    drive.away(4.0).request(Request.DISENGAGE, 4.0)


def monitor_dies_in_ready(drive: Watched) -> None:
    drive.to_ready()
    drive.tell("dead monitor")
    drive.stop_node("SafetyMonitor")
    drive.run(0.3)
    drive.engage(0.3)


def nobody_pushes(drive: Watched) -> None:
    drive.world.run_for(1.5)
    drive.engage(0.3)


def node_is_late_once(drive: Watched) -> None:
    drive.away(4.0).tell("late node")
    drive.world.stations["Steering"].lateness_ns = lambda: 56_000_000
    drive.run(0.015)
    drive.world.stations["Steering"].lateness_ns = in_time
    drive.run(4.0)


def reset_while_moving(drive: Watched) -> None:
    drive.away(7.0).stop().request(Request.RESET, 0.5)
    drive.run(1.0)


def node_restarts(drive: Watched) -> None:
    drive.away(4.0).tell("restart")
    drive.world.stations["Steering"].restart()
    drive.run(1.0)


def planner_falls_silent(drive: Watched) -> None:
    drive.away(4.0).tell("silent planner", budget_ns=105_000_000)
    drive.is_planner_silent = True
    drive.run(1.0)


def straight_on(drive: Watched) -> None:
    drive.is_on_path = True
    drive.away(6.0).run(8.0)


def wrong_commands_come(drive: Watched) -> None:
    """The gateway's next command arrives before it is sent, with one bit wrong in its CRC."""
    drive.away(3.0).tell("corruption", budget_ns=None)
    spec = SPEC_OF_NAME["STEER_COMMAND"]
    message = SteerCommand(steering_wheel_angle_rad=4.0, decision_age_ms=0.0)
    for _ in range(20):
        newest = [frame for _, _, frame in drive.world.trace.rows if frame.can_id == spec.can_id]
        frame = encode(spec, message, (newest[-1].data[1] % 16 + 1) % 15)
        drive.from_gateway(Frame(frame.can_id, bytes([frame.data[0] ^ 1]) + frame.data[1:]))
        drive.run(0.02)


def start_alone(drive: Watched) -> None:
    drive.world.run_for(4.0)


# Bugs --------------------------------------------------------------------------------------------


def steering_faults_do_not_brake(patch: Patch) -> None:
    codes = frozenset({ErrorCode.ER0, ErrorCode.ER3, ErrorCode.ER4, ErrorCode.ER6})
    patch.setattr(actuator_ecu, "NOT_BRAKING_CODES", codes)


def emergency_does_not_brake(patch: Patch) -> None:
    patch.setitem(BRAKE_ACTION[NodeState.EMERGENCY], BrakeSituation.NORMAL, BrakeAction.FOLLOW)


def throttle_drives_on(patch: Patch) -> None:
    patch.setattr(throttle_ecu, "BRAKING_RATIO_MIN", 2.0)
    for situation in ThrottleSituation:
        patch.setitem(THROTTLE_ACTION[NodeState.EMERGENCY], situation, ThrottleAction.FOLLOW)


def er3_releases_a_moving_car(patch: Patch) -> None:
    def update(rest: ServoRest, now_ns: int, dt_ns: int, inputs: Any, limit_s: float) -> bool:
        rest.is_resting = bool(inputs.is_loaded)
        return rest.is_resting

    patch.setattr(ServoRest, "update", update)


def no_regeneration(patch: Patch) -> None:
    row = THROTTLE_ACTION[NodeState.EMERGENCY]
    patch.setitem(row, ThrottleSituation.BRAKE_MISSING, ThrottleAction.CUT)


def age_limit_is_too_low(patch: Patch) -> None:
    patch.setattr(ActuatorEcu, "_decision_limit_ns", lambda node: 5_000_000)


def steering_never_lets_go(patch: Patch) -> None:
    patch.setattr(SteeringEcu, "_update_hold", lambda node, now_ns: None)


def steering_ignores_the_hand(patch: Patch) -> None:
    update_hold = SteeringEcu._update_hold

    def without_hand(node: SteeringEcu, now_ns: int) -> None:
        is_active, node.is_driver_active = node.is_driver_active, False
        update_hold(node, now_ns)
        node.is_driver_active = is_active

    patch.setattr(SteeringEcu, "_update_hold", without_hand)


def driver_is_ignored(patch: Patch) -> None:
    patch.setitem(MODE_AFTER[Mode.AUTOMATIC], ModeEvent.DRIVER, Mode.AUTOMATIC)


def relay_closes_in_manual(patch: Patch) -> None:
    patch.setitem(RELAY_CLOSED, Mode.MANUAL, True)


def nodes_stay_active_in_manual(patch: Patch) -> None:
    patch.setitem(NODE_STATE_AFTER[NodeState.ACTIVE], NodeEvent.MANUAL, NodeState.ACTIVE)


def every_car_stands(patch: Patch) -> None:
    patch.setattr(Standstill, "update", lambda standstill, speed_mps, now_ns: True)


def traction_stays_authorised(patch: Patch) -> None:
    axes = frozenset({"steering", "throttle", "brake"})
    patch.setitem(AUTHORISED, Mode.EMERGENCY, axes)


def nothing_denies(patch: Patch) -> None:
    patch.setattr(supervisor_ecu, "engage_inhibit", lambda situation: Inhibit.NOT_REQUESTED)


def the_button_is_not_needed(patch: Patch) -> None:
    patch.setitem(MODE_AFTER[Mode.MANUAL], ModeEvent.NODES_SEEN, Mode.READY)


def monitor_never_permits(patch: Patch) -> None:
    patch.setitem(VERDICT_OF[Phase.PROVEN], Severity.NONE, Verdict.DENY)


def codes_are_not_latched(patch: Patch) -> None:
    def is_reported(latch: CodeLatch, code: ErrorCode, now_ns: int) -> bool:
        seen_ns = latch._seen_ns.get(code)
        return seen_ns is not None and now_ns - seen_ns <= REPORT_NS

    patch.setattr(CodeLatch, "is_reported", is_reported)


def any_reset_is_granted(patch: Patch) -> None:
    patch.setattr(supervisor_ecu, "reset_inhibit", lambda situation: Inhibit.NONE)


def emergency_ends_by_itself(patch: Patch) -> None:
    patch.setitem(MODE_AFTER[Mode.EMERGENCY], ModeEvent.NOTHING, Mode.MANUAL)


def a_restarted_node_drives_on(patch: Patch) -> None:
    event = ActuatorEcu._event

    def always_armed(node: Any, now_ns: int, messages: Any) -> NodeEvent:
        node._is_armed = True
        return event(node, now_ns, messages)

    def starts(node: SupervisorEcu, now_ns: int) -> list[Frame]:
        frames = [watch.start_frame(now_ns) for watch in node.nodes.watches.values()]
        return [frame for frame in frames if frame is not None]

    patch.setattr(ActuatorEcu, "_event", always_armed)
    patch.setattr(SupervisorEcu, "_starts", starts)
    patch.setattr(supervisor_ecu, "driving_faults", lambda *arguments: [])


def a_node_sends_anothers_identifier(patch: Patch) -> None:
    frames = ThrottleEcu._frames

    def with_another(node: ThrottleEcu, now_ns: int) -> list[Frame]:
        return [*frames(node, now_ns), Frame(0x204, bytes(8))]

    patch.setattr(ThrottleEcu, "_frames", with_another)


def nobody_checks_the_crc(patch: Patch) -> None:
    patch.setattr(dbc.codec, "is_intact", lambda data, data_id: True)


def nobody_waits_for_standstill(patch: Patch) -> None:
    def turn(self: Direction, now_ns: int, target_mps: float, *, is_standing: bool) -> None:
        self.sign = -1.0 if target_mps < 0.0 else 1.0

    patch.setattr(Direction, "update", turn)
    patch.setattr(TurningRound, "commanded_mps", lambda self, now_ns, wanted, rolling: wanted)


def nobody_knows_ages(patch: Patch) -> None:
    patch.setattr(ActuatorEcu, "_decision_age_ns", lambda node, now_ns: 0)
    patch.setattr(SafetyMonitor, "_check_decisions", lambda node, now_ns, findings: None)


def the_steering_sensor_is_off_zero(patch: Patch) -> None:
    sense = SteeringEcu._sense

    def off_zero(node: SteeringEcu, now_ns: int, sensors: Any) -> bool:
        angle_rad = sensors.column_angle_rad - 0.3
        return sense(node, now_ns, replace(sensors, column_angle_rad=angle_rad))

    patch.setattr(SteeringEcu, "_sense", off_zero)


PLANTED = (
    Planted("ER4 does not brake", HazardAnswered, steering_faults_do_not_brake,
            steering_motor_fails),
    Planted("no brake in EMERGENCY", HazardEndsBraked, emergency_does_not_brake, emergency),
    Planted("drive torque in EMERGENCY", NoDriveWhileBraking, throttle_drives_on, emergency),
    Planted("ER3 releases a moving car", BrakeKept, er3_releases_a_moving_car, emergency),
    Planted("no regeneration", RegenerationReplacesServo, no_regeneration, servo_sticks),
    Planted("age limit of 5 ms", NoFalseEmergency, age_limit_is_too_low, controlled_stop),
    Planted("ER4 does not coast", SteeringCoasts, steering_never_lets_go, steering_motor_fails),
    Planted("driver ignored", DriverWins, driver_is_ignored, driver_touches),
    Planted("hand ignored", DriverSteersInEmergency, steering_ignores_the_hand,
            driver_steers_in_emergency),
    Planted("relay closed in MANUAL", RelayOpenUnderDriver, relay_closes_in_manual, driver_touches),
    Planted("ACTIVE in MANUAL", NothingMovesUnderDriver, nodes_stay_active_in_manual,
            driver_touches),
    Planted("standstill at any speed", ModeOrder, every_car_stands, controlled_stop),
    Planted("traction in EMERGENCY", Authorisation, traction_stays_authorised, emergency),
    Planted("verdict not needed", EngagedInOrder, nothing_denies, monitor_dies_in_ready),
    Planted("button not needed", EngagedInOrder, the_button_is_not_needed, nobody_pushes),
    Planted("monitor never permits", StartsUp, monitor_never_permits, start_alone),
    Planted("codes not latched", CodesLatched, codes_are_not_latched, node_is_late_once),
    Planted("reset while moving", EmergencyLatched, any_reset_is_granted, reset_while_moving),
    Planted("emergency not latched", EmergencyLatched, emergency_ends_by_itself, emergency),
    Planted("restarted node drives on", RejoinsByRearming, a_restarted_node_drives_on,
            node_restarts),
    Planted("two senders", OneSender, a_node_sends_anothers_identifier, start_alone),
    Planted("CRC not checked", OnlyIntactCommandsApplied, nobody_checks_the_crc,
            wrong_commands_come),
    Planted("age not checked", NoOldDecision, nobody_knows_ages, planner_falls_silent),
    Planted("turns round on the way", TurnsRoundStanding, nobody_waits_for_standstill,
            planner_turns_round),
    Planted("steering off zero", PathBounded, the_steering_sensor_is_off_zero, straight_on),
)


@pytest.fixture(autouse=True)
def forget_decoded_frames() -> Iterator[None]:
    """What was decoded with a bug must not be known afterwards, nor the other way round."""
    for known in DECODED.values():
        known.clear()
    yield
    for known in DECODED.values():
        known.clear()


@pytest.mark.parametrize("planted", PLANTED, ids=lambda planted: str(planted.name))
def test_a_planted_bug_is_caught_by_its_property(planted: Planted, monkeypatch: Patch) -> None:
    planted.plant(monkeypatch)
    drive = Watched(1)
    planted.play(drive)
    report = drive.report()
    assert planted.kind.name in report.counts, f"{report}\n{drive.log()}"


SCENARIOS = {planted.play.__name__: planted.play for planted in PLANTED}


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_without_a_bug_the_same_scenario_breaks_nothing(scenario: str) -> None:
    drive = Watched(1)
    SCENARIOS[scenario](drive)
    report = drive.report()
    assert str(report) == "no violation", drive.log()
    assert math.isfinite(drive.speed)


def test_every_property_has_its_planted_bug() -> None:
    assert {planted.kind for planted in PLANTED} == set(PROPERTIES)
