"""What a drive does when something breaks, when its master falls silent, and on a quick stop."""

from __future__ import annotations

import itertools
import struct

import pytest

from canbus import cia402
from canbus.canopen_protocol import NmtCommand, NmtState, nmt_frame
from canbus.cia402 import AbortOption, OperationMode, StopOption
from canbus.cia402_power import PowerState
from canbus.frame import Frame, FrameKind
from simulation.drives.drive import REACTION_S_MAX
from simulation.drives.faults import DriveFault
from tests.simulation.drive_rig import (
    DISABLE_VOLTAGE,
    ENABLE,
    FAULT_RESET,
    MASTER_ID,
    MS,
    NODE_ID,
    QUICK_STOP,
    SHUTDOWN,
    Rig,
)

CONSUMER = 0x101601
SPEED_RPM = 1000
HELD = [fault for fault in DriveFault if fault is not DriveFault.HEARTBEAT]
CODES = {
    DriveFault.OVERCURRENT: (0x2310, 0x03),
    DriveFault.UNDERVOLTAGE: (0x3220, 0x05),
    DriveFault.OVERTEMPERATURE: (0x4210, 0x09),
    DriveFault.ENCODER: (0x7320, 0x21),
    DriveFault.HEARTBEAT: (0x8130, 0x11),
    DriveFault.FOLLOWING_ERROR: (0x8611, 0x21),
}
"""Error code and register, written a second time by hand (CiA 301, table 26; CiA 402-2)."""
LET_GO = (DriveFault.OVERCURRENT, DriveFault.UNDERVOLTAGE, DriveFault.ENCODER)


def turning(reaction: StopOption = StopOption.QUICK_STOP) -> Rig:
    """A drive at 1000 rpm, whose slow ramp takes 1 s and whose quick one takes 0.2 s."""
    rig = Rig()
    rig.enable(OperationMode.PROFILE_VELOCITY)
    rig.write(cia402.PROFILE_DECELERATION, SPEED_RPM, 4)
    rig.write(cia402.QUICK_STOP_DECELERATION, 5 * SPEED_RPM, 4)
    assert rig.write(cia402.FAULT_REACTION_OPTION, reaction, 2) == 0
    rig.command(ENABLE, SPEED_RPM, pdo=2)
    rig.run(500)
    assert rig.drive.values[cia402.VELOCITY_ACTUAL] == pytest.approx(SPEED_RPM, abs=10)
    return rig


def time_in_state_s(rig: Rig, state: PowerState, limit_s: float = 10.0) -> float:
    start_ns = rig.now_ns
    while rig.state is state and rig.now_ns - start_ns < limit_s * 1e9:
        rig.run(1)
    return (rig.now_ns - start_ns) / 1e9


@pytest.mark.parametrize("fault", HELD)
def test_a_fault_is_reported_once_and_ends_in_fault(fault: DriveFault) -> None:
    rig = turning()
    rig.drive.fail(fault)
    rig.run(2000)
    assert rig.state is PowerState.FAULT
    assert [emergency[1:] for emergency in rig.emergencies()] == [CODES[fault]]
    assert rig.drive.values[cia402.ERROR_CODE] == CODES[fault][0]
    assert rig.read(0x100100, 1, signed=False) == CODES[fault][1]
    assert rig.motor.current_a == 0.0


@pytest.mark.parametrize(
    ("reaction", "time_s"), [(StopOption.SLOW_DOWN, 1.0), (StopOption.QUICK_STOP, 0.2)]
)
def test_a_fault_brakes_by_the_reaction_option(reaction: StopOption, time_s: float) -> None:
    rig = turning(reaction)
    rig.drive.fail(DriveFault.OVERTEMPERATURE)
    rig.run(1)
    assert rig.state is PowerState.FAULT_REACTION_ACTIVE
    taken_s = time_in_state_s(rig, PowerState.FAULT_REACTION_ACTIVE)
    assert taken_s == pytest.approx(time_s, abs=0.06)
    assert abs(rig.motor.speed_radps) < 4.0


