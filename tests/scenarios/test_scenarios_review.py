"""Adversity: strangers with valid frames, overlapping faults, bad roads, odd planners."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame, FrameKind
from canbus.node import NODE_IDS
from dbc.codec import encode
from dbc.endpoint import SPEC_OF_NAME
from dbc.messages import (
    SPECS,
    BrakeCommand,
    BrakeStatus,
    EmergencyBrake,
    ErrorCode,
    Mode,
    MonitorReason,
    NodeState,
    Reason,
    Request,
    SafetyVerdict,
    SteerCommand,
    SteerStatus,
    ThrottleCommand,
    ThrottleStatus,
    Verdict,
)
from dbc.protection import COUNTER_MODULO, protect
from gateway.commands import Decision
from gateway.core import PlannerInputs
from simulation.link import SimulationLink
from simulation.world import World
from tests.scenarios.driving import (
    TABBY,
    Drive,
    ask_as_stranger,
    displace,
    ready,
    replay,
    stopped_in_emergency,
    supervisor_state,
)
from vehicles.vehicle import DriverPolicy

pytestmark = pytest.mark.whole_car

ACTUATORS = ("Steering", "Throttle", "BrakeServo")
NAN = math.nan
DOWNHILL_RAD = -0.08


def assert_stands(drive: Drive) -> None:
    assert drive.brakes_to_standstill(), drive.log()
    drive.run(0.5)
    assert abs(drive.speed) < 0.02 and drive.brake > 0.9
    assert drive.car.truth.relay_closed


# Strangers -----------------------------------------------------------------------------------


@pytest.mark.parametrize("code", list(ErrorCode))
def test_an_emergency_brake_with_any_code_brakes_and_crashes_nobody(code: ErrorCode) -> None:
    drive = Drive().go(3.0)
    message = EmergencyBrake(code=code, reason=Reason.NONE, cause_age_ms=0, reset_epoch=0)
    drive.world.inject(encode(SPEC_OF_NAME["GATEWAY_EMERGENCY_BRAKE"], message, 3))
    drive.run(0.1)
    assert drive.is_in(Mode.EMERGENCY)


def test_a_strangers_engage_request_in_ready_does_not_make_the_car_go() -> None:
    drive = ready()
    drive.speed_mps = 5.0
    drive.run(0.2)  # the planner decides before it engages
    ask_as_stranger(drive, Request.ENGAGE)
    drive.run(2.0)
    assert drive.car.truth.distance_m < 0.05, drive.log()
    assert drive.is_in(Mode.EMERGENCY)
    assert any(e.node == "Gateway" and "FOREIGN_SENDER" in e.text for _, e in drive.world.events)


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.READY, Mode.AUTOMATIC, Mode.INIT])
@pytest.mark.parametrize("epoch", [0, 1])
def test_forged_supervisor_states_release_no_brake(mode: Mode, epoch: int) -> None:
    drive = Drive().go(5.0)
    drive.car.faults.slope_rad = DOWNHILL_RAD
    authorised = mode is Mode.AUTOMATIC
    displace(drive, "SUPERVISOR_STATE", supervisor_state(mode, authorised=authorised, epoch=epoch))
    assert_stands(drive)


def test_forged_states_that_play_a_whole_drive_do_not_move_a_car_in_emergency() -> None:
    drive = stopped_in_emergency(DOWNHILL_RAD)
    began_m = drive.car.truth.distance_m
    drive.speed_mps = 5.0
    for mode in (Mode.MANUAL, Mode.READY, Mode.AUTOMATIC):
        drive.world.wire.witnesses[:] = drive.world.wire.witnesses[:2]
        displace(drive, "SUPERVISOR_STATE", supervisor_state(mode, authorised=True, epoch=1))
        drive.run(0.5)
    assert drive.car.truth.distance_m - began_m < 0.01
    assert drive.brake > 0.9


def test_a_strangers_reset_releases_no_brake_and_the_planners_does() -> None:
    drive = stopped_in_emergency()
    for _ in range(20):
        ask_as_stranger(drive, Request.RESET)
        drive.run(0.02)
    drive.run(0.5)
    assert drive.is_in(Mode.EMERGENCY) and drive.brake > 0.9
    drive.run(1.0)  # the stranger has gone
    drive.request(Request.RESET)
    assert drive.is_in(Mode.MANUAL), drive.log()


FORGED: dict[str, Any] = {
    "STEER_STATUS": SteerStatus(steering_wheel_angle_rad=0.0, applied_steering_wheel_angle_rad=NAN),
    "THROTTLE_STATUS": ThrottleStatus(wheel_speed_radps=0.0, applied_wheel_speed_radps=NAN),
    "BRAKE_STATUS": BrakeStatus(
        servo_position_ratio=1.0, applied_position_ratio=1.0, rear_wheel_speed_radps=0.0
    ),
    "SAFETY_VERDICT": SafetyVerdict(
        verdict=Verdict.PERMIT, reason=MonitorReason.NONE, identifier=0, value=0
    ),
    "STEER_COMMAND": SteerCommand(steering_wheel_angle_rad=9.0, decision_age_ms=0.0),
    "THROTTLE_COMMAND": ThrottleCommand(wheel_speed_radps=26.0, decision_age_ms=0.0),
    "BRAKE_COMMAND": BrakeCommand(position_ratio=0.0, decision_age_ms=0.0),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_stranger_who_takes_a_nodes_place_stops_the_car(name: str) -> None:
    drive = Drive().go(4.0)
    displace(drive, name, FORGED[name])
    drive.run(0.1)
    assert drive.is_in(Mode.EMERGENCY), drive.log()
    assert_stands(drive)


@pytest.mark.parametrize("name", FORGED)
def test_a_stranger_who_takes_a_nodes_place_in_ready_moves_nothing(name: str) -> None:
    drive = ready()
    drive.speed_mps = 5.0
    displace(drive, name, FORGED[name])
    drive.engage(1.0)
    drive.run(1.0)
    assert drive.car.truth.distance_m < 0.05


def recorded_drive() -> list[tuple[int, Frame]]:
    drive = Drive(seed=9).go(4.0, 0.03)
    drive.request(Request.DISENGAGE, 3.5)
    assert drive.is_in(Mode.READY)
    return [(true_ns, frame) for true_ns, _, frame in drive.world.trace.rows]


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.READY])
def test_a_replayed_drive_never_makes_the_car_go(mode: Mode) -> None:
    drive = Drive().start() if mode is Mode.MANUAL else ready()
    drive.speed_mps = 5.0
    replay(drive, recorded_drive())
    assert drive.car.truth.distance_m < 0.05
    assert drive.mode in (Mode.MANUAL, Mode.READY)


def test_a_drive_replayed_into_another_one_stops_it() -> None:
    drive = Drive().go(5.0)
    replay(drive, recorded_drive())
    assert drive.is_in(Mode.EMERGENCY)
    assert_stands(drive)


def random_frame(random: Random) -> Frame:
    """A frame of ours with random content, its CRC right more often than not."""
    spec = SPECS[random.choice(sorted(SPECS))]
    data = bytearray(random.randbytes(spec.length))
    if spec.data_id is not None and random.random() < 0.9:
        data[1] &= 0xF0
        return Frame(spec.can_id, protect(data, spec.data_id, random.randrange(COUNTER_MODULO)))
    if random.random() < 0.2:
        return Frame(spec.can_id, bytes(data[: random.randrange(spec.length + 1)]))
    kind = random.choice((FrameKind.DATA, FrameKind.EXTENDED))
    return Frame(spec.can_id, bytes(data), kind)


@pytest.mark.parametrize("scene", ["init", "manual", "ready", "emergency"])
def test_random_frames_crash_nobody_and_do_not_make_the_car_go(scene: str) -> None:
    scenes: dict[str, Callable[[], Drive]] = {
        "init": Drive,
        "manual": lambda: Drive().start(),
        "ready": ready,
        "emergency": stopped_in_emergency,
    }
    drive, random = scenes[scene](), Random(scene)
    began_m = drive.car.truth.distance_m
    drive.speed_mps = 5.0
    for _ in range(60):
        for _ in range(random.randrange(6)):
            drive.world.inject(random_frame(random))
        drive.run(0.02)
    assert drive.car.truth.distance_m - began_m < 0.05


@pytest.mark.parametrize("can_id", [0x000, 0x001, 0x010, 0x100, 0x7FF])
def test_a_flooded_bus_under_a_driver_brakes_nothing(can_id: int) -> None:
    drive = Drive().start()
    drive.car.driver.throttle_pedal_ratio = 0.3
    drive.run(2.0)
    data = {0x000: bytes([NmtCommand.RESET_NODE, 0]), 0x001: b""}.get(can_id, bytes(8))
    for _ in range(40):
        for _ in range(80):  # nearly all that the bus carries
            drive.world.inject(Frame(can_id, data))
        drive.run(0.02)
        assert drive.brake < 0.02 and not drive.car.truth.relay_closed
    assert drive.is_in(Mode.MANUAL)


@pytest.mark.parametrize("can_id", [0x000, 0x001, 0x100])
def test_a_flood_that_leaves_no_room_stops_the_car(can_id: int) -> None:
    drive = Drive().go(4.0)
    for _ in range(50):
        for _ in range(110):
            drive.world.inject(Frame(can_id, b"" if can_id == 1 else bytes(8)))
        drive.run(0.02)
    assert_stands(drive)


@pytest.mark.parametrize("command", list(NmtCommand))
@pytest.mark.parametrize("scene", ["manual", "ready"])
def test_nmt_to_all_brakes_nobody_who_drives_himself(scene: str, command: NmtCommand) -> None:
    drive = Drive().start() if scene == "manual" else ready()
    before = drive.mode
    drive.world.inject(nmt_frame(command, 0))
    drive.run(0.6)
    assert drive.mode is before and drive.brake < 0.02
    drive.run(1.2)
    assert {drive.node_state(name) for name in ACTUATORS} == {NodeState.RELEASED}
    assert "button" in drive.state.why_not_engaged or before is Mode.READY


# Nodes and their clocks ----------------------------------------------------------------------


@pytest.mark.parametrize("name", list(NODE_IDS))
def test_a_node_that_hears_nothing_stops_the_car(name: str) -> None:
    drive = Drive().go(4.0)
    began_ns = drive.world.now_ns
    drive.world.stations[name].is_deaf = True
    drive.run(0.2)
    assert drive.emergencies[0][0] - began_ns <= 76_000_000
    assert_stands(drive)


@pytest.mark.parametrize("name", list(NODE_IDS))
@pytest.mark.parametrize("scene", ["manual", "ready", "emergency"])
def test_a_node_may_restart_when_nothing_drives(name: str, scene: str) -> None:
    scenes = {"manual": lambda: Drive().start(), "ready": ready, "emergency": stopped_in_emergency}
    drive = scenes[scene]()
    before, brake = drive.mode, drive.brake
    drive.world.stations[name].restart()
    for _ in range(60):
        drive.run(0.02)
        assert drive.brake == pytest.approx(brake, abs=0.15)
    is_forgotten = name == "Supervisor" and before is Mode.READY
    assert drive.mode is (Mode.MANUAL if is_forgotten else before)


def test_a_supervisor_that_restarts_under_a_driver_at_speed_leaves_him_the_car() -> None:
    drive = Drive().start()
    drive.car.driver.throttle_pedal_ratio = 0.3
    drive.run(3.0)
    drive.world.stations["Supervisor"].restart()
    for _ in range(50):
        drive.run(0.02)
        assert drive.brake < 0.02 and not drive.car.truth.relay_closed
    assert drive.is_in(Mode.MANUAL)


@pytest.mark.parametrize("name", [n for n in NODE_IDS if n not in ("Gateway", "SafetyMonitor")])
def test_er2_three_overruns_in_a_row_brake(name: str) -> None:
    drive = Drive().go(4.0)
    delays = iter((7_000_000, 14_000_000, 21_000_000, 28_000_000))
    drive.world.stations[name].lateness_ns = lambda: next(delays, 0)
    drive.run(0.3)
    assert any(e.node == name and "ER2 OVERRUNS" in e.text for _, e in drive.world.events)
    assert_stands(drive)


@pytest.mark.parametrize("ppm", [-9000, 9000])
def test_clocks_nearly_one_per_cent_apart_do_not_trip(ppm: int) -> None:
    drive = Drive()
    for number, station in enumerate(drive.world.stations.values()):
        station.clock.drift_ppm = ppm if number % 2 else -ppm
    drive.go(4.0, 0.03).run(5.0)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()


@pytest.mark.parametrize(
    "name", [spec.name for spec in SPECS.values() if spec.cycle_ns and spec.data_id is not None]
)
def test_two_lost_frames_in_a_row_of_any_kind_do_not_trip(name: str) -> None:
    drive = Drive().go(4.0, 0.03)
    can_id = SPEC_OF_NAME[name].can_id
    for _ in range(3):
        lost: list[Frame] = []

        def is_lost(frame: Frame, lost: list[Frame] = lost) -> bool:
            is_known = any(frame is other for other in lost)  # every receiver is asked about it
            if frame.can_id == can_id and len(lost) < 2 and not is_known:
                lost.append(frame)
                return True
            return is_known

        with drive.losing(is_lost):
            drive.run(0.13)
        assert len(lost) == 2
        drive.run(0.047)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()


def test_a_silent_node_has_its_er2_in_an_emcy_of_the_supervisor() -> None:
    drive = Drive().go(4.0)
    drive.stop_node("Steering")
    drive.run(0.3)
    emcys = [f.data for _, _, f in drive.world.trace.rows if f.can_id == 0x081]
    assert emcys[0][:5] == bytes([2, 0xFF, 0x81, ErrorCode.ER2, Reason.NODE_SILENT])


@pytest.mark.parametrize("scene", ["ready", "automatic", "emergency"])
def test_parameters_are_written_in_manual_alone(scene: str) -> None:
    scenes = {"ready": ready, "automatic": lambda: Drive().go(3.0),
              "emergency": stopped_in_emergency}
    drive = scenes[scene]()
    for name in (*ACTUATORS, "Supervisor"):
        write = bytes([0x23, 0x00, 0x21, 0x01]) + (1000).to_bytes(4, "little")
        drive.world.inject(Frame(0x600 + NODE_IDS[name], write))
        drive.run(0.06)
        answers = [f for _, _, f in drive.world.trace.rows if f.can_id == 0x580 + NODE_IDS[name]]
        assert answers[-1].data[0] == 0x80  # abort
        assert answers[-1].data[4:] == (0x08000022).to_bytes(4, "little")  # not in this state
    assert not [e for _, e in drive.world.events if e.kind.value == "parameter"]


# Overlapping faults --------------------------------------------------------------------------

TROUBLES: dict[str, Callable[[Drive], object]] = {
    "angle lost": lambda d: setattr(d.car.faults, "steering_angle_override_rad", NAN),
    "planner silent": lambda d: setattr(d, "is_planner_silent", True),
    "supervisor dead": lambda d: d.stop_node("Supervisor"),
    "throttle dead": lambda d: d.stop_node("Throttle"),
    "brake dead": lambda d: d.stop_node("BrakeServo"),
    "bus dead": lambda d: d.world.wire.filters.append(lambda *_: False),
    "encoder dead": lambda d: setattr(d.car.faults, "motor_encoder_dead", True),
}


@pytest.mark.parametrize("first", TROUBLES)
@pytest.mark.parametrize("second", ["supervisor dead", "brake dead", "bus dead"])
def test_a_second_fault_30_ms_after_the_first_changes_nothing(first: str, second: str) -> None:
    drive = Drive().go(4.0)
    TROUBLES[first](drive)
    drive.run(0.03)
    TROUBLES[second](drive)
    assert_stands(drive)


@pytest.mark.parametrize("name", ACTUATORS)
def test_no_reset_while_an_actuators_node_is_dead(name: str) -> None:
    drive = Drive().go(3.0)
    drive.stop_node(name)
    assert_stands(drive)
    drive.request(Request.RESET, 0.5)
    drive.press_button()
    assert drive.is_in(Mode.EMERGENCY)
    assert drive.state.why_not_engaged
    drive.world.stations[name].restart()
    drive.run(1.5)
    drive.request(Request.RESET, 0.3)
    assert drive.is_in(Mode.MANUAL), drive.state.why_not_engaged


def test_an_emergency_outlives_its_supervisor_and_the_next_one() -> None:
    drive = stopped_in_emergency()
    drive.stop_node("Supervisor")
    drive.run(5.0)
    assert drive.brake > 0.9
    drive.world.stations["Supervisor"].restart()
    drive.run(0.5)
    assert drive.is_in(Mode.EMERGENCY) and drive.brake > 0.9


# The road ------------------------------------------------------------------------------------


@pytest.mark.parametrize("friction_mu", [0.25, 0.35])
def test_wheels_that_lock_are_no_standstill_for_a_reset(friction_mu: float) -> None:
    drive = Drive().go(7.0)
    drive.car.faults.friction_mu = friction_mu
    drive.request(Request.EMERGENCY_STOP, 0.02)
    while drive.speed > 0.2:
        drive.request(Request.RESET, 0.1)
        assert drive.is_in(Mode.EMERGENCY) or drive.speed < 0.2, f"reset at {drive.speed:.1f} m/s"
    drive.run(2.0)
    drive.request(Request.RESET, 0.5)
    assert drive.is_in(Mode.MANUAL)


@pytest.mark.parametrize("slope_rad", [-0.15, -0.1, 0.1])
def test_a_car_told_to_stand_stands_on_a_hill(slope_rad: float) -> None:
    drive = Drive().go(4.0)
    drive.car.faults.slope_rad = slope_rad
    drive.run(2.0)
    drive.speed_mps = 0.0
    drive.run(6.0)
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    assert abs(drive.speed) < 0.02


def test_a_controlled_stop_ends_on_a_hill_that_is_steeper_than_its_force() -> None:
    drive = Drive().go(2.0)
    drive.car.faults.slope_rad = -0.2
    drive.request(Request.DISENGAGE, 0.1)
    assert drive.run(9.0, until=lambda: drive.mode is Mode.READY), drive.log()
    assert abs(drive.speed) < 0.1 and not drive.emergencies


def test_er3_does_not_come_while_the_car_is_held_at_a_stop_in_automatic() -> None:
    drive = Drive().go(2.0)
    drive.speed_mps = 0.0
    drive.run(3.0)
    drive.car.faults.slope_rad = -0.12
    began_m = drive.car.truth.distance_m
    drive.run(TABBY.brake.on_time_s_max * 1.1)
    assert drive.is_in(Mode.AUTOMATIC) and drive.codes == ()
    assert drive.car.truth.distance_m - began_m < 0.01


# Driver and planner --------------------------------------------------------------------------


def uwa_drive() -> Drive:
    policy = replace(
        TABBY.policy,
        driver_steers_against=DriverPolicy.EMERGENCY,
        driver_brakes_alone=DriverPolicy.EMERGENCY,
    )
    return Drive(vehicle=replace(TABBY, policy=policy)).go(4.0)


@pytest.mark.parametrize("control", [{"steering_torque_nm": 5.0}, {"brake_pedal_ratio": 0.3}])
def test_uwas_policy_brakes_when_the_driver_acts_against_the_system(
    control: dict[str, float],
) -> None:
    drive = uwa_drive()
    for name, value in control.items():
        setattr(drive.car.driver, name, value)
    drive.run(0.1)
    assert drive.first_emergency() == (ErrorCode.ER1, Reason.DRIVER_AGAINST_SYSTEM)
    steering = drive.world.stations["Steering"].node
    if "steering_torque_nm" in control:
        assert math.isnan(steering._status().applied_steering_wheel_angle_rad)
    assert_stands(drive)


def test_uwas_policy_leaves_the_car_to_a_driver_who_wants_more_throttle() -> None:
    drive = uwa_drive()
    drive.car.driver.throttle_pedal_ratio = 0.4
    drive.run(0.1)
    assert drive.is_in(Mode.MANUAL) and not drive.emergencies


def test_a_driver_who_presses_everything_has_the_car() -> None:
    drive = Drive().go(4.0)
    driver = drive.car.driver
    driver.steering_torque_nm, driver.throttle_pedal_ratio = 8.0, 1.0
    driver.brake_pedal_ratio, driver.button_pressed = 1.0, True
    drive.run(1.0)
    driver.button_pressed = False
    drive.run(0.2)
    driver.button_pressed = True
    drive.run(0.5)
    assert drive.is_in(Mode.MANUAL) and not drive.emergencies


@pytest.mark.parametrize("period_s", [0.1, 0.5])
def test_a_slow_planner_drives_and_is_missed_at_its_own_limit(period_s: float) -> None:
    drive = Drive()
    drive.world = World(TABBY, 2, planner_period_ns=round(period_s * 1e9))
    drive.link = SimulationLink(drive.world)
    drive.car = drive.world.car
    drive.world.wire.witnesses.append(drive._witness)

    def decide() -> None:
        decision = Decision(speed_mps=3.0, curvature_per_m=0.0)
        inputs = PlannerInputs(decision=decision, decided_ns=drive.link.now_ns())
        drive.link.submit(inputs)
        drive.world.run_for(period_s)

    drive.start()
    drive.press_button()
    drive.link.submit(PlannerInputs(request=Request.ENGAGE))
    for _ in range(round(6.0 / period_s)):
        decide()
    assert drive.is_in(Mode.AUTOMATIC), drive.log()
    limit_s = 1.5 * period_s + 0.055
    assert drive.state.decision_age_limit_s == pytest.approx(limit_s)
    decided_ns = drive.world.now_ns - round(period_s * 1e9)
    drive.world.run_for(limit_s)
    late_s = (drive.emergencies[0][0] - decided_ns) / 1e9 - limit_s
    assert -0.005 <= late_s <= 0.016
    assert drive.first_emergency() == (ErrorCode.ER5, Reason.PLANNER_SILENT)


def test_engaging_with_a_planner_that_has_fallen_silent_brakes_at_once() -> None:
    drive = ready()
    drive.speed_mps = 5.0
    drive.run(0.3)
    drive.is_planner_silent = True
    drive.run(0.3)
    drive.engage(0.5)
    assert drive.first_emergency()[0] is ErrorCode.ER5
    assert drive.car.truth.distance_m < 0.02
