"""The gateway node: command frames, the decision's age, strangers, CANopen."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest

from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame, FrameKind
from canbus.node import EventKind, Node
from dbc.database import configuration_hash, dbc_hash
from dbc.endpoint import Endpoint
from dbc.messages import (
    BrakeCommand,
    EmergencyBrake,
    ErrorCode,
    HeartbeatState,
    Mode,
    ModeRequest,
    Reason,
    Request,
    SteerCommand,
)
from gateway.command_sender import wire_age_ms
from gateway.commands import CommandError, Decision
from gateway.core import GatewayCore, PlannerInputs
from tests.gateway.scripted import MS, TABBY, Rig, Sent, named
from vehicles.vehicle import VehicleError

COMMANDS = ["STEER_COMMAND", "THROTTLE_COMMAND", "BRAKE_COMMAND"]
TURN = Decision(speed_mps=4.0, curvature_per_m=0.05)


def decided(now_ns: int, decision: Decision = TURN) -> PlannerInputs:
    return PlannerInputs(decision=decision, decided_ns=now_ns)


def steer_times_ms(sent: list[Sent]) -> list[float]:
    return [item.time_ns / MS for item in named(sent, "STEER_COMMAND")]


def ages_ms(sent: list[Sent]) -> list[float]:
    return [item.content.decision_age_ms for item in named(sent, "STEER_COMMAND")]


def test_core_is_a_node() -> None:
    core = GatewayCore(TABBY, 20 * MS)
    node: Node[PlannerInputs, None] = core
    assert node.name == "Gateway"
    assert node.acceptance is not None
    assert {0x000, 0x181, 0x202, 0x606, 0x705} <= node.acceptance


def test_period_out_of_range_is_refused_at_construction() -> None:
    with pytest.raises(CommandError, match="planner_period_s"):
        GatewayCore(TABBY, 5 * MS)


def test_vehicle_faster_than_the_signals_is_refused_at_construction() -> None:
    fast = replace(
        TABBY,
        geometry=replace(TABBY.geometry, wheel_radius_m=0.05),
        traction=replace(TABBY.traction, speed_mps_max=35.0),
    )
    with pytest.raises(VehicleError, match=r"tabby_evo exceeds the DBC: .*wheel_speed_radps.*320"):
        GatewayCore(fast, 20 * MS)


def test_time_that_goes_back_is_a_programmers_error() -> None:
    rig = Rig().start()
    with pytest.raises(AssertionError, match="time went back"):
        rig.core.step(rig.now_ns - 1, [])


def test_nothing_is_commanded_before_nmt_start() -> None:
    rig = Rig()
    rig.run(200)
    assert {item.name for item in rig.sent} == {"GATEWAY_HEARTBEAT"}


def test_before_any_decision_commands_say_not_available() -> None:
    sent = Rig().start().run(100)
    steer, throttle, brake = (named(sent, name)[0].content for name in COMMANDS)
    assert math.isnan(steer.steering_wheel_angle_rad) and math.isnan(steer.decision_age_ms)
    assert math.isnan(throttle.wheel_speed_radps) and math.isnan(throttle.decision_age_ms)
    assert math.isnan(brake.position_ratio) and math.isnan(brake.decision_age_ms)


def test_without_decisions_each_command_comes_every_20_ms() -> None:
    sent = Rig().start().run(200)
    for name in COMMANDS:
        times_ns = [item.time_ns for item in named(sent, name)]
        assert len(times_ns) == 10
        assert {b - a for a, b in itertools.pairwise(times_ns)} == {20 * MS}


def test_decision_leaves_in_the_step_that_brings_it() -> None:
    rig = Rig().start()
    rig.run(20)
    rig.now_ns += 8 * MS
    sent = rig.poke(decided(rig.now_ns))
    assert [item.name for item in sent] == COMMANDS
    steer, throttle, brake = (item.content for item in sent)
    assert steer.steering_wheel_angle_rad == pytest.approx(40 * math.atan(0.118), abs=3e-4)
    wheel_speed_radps = 4.0 / (math.cos(math.atan(0.118)) * 0.287)
    assert throttle.wheel_speed_radps == pytest.approx(wheel_speed_radps, abs=6e-3)
    assert steer.decision_age_ms == throttle.decision_age_ms == 0
    assert brake == BrakeCommand(position_ratio=0.0, decision_age_ms=0)


def test_two_frames_of_one_identifier_are_never_closer_than_the_dbc_allows() -> None:
    rig = Rig().start()
    rig.run(20)
    for _ in range(60):
        rig.now_ns += 3 * MS
        rig.poke(decided(rig.now_ns))
    times_ms = steer_times_ms(rig.sent)
    assert min(b - a for a, b in itertools.pairwise(times_ms)) >= 7
    assert len(times_ms) > 15  # every 9 ms: the decision held back leaves in a later step


def test_decision_held_back_leaves_with_its_true_age_and_not_twice() -> None:
    rig = Rig().start()
    rig.run(10)
    assert ages_ms(rig.poke(decided(rig.now_ns))) == [0]
    rig.now_ns += 2 * MS
    held = Decision(speed_mps=1.0, curvature_per_m=0.0)
    assert rig.poke(decided(rig.now_ns, held)) == []
    sent = rig.step(after_ns=6 * MS)
    (throttle,) = named(sent, "THROTTLE_COMMAND")
    assert throttle.content.wheel_speed_radps == pytest.approx(1.0 / 0.287, abs=6e-3)
    assert throttle.content.decision_age_ms == 10  # 6 ms, rounded up to 5 ms
    assert named(rig.step(after_ns=10 * MS), "THROTTLE_COMMAND") == []


def test_gateway_never_refreshes_an_old_decision_its_age_grows_and_saturates() -> None:
    rig = Rig().start()
    rig.run(10)
    rig.poke(decided(rig.now_ns))
    ages = ages_ms(rig.run(1600))
    assert ages[:4] == [30, 50, 70, 90]  # one cycle was granted to the planner
    assert ages == sorted(ages)
    assert ages[-1] == 1270
    assert rig.state().decision_age_s == pytest.approx(1.6)


@pytest.mark.parametrize(
    ("age_ns", "age_ms"),
    [(0, 0), (1, 5), (5 * MS, 5), (5 * MS + 1, 10), (1_270 * MS, 1270), (10**12, 1270)],
)
def test_age_is_rounded_up_to_5_ms(age_ns: int, age_ms: float) -> None:
    assert wire_age_ms(age_ns) == age_ms


def test_decision_made_earlier_carries_its_age_from_the_start() -> None:
    rig = Rig().start()
    rig.run(10)
    assert ages_ms(rig.poke(decided(rig.now_ns - 12 * MS))) == [15]


def test_decision_from_the_future_is_a_programmers_error() -> None:
    rig = Rig().start()
    with pytest.raises(AssertionError, match="future"):
        rig.poke(decided(rig.now_ns + 1))


def test_planner_on_time_is_never_held_up_by_a_repetition() -> None:
    rig = Rig().start()
    rig.run(30)
    sent: list[Sent] = []
    for _ in range(20):  # decisions 3 ms after every second cycle
        sent += rig.step(after_ns=7 * MS) + rig.step()
        rig.now_ns += 3 * MS
        sent += rig.poke(decided(rig.now_ns))
    assert ages_ms(sent)[1:] == [0] * 20
    assert len(ages_ms(sent)) == 21


@pytest.mark.parametrize("late_us", [0, 2999])
@pytest.mark.parametrize("period_ms", [20, 25, 30, 50])
def test_decision_at_the_time_of_a_cycle_is_not_held_up_by_it(period_ms: int, late_us: int) -> None:
    rig = Rig(period_ms=period_ms).start()
    rig.run(10)
    start_ns = rig.now_ns
    sent: list[Sent] = []
    for turn in range(1, 20):
        rig.poke(decided(rig.now_ns))
        decide_ns = start_ns + turn * period_ms * MS + late_us * 1000
        while rig.now_ns + 10 * MS <= decide_ns:
            rig.step()
        rig.now_ns = decide_ns
        sent += rig.poke(decided(rig.now_ns))
    assert ages_ms(sent) == [0] * 19


def test_planner_that_falls_silent_is_repeated_within_a_cycle_of_its_missed_turn() -> None:
    rig = Rig().start()
    rig.run(30)
    rig.now_ns += 3 * MS
    rig.poke(decided(rig.now_ns))
    start_ms = rig.now_ns / MS
    sent = rig.step(after_ns=7 * MS) + rig.run(100)
    assert [time - start_ms for time in steer_times_ms(sent)] == [27, 47, 67, 87, 107]


def test_slow_planners_commands_are_repeated_within_20_ms() -> None:
    rig = Rig(period_ms=100).start()
    rig.run(30)
    rig.now_ns += 3 * MS
    rig.poke(decided(rig.now_ns))
    start_ms = rig.now_ns / MS
    sent = rig.step(after_ns=7 * MS) + rig.run(50)
    assert [time - start_ms for time in steer_times_ms(sent)] == [17, 37, 57]


def test_decision_is_forgotten_when_the_driver_takes_over() -> None:
    rig = Rig().start()
    rig.mode(Mode.AUTOMATIC)
    rig.run(20)
    rig.poke(decided(rig.now_ns))
    assert rig.state().decision_age_s == 0
    rig.mode(Mode.MANUAL)
    rig.step()
    assert math.isnan(rig.state().decision_age_s)
    assert all(math.isnan(age) for age in ages_ms(rig.run(40)))


@pytest.mark.parametrize("mode", [Mode.READY, Mode.EMERGENCY, Mode.INIT])
def test_decision_is_forgotten_however_automatic_ends(mode: Mode) -> None:
    rig = Rig().start()
    rig.mode(Mode.AUTOMATIC)
    rig.run(20)
    rig.mode(Mode.STOPPING)
    rig.step(decided(rig.now_ns))
    assert not math.isnan(rig.state().decision_age_s)
    rig.mode(mode)
    rig.step()
    assert math.isnan(rig.state().decision_age_s)


def test_decision_of_the_very_step_that_ends_automatic_is_a_new_one() -> None:
    rig = Rig().start()
    rig.mode(Mode.AUTOMATIC)
    rig.run(20)
    rig.mode(Mode.MANUAL)
    rig.step(decided(rig.now_ns + 10 * MS))
    assert rig.state().decision_age_s == 0


def test_held_brake_when_told_to_stand() -> None:
    rig = Rig().start()
    rig.run(20)
    sent = rig.step(decided(rig.now_ns, Decision(speed_mps=0.0, curvature_per_m=0.0)))
    (brake,) = named(sent, "BRAKE_COMMAND")
    assert brake.content.position_ratio == pytest.approx(TABBY.brake.hold_ratio)


def test_brake_follows_the_measured_excess_and_the_echo() -> None:
    rig = Rig().start()
    rig.set(
        "THROTTLE_STATUS", wheel_speed_radps=6.0 / 0.287, applied_wheel_speed_radps=4.5 / 0.287
    )
    rig.run(20)
    (brake,) = named(rig.step(decided(rig.now_ns)), "BRAKE_COMMAND")
    assert brake.content.position_ratio == pytest.approx(2.0 / 7.0, abs=0.01)


def test_brake_is_not_derived_from_a_stale_status() -> None:
    rig = Rig().start()
    rig.set("THROTTLE_STATUS", wheel_speed_radps=20.0, applied_wheel_speed_radps=0.0)
    rig.run(20)
    rig.muted.add("THROTTLE_STATUS")
    rig.run(100)
    (brake,) = named(rig.step(decided(rig.now_ns)), "BRAKE_COMMAND")
    assert brake.content.position_ratio == 0.0


def test_brake_needs_a_status() -> None:
    rig = Rig()
    rig.muted.add("THROTTLE_STATUS")
    rig.start().run(20)
    (brake,) = named(
        rig.step(decided(rig.now_ns, Decision(speed_mps=0.0, curvature_per_m=0.0))), "BRAKE_COMMAND"
    )
    assert brake.content.position_ratio == 0.0


def test_heartbeat_comes_every_50_ms_and_tells_the_state() -> None:
    beats = named(Rig().start().run(500), "GATEWAY_HEARTBEAT")
    assert len(beats) == 10
    assert all(beat.content.state is HeartbeatState.OPERATIONAL for beat in beats)


@pytest.mark.parametrize(
    ("subindex", "value"),
    [(1, dbc_hash()), (2, configuration_hash(TABBY.text))],
)
def test_hashes_are_answered_over_sdo(subindex: int, value: int) -> None:
    rig = Rig().start()
    rig.extra.append(Frame(0x606, bytes([0x40, 0x00, 0x20, subindex, 0, 0, 0, 0])))
    (answer,) = [item for item in rig.step() if item.frame.can_id == 0x586]
    assert int.from_bytes(answer.frame.data[4:], "little") == value


def test_nmt_stop_ends_the_commands_and_is_reported() -> None:
    rig = Rig().start()
    rig.extra.append(nmt_frame(NmtCommand.STOP, 6))
    rig.step()
    assert named(rig.run(100), "STEER_COMMAND") == []
    kinds = [(event.kind, event.text) for event in rig.events]
    assert (EventKind.NMT, "obeyed STOP") in kinds
    assert (EventKind.CODE, "ER2 NMT_COMMAND") in kinds


def test_nmt_reset_forgets_decision_and_request() -> None:
    rig = Rig().start()
    rig.step(replace(decided(rig.now_ns), request=Request.ENGAGE))
    rig.extra.append(nmt_frame(NmtCommand.RESET_NODE, 6))
    rig.step()
    state = rig.state()
    assert math.isnan(state.decision_age_s)
    assert state.pending_request is Request.NONE
    assert state.node_health["Gateway"].heartbeat is HeartbeatState.PRE_OPERATIONAL
    assert not state.node_health["Gateway"].is_healthy


def stranger(name: str) -> Frame:
    endpoint = Endpoint("Gateway", ())
    if name == "STEER_COMMAND":
        return endpoint.frame(name, SteerCommand(steering_wheel_angle_rad=1.0, decision_age_ms=0))
    return endpoint.frame(
        "MODE_REQUEST", ModeRequest(request=Request.ENGAGE, planner_period_ms=20, sequence=1)
    )


def test_stranger_with_our_identifier_is_reported_and_named() -> None:
    rig = Rig().start()
    rig.extra.append(stranger("STEER_COMMAND"))
    rig.step()
    rig.run(100)
    assert [event.text for event in rig.events if event.kind is EventKind.FOREIGN] == [
        f"{stranger('STEER_COMMAND')} (data)"
    ]
    assert named(rig.sent, "GATEWAY_EMERGENCY_BRAKE") == []
    (emcy,) = named(rig.sent, "GATEWAY_EMCY")
    assert (emcy.content.er_code, emcy.content.reason) == (ErrorCode.ER1, Reason.FOREIGN_SENDER)
    assert emcy.content.er_bits == 0b10
    assert rig.state().why_not_engaged == (
        "somebody else sends STEER_COMMAND 0x202: stop the other gateway on this bus"
    )


def test_stranger_is_forgotten_a_second_later_with_an_error_reset() -> None:
    rig = Rig().start()
    rig.extra.append(stranger("MODE_REQUEST"))
    rig.run(1200)
    assert rig.state().why_not_engaged == "ready: call engage()"
    assert [emcy.content.error_code for emcy in named(rig.sent, "GATEWAY_EMCY")] == [0xFF01, 0]


def test_two_codes_end_with_one_error_reset() -> None:
    rig = Rig().start()
    rig.extra.append(stranger("MODE_REQUEST"))
    rig.run(500)
    rig.extra.append(Frame(0x181, bytes(3)))
    rig.run(2000)
    emcys = [(e.content.error_code, e.content.er_bits) for e in named(rig.sent, "GATEWAY_EMCY")]
    assert emcys == [(0xFF01, 0b10), (0xFF00, 0b11), (0, 0)]


@pytest.mark.parametrize("mode", [Mode.AUTOMATIC, Mode.STOPPING])
def test_stranger_who_commands_the_driving_car_stops_it(mode: Mode) -> None:
    rig = Rig().start()
    rig.mode(mode)
    rig.run(20)
    rig.extra.append(stranger("STEER_COMMAND"))
    sent = rig.step()
    (brake,) = named(sent, "GATEWAY_EMERGENCY_BRAKE")
    assert brake.content == EmergencyBrake(
        code=ErrorCode.ER1, reason=Reason.FOREIGN_SENDER, cause_age_ms=0, reset_epoch=3
    )
    assert named(sent, "FAILSAFE") == []


def test_strange_heartbeat_is_reported_and_does_not_brake() -> None:
    rig = Rig().start()
    rig.mode(Mode.AUTOMATIC)
    rig.run(20)
    rig.extra.append(Frame(0x706, b"\x05"))
    assert named(rig.step(), "GATEWAY_EMERGENCY_BRAKE") == []
    assert any("ER1 FOREIGN_SENDER" in event.text for event in rig.events)


@pytest.mark.parametrize(
    "frame", [Frame(0x202, bytes(8), FrameKind.EXTENDED), Frame(0x333, b"\x01")]
)
def test_identifier_that_is_not_ours_is_logged_and_moves_nothing(frame: Frame) -> None:
    rig = Rig().start()
    rig.mode(Mode.AUTOMATIC)
    rig.run(20)
    rig.extra.append(frame)
    sent = rig.run(100)
    assert named(sent, "GATEWAY_EMERGENCY_BRAKE") == named(sent, "GATEWAY_EMCY") == []
    assert [event.kind for event in rig.events[-1:]] == [EventKind.FOREIGN]


def test_bad_frame_is_er0_and_ignored() -> None:
    rig = Rig().start()
    rig.extra.append(Frame(0x184, bytes(8)))
    rig.step()
    rig.step()
    assert any(
        event.kind is EventKind.FRAME and event.text == "ignored 184#0000000000000000: crc"
        for event in rig.events
    )
    (emcy,) = named(rig.sent, "GATEWAY_EMCY")
    assert (emcy.content.er_code, emcy.content.reason) == (ErrorCode.ER0, Reason.BAD_FRAME)


def test_code_that_goes_on_is_reported_once() -> None:
    rig = Rig().start()
    for _ in range(20):
        rig.extra.append(Frame(0x184, bytes(8)))
        rig.run(100)
    assert len(named(rig.sent, "GATEWAY_EMCY")) == 1
    assert [event.text for event in rig.events if event.kind is EventKind.CODE] == [
        "ER0 BAD_FRAME"
    ]


def test_bus_off_is_er2() -> None:
    rig = Rig().start()
    rig.extra.append(Frame(0x040, bytes(8), FrameKind.ERROR))
    rig.step()
    assert any(event.text == "ER2 BUS_OFF" for event in rig.events)


def test_parameters_cannot_be_written_over_sdo() -> None:
    rig = Rig().start()
    rig.extra.append(Frame(0x606, bytes([0x23, 0x00, 0x21, 1, 100, 0, 0, 0])))
    (answer,) = [item for item in rig.step() if item.frame.can_id == 0x586]
    assert answer.frame.data[0] == 0x80