def test_reaction_option_0_lets_the_motor_coast_at_once() -> None:
    rig = turning(StopOption.DISABLE)
    speed = rig.motor.speed_radps
    rig.drive.fail(DriveFault.OVERTEMPERATURE)
    rig.run(1)
    assert rig.state is PowerState.FAULT
    assert rig.motor.current_a == 0.0
    assert rig.motor.speed_radps == pytest.approx(speed, rel=0.05)


@pytest.mark.parametrize("fault", LET_GO)
def test_who_cannot_brake_lets_go_whatever_the_option_says(fault: DriveFault) -> None:
    rig = turning(StopOption.QUICK_STOP)
    rig.drive.fail(fault)
    rig.run(1)
    assert rig.state is PowerState.FAULT
    assert rig.motor.current_a == 0.0


def test_a_worse_fault_during_the_reaction_ends_the_braking() -> None:
    rig = turning(StopOption.SLOW_DOWN)
    rig.drive.fail(DriveFault.OVERTEMPERATURE)
    rig.run(100)
    assert rig.motor.current_a != 0.0
    rig.drive.fail(DriveFault.OVERCURRENT)
    rig.run(2)
    assert rig.state is PowerState.FAULT
    assert rig.motor.current_a == 0.0
    assert rig.motor.speed_radps > 50.0


def test_a_motor_that_its_load_keeps_turning_is_let_go_in_the_end() -> None:
    rig = turning()
    rig.motor.load_torque_nm = 1.0
    rig.drive.fail(DriveFault.OVERTEMPERATURE)
    rig.run(1)
    taken_s = time_in_state_s(rig, PowerState.FAULT_REACTION_ACTIVE)
    assert taken_s == pytest.approx(REACTION_S_MAX, abs=0.01)


@pytest.mark.parametrize("fault", HELD)
def test_a_reset_needs_the_cause_gone_and_a_rising_edge(fault: DriveFault) -> None:
    rig = turning(StopOption.DISABLE)
    rig.drive.fail(fault)
    rig.run(10)
    states = []
    rig.command(FAULT_RESET)  # the cause is still there
    states.append(rig.state)
    assert len(list(rig.emergencies())) == 1
    rig.drive.mend(fault)
    rig.command(FAULT_RESET)  # no edge
    states.append(rig.state)
    for word in (DISABLE_VOLTAGE, FAULT_RESET):
        rig.command(word)
        states.append(rig.state)
    faulted = PowerState.FAULT
    assert states == [faulted, faulted, faulted, PowerState.SWITCH_ON_DISABLED]
    assert rig.drive.values[cia402.ERROR_CODE] == 0
    assert [emergency[1:] for emergency in rig.emergencies()][-1] == (0, 0)
    rig.command(SHUTDOWN, 0, pdo=2)
    rig.command(ENABLE, 0, pdo=2)
    assert rig.state is PowerState.OPERATION_ENABLED


def test_a_fault_without_power_is_a_fault_at_once() -> None:
    rig = Rig()
    rig.start()
    rig.drive.fail(DriveFault.OVERTEMPERATURE)
    rig.run(1)
    assert rig.state is PowerState.FAULT


def test_a_following_error_is_a_fault() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    rig.write(cia402.FOLLOWING_ERROR_WINDOW, 500, 4)
    rig.command(ENABLE | 0x30, 20_000)
    rig.run(100)
    assert rig.state is PowerState.OPERATION_ENABLED
    rig.motor.load_torque_nm = -0.5  # more than the motor has
    rig.run(200)
    assert [emergency[1:] for emergency in rig.emergencies()] == [(0x8611, 0x21)]
    assert rig.state in (PowerState.FAULT_REACTION_ACTIVE, PowerState.FAULT)


# Quick stop


@pytest.mark.parametrize(
    ("option", "time_s", "after"),
    [
        (StopOption.SLOW_DOWN, 1.0, PowerState.SWITCH_ON_DISABLED),
        (StopOption.QUICK_STOP, 0.2, PowerState.SWITCH_ON_DISABLED),
        (StopOption.SLOW_DOWN_AND_STAY, 1.0, PowerState.QUICK_STOP_ACTIVE),
        (StopOption.QUICK_STOP_AND_STAY, 0.2, PowerState.QUICK_STOP_ACTIVE),
    ],
)
def test_quick_stop_brakes_by_its_option_and_ends_where_that_says(
    option: StopOption, time_s: float, after: PowerState
) -> None:
    rig = turning()
    assert rig.write(cia402.QUICK_STOP_OPTION, option, 2) == 0
    rig.command(QUICK_STOP, pdo=2)
    assert rig.state is PowerState.QUICK_STOP_ACTIVE
    start_ns = rig.now_ns
    while rig.motor.speed_radps > 1.0:
        rig.run(1)
    assert (rig.now_ns - start_ns) / 1e9 == pytest.approx(time_s, abs=0.05)
    rig.run(200)
    assert rig.state is after


def test_quick_stop_option_0_lets_the_motor_coast() -> None:
    rig = turning()
    rig.write(cia402.QUICK_STOP_OPTION, StopOption.DISABLE, 2)
    rig.command(QUICK_STOP, pdo=2)
    assert rig.state is PowerState.SWITCH_ON_DISABLED
    assert rig.motor.current_a == 0.0
    assert rig.motor.speed_radps > 50.0


def test_a_quick_stop_that_stays_may_be_left_and_one_that_does_not_may_not() -> None:
    for option, after in (
        (StopOption.QUICK_STOP_AND_STAY, PowerState.OPERATION_ENABLED),
        (StopOption.QUICK_STOP, PowerState.QUICK_STOP_ACTIVE),
    ):
        rig = turning()
        rig.write(cia402.QUICK_STOP_OPTION, option, 2)
        rig.command(QUICK_STOP, pdo=2)
        rig.run(20)
        rig.command(ENABLE, pdo=2)
        assert rig.state is after


# The master


def with_master(option: AbortOption = AbortOption.FAULT, silence_ms: int = 150) -> Rig:
    rig = turning()
    assert rig.write(cia402.ABORT_CONNECTION_OPTION, option, 2) == 0
    assert rig.write(CONSUMER, MASTER_ID << 16 | silence_ms, 4) == 0
    return rig


def beat(rig: Rig, count: int) -> None:
    for _ in range(count):
        rig.send(rig.heartbeat())
        rig.run(50)


def test_a_master_that_beats_is_no_fault_and_one_that_never_did_is_not_waited_for() -> None:
    rig = with_master()
    rig.run(1000)
    assert rig.state is PowerState.OPERATION_ENABLED
    beat(rig, 40)
    assert rig.state is PowerState.OPERATION_ENABLED
    assert not list(rig.emergencies())


def test_a_silent_master_is_a_fault_after_the_time_of_object_1016() -> None:
    rig = with_master(silence_ms=150)
    beat(rig, 5)
    last_ns = rig.now_ns - 49 * MS
    rig.run(500)
    ((reported_ns, code, register),) = rig.emergencies()
    assert (code, register) == CODES[DriveFault.HEARTBEAT]
    assert 150 * MS < reported_ns - last_ns <= 152 * MS
    assert rig.state is PowerState.FAULT
    assert abs(rig.motor.speed_radps) < 1.0


@pytest.mark.parametrize(
    ("option", "state", "is_braked"),
    [
        (AbortOption.NOTHING, PowerState.OPERATION_ENABLED, False),
        (AbortOption.DISABLE_VOLTAGE, PowerState.SWITCH_ON_DISABLED, False),
        (AbortOption.QUICK_STOP, PowerState.QUICK_STOP_ACTIVE, True),
        (AbortOption.FAULT, PowerState.FAULT, True),
    ],
)
def test_what_a_lost_master_does_is_object_6007s(
    option: AbortOption, state: PowerState, is_braked: bool
) -> None:
    rig = with_master(option)
    beat(rig, 3)
    currents_a: list[float] = []
    rig.run(400, lambda: currents_a.append(rig.motor.current_a))
    assert rig.state is state
    assert (min(currents_a) < 0.0) is is_braked
    assert (rig.motor.speed_radps > 50.0) is (option is AbortOption.NOTHING)
    assert [emergency[1] for emergency in rig.emergencies()] == [0x8130]


@pytest.mark.parametrize("frame", [
    Frame(0x702, b"\x05"),
    Frame(0x701, b""),
    Frame(0x701, b"\x05\x05"),
    Frame(0x701, b"\x63"),
    Frame(0x701, b"", FrameKind.REMOTE),
], ids=str)  # fmt: skip
def test_what_is_no_heartbeat_of_the_master_keeps_nothing_alive(frame: Frame) -> None:
    rig = with_master()
    beat(rig, 3)
    for _ in range(10):
        rig.send(frame)
        rig.run(50)
    assert rig.state is PowerState.FAULT


def test_a_reset_after_the_masters_return_runs_again() -> None:
    rig = with_master()
    beat(rig, 3)
    rig.run(500)
    beat(rig, 3)
    rig.command(FAULT_RESET, 0, pdo=2)
    rig.command(SHUTDOWN, 0, pdo=2)
    rig.command(ENABLE, 500, pdo=2)
    beat(rig, 10)
    assert rig.state is PowerState.OPERATION_ENABLED
    assert rig.drive.values[cia402.VELOCITY_ACTUAL] == pytest.approx(500, abs=10)


@pytest.mark.parametrize("command", [NmtCommand.STOP, NmtCommand.RESET_COMMUNICATION])
def test_nmt_stop_and_communication_reset_are_a_lost_master(command: NmtCommand) -> None:
    rig = turning()
    rig.send(nmt_frame(command, NODE_ID))
    rig.run(500)
    assert rig.drive.state is PowerState.FAULT
    assert abs(rig.motor.speed_radps) < 1.0


def test_a_node_reset_takes_the_power_off_and_forgets_everything() -> None:
    rig = turning()
    rig.send(nmt_frame(NmtCommand.RESET_NODE, NODE_ID))
    rig.run(2)
    assert rig.drive.state is PowerState.SWITCH_ON_DISABLED
    assert rig.motor.current_a == 0.0
    assert rig.drive.values[cia402.MODE] == rig.drive.values[cia402.MODE_DISPLAY] == 0
    assert rig.read(cia402.PROFILE_DECELERATION, 4) == 10_000
    rig.enable(OperationMode.PROFILE_VELOCITY)


# PDO


def sent(rig: Rig, can_id: int, duration_ms: int) -> list[tuple[int, bytes]]:
    first = len(rig.seen)
    rig.run(duration_ms)
    return [(now, frame.data) for now, frame in rig.seen[first:] if frame.can_id == can_id]


def test_tpdo_tell_state_and_motion_every_10_ms_while_it_moves_and_20_ms_at_rest() -> None:
    rig = turning()
    frames = sent(rig, 0x180 + NODE_ID, 200)
    assert {b - a for (a, _), (b, _) in itertools.pairwise(frames)} == {10 * MS}
    word, position, mode = struct.unpack("<Hib", frames[-1][1])
    assert word == rig.drive.values[cia402.STATUSWORD]
    assert position == pytest.approx(rig.drive.values[cia402.POSITION_ACTUAL], abs=700)
    assert mode == OperationMode.PROFILE_VELOCITY
    rig = Rig()
    rig.start()
    frames = sent(rig, 0x280 + NODE_ID, 200)
    assert {b - a for (a, _), (b, _) in itertools.pairwise(frames)} == {20 * MS}
    assert len(frames[0][1]) == 8


@pytest.mark.parametrize("state", [NmtState.PRE_OPERATIONAL, NmtState.STOPPED])
def test_no_pdo_goes_or_acts_unless_operational(state: NmtState) -> None:
    rig = Rig()
    if state is NmtState.STOPPED:
        rig.send(nmt_frame(NmtCommand.STOP, 0))
    rig.command(SHUTDOWN)
    assert rig.state is PowerState.SWITCH_ON_DISABLED
    assert not sent(rig, 0x180 + NODE_ID, 100)


def test_a_short_pdo_is_reported_and_not_obeyed() -> None:
    rig = Rig()
    rig.start()
    rig.send(Frame(0x200 + NODE_ID, struct.pack("<H", SHUTDOWN)))
    rig.run(2)
    assert rig.state is PowerState.SWITCH_ON_DISABLED
    assert rig.drive.bad_frames == 1
    assert [emergency[1] for emergency in rig.emergencies()] == [0x8210]


def remap(rig: Rig, mapping: int, entries: list[int]) -> list[int]:
    answers = [rig.write(mapping << 8, 0, 1)]
    for member, entry in enumerate(entries, 1):
        answers.append(rig.write(mapping << 8 | member, entry, 4))
    return [*answers, rig.write(mapping << 8, len(entries), 1)]


def test_a_pdo_is_mapped_anew_in_the_order_of_cia_301() -> None:
    rig = Rig()
    settings = 0x180101
    cob_id = rig.read(settings, 4, signed=False)
    assert remap(rig, 0x1A01, [])[0] == 0x08000022, "valid: hands off"
    assert rig.write(settings, cob_id | 1 << 31, 4) == 0
    assert rig.write(0x1A0101, 0x60770010, 4) == 0x08000022, "entries are in use"
    assert remap(rig, 0x1A01, [0x60780010, 0x60410010]) == [0, 0, 0, 0]
    assert rig.write(settings, 0x40000291, 4) == 0
    rig.start()
    ((_, data), *_) = sent(rig, 0x291, 50)
    assert struct.unpack("<hH", data) == (0, rig.drive.values[cia402.STATUSWORD])


@pytest.mark.parametrize(
    ("mapping", "entries", "abort"),
    [
        (0x1A01, [0x60700010], 0x06040041),  # no such object
        (0x1A01, [0x607C0020], 0x06040041),  # not to be mapped
        (0x1A01, [0x60410008], 0x06040041),  # another length
        (0x1601, [0x60410010], 0x06040041),  # nobody writes the statusword
        (0x1A01, [0x60640020, 0x606C0020, 0x60410010], 0x06040042),
    ],
)
def test_a_mapping_that_makes_no_sense_is_refused(
    mapping: int, entries: list[int], abort: int
) -> None:
    rig = Rig()
    settings = mapping - 0x200 << 8 | 1
    rig.write(settings, rig.read(settings, 4, signed=False) | 1 << 31, 4)
    assert abort in remap(rig, mapping, entries)


@pytest.mark.parametrize("cob_id", [0x000, 0x001, 0x080, 0x180, 0x580, 0x701, 0x20000191])
def test_no_pdo_gets_an_identifier_of_another_service(cob_id: int) -> None:
    rig = Rig()
    settings = 0x180001
    rig.write(settings, rig.read(settings, 4, signed=False) | 1 << 31, 4)
    assert rig.write(settings, cob_id, 4) == 0x06090030


def test_identifiers_that_are_wanted_follow_the_objects() -> None:
    rig = Rig()
    assert rig.drive.acceptance == {0x000, 0x611, 0x211, 0x311}
    assert isinstance(rig.drive.acceptance, frozenset)
    rig.write(CONSUMER, MASTER_ID << 16 | 100, 4)
    rig.write(0x140001, 0x80000211, 4)
    assert rig.drive.acceptance == {0x000, 0x611, 0x311, 0x701}


@pytest.mark.parametrize("period_ns", [2 * MS, 10 * MS])
def test_the_motor_moves_the_same_however_often_the_drive_is_stepped(period_ns: int) -> None:
    rigs = Rig(), Rig(period_ns=period_ns)
    for rig in rigs:
        rig.drive.step(rig.now_ns, [nmt_frame(NmtCommand.START, 0)])
        for word in (SHUTDOWN, ENABLE):
            mode = Frame(0x600 + NODE_ID, bytes.fromhex("2f60600003000000"))
            command = Frame(0x300 + NODE_ID, struct.pack("<Hi", word, 800))
            rig.now_ns += 10 * MS
            rig.drive.step(rig.now_ns, [mode, command])
        rig.run(500)
    assert rigs[0].motor.angle_rad == pytest.approx(rigs[1].motor.angle_rad, abs=0.2)
    assert rigs[0].motor.speed_radps == pytest.approx(rigs[1].motor.speed_radps)
