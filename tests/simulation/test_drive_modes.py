"""Profile position, profile velocity, homing, halt: what a drive does with what it is told."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest

from canbus import cia402
from canbus.canopen_protocol import ABORT_TOO_HIGH, ABORT_TOO_LOW, ABORT_VALUE
from canbus.cia402 import RPM_PER_RADPS, HomingMethod, OperationMode, StopOption
from canbus.cia402_power import PowerState
from simulation.drives.motor import COUNTS_PER_REV, EC45, RE50
from simulation.drives.profile import Reference
from tests.simulation.drive_rig import ENABLE, MS, Rig

NOW, NEXT = ENABLE | 0x30, ENABLE | 0x10
RELATIVE_NOW = NOW | cia402.RELATIVE
COUNTS_PER_S_PER_RPM = COUNTS_PER_REV / 60


def position(rig: Rig) -> int:
    return rig.drive.values[cia402.POSITION_ACTUAL]


def velocity(rig: Rig) -> int:
    return rig.drive.values[cia402.VELOCITY_ACTUAL]


def move(rig: Rig, word: int, target: int) -> None:
    rig.command(word, target)
    rig.command(ENABLE, target)


# Profile position


@pytest.mark.parametrize("target", [400, 4096, 40_960, -40_960])
def test_a_position_is_reached_and_told(target: int) -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    move(rig, NOW, target)
    assert not rig.has(cia402.TARGET_REACHED)
    rig.run(2000)
    assert position(rig) == target
    assert rig.has(cia402.TARGET_REACHED)
    assert rig.motor.angle_rad == pytest.approx(target * math.tau / COUNTS_PER_REV, abs=0.003)


def test_a_move_takes_the_time_of_its_trapezoid() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    rig.write(cia402.PROFILE_VELOCITY, 1500, 4)
    rig.write(cia402.PROFILE_ACCELERATION, 6000, 4)
    rig.write(cia402.PROFILE_DECELERATION, 3000, 4)
    ramps_s = 1500 / 6000, 1500 / 3000
    turns = 1500 / 60 * (1.0 + sum(ramps_s) / 2)
    start_ns, fastest = rig.now_ns, 0
    rig.command(NOW, round(turns * COUNTS_PER_REV))
    while not rig.has(cia402.TARGET_REACHED):
        rig.run(1)
        fastest = max(fastest, velocity(rig))
        assert rig.now_ns - start_ns < 5000 * MS
    assert (rig.now_ns - start_ns) / 1e9 == pytest.approx(1.0 + sum(ramps_s), abs=0.05)
    assert fastest == pytest.approx(1500, rel=0.02)


def test_profile_velocity_is_bounded_by_its_maximum() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    rig.write(cia402.PROFILE_VELOCITY, 3000, 4)
    rig.write(cia402.PROFILE_VELOCITY_MAX, 500, 4)
    rig.command(NOW, 100_000)
    rig.run(1000)
    assert velocity(rig) == pytest.approx(500, rel=0.02)


def test_a_setpoint_is_taken_with_the_rising_edge_alone_and_acknowledged() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    rig.command(ENABLE, 8000)
    rig.run(200)
    assert position(rig) == 0
    assert not rig.has(cia402.SETPOINT_ACKNOWLEDGED)
    rig.command(NOW, 8000)
    assert rig.has(cia402.SETPOINT_ACKNOWLEDGED)
    rig.command(NOW, 20_000)  # no edge: not taken
    rig.command(ENABLE, 20_000)
    assert not rig.has(cia402.SETPOINT_ACKNOWLEDGED)
    rig.run(1500)
    assert position(rig) == 8000


def test_the_next_setpoint_waits_for_the_first_and_one_at_once_does_not() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    move(rig, NOW, 20_000)
    move(rig, NEXT, -5000)
    assert rig.has(cia402.SETPOINT_ACKNOWLEDGED), "the buffer is full"
    move(rig, NEXT, 7)
    highest = 0
    for _ in range(3000):
        rig.run(1)
        highest = max(highest, position(rig))
    assert highest == pytest.approx(20_000, abs=12)
    assert position(rig) == -5000, "a third one finds no room"
    move(rig, NOW, 20_000)
    rig.run(100)
    move(rig, NOW, -5000)
    rig.run(2000)
    assert position(rig) == -5000


def test_relative_setpoints_add_up() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    for count in range(1, 4):
        move(rig, RELATIVE_NOW, 3000)
        rig.run(1000)
        assert position(rig) == 3000 * count


def test_a_target_outside_the_software_limits_ends_at_the_limit_and_says_so() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    rig.write(cia402.POSITION_LIMIT_MIN, -5000, 4)
    rig.write(cia402.POSITION_LIMIT_MAX, 6000, 4)
    for target, reached, limited in ((9000, 6000, True), (-9000, -5000, True), (100, 100, False)):
        move(rig, NOW, target)
        rig.run(1500)
        assert position(rig) == reached
        assert rig.has(cia402.LIMIT_ACTIVE) is limited


def test_a_load_is_held_and_pushes_no_position_away() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    move(rig, NOW, 4096)
    rig.run(1000)
    rig.motor.load_torque_nm = -0.03
    rig.run(1000)
    assert position(rig) == pytest.approx(4096, abs=1)
    assert rig.drive.values[cia402.CURRENT_ACTUAL] > 100


@pytest.mark.parametrize(
    ("option", "key"),
    [
        (StopOption.SLOW_DOWN, cia402.PROFILE_DECELERATION),
        (StopOption.QUICK_STOP, cia402.QUICK_STOP_DECELERATION),
    ],
)
@pytest.mark.parametrize("mode", [OperationMode.PROFILE_POSITION, OperationMode.PROFILE_VELOCITY])
def test_halt_stops_by_its_option_and_going_on_goes_on(
    option: StopOption, key: int, mode: OperationMode
) -> None:
    rig = Rig()
    pdo = 1 if mode is OperationMode.PROFILE_POSITION else 2
    rig.enable(mode)
    rig.write(cia402.PROFILE_VELOCITY, 1000, 4)
    rig.write(cia402.PROFILE_DECELERATION, 1000, 4)
    rig.write(cia402.QUICK_STOP_DECELERATION, 5000, 4)
    rig.write(cia402.HALT_OPTION, option, 2)
    target = 400_000 if pdo == 1 else 1000
    word = NOW if pdo == 1 else ENABLE
    rig.command(word, target, pdo=pdo)
    rig.run(1000)
    start_ns = rig.now_ns
    rig.command(word | cia402.HALT, target, pdo=pdo)
    while not rig.has(cia402.TARGET_REACHED):
        rig.run(1)
    assert rig.state is PowerState.OPERATION_ENABLED
    expected_s = 1000 / rig.drive.values[key]
    assert (rig.now_ns - start_ns) / 1e9 == pytest.approx(expected_s, abs=0.08)
    assert rig.motor.speed_radps == pytest.approx(0.0, abs=4.0)
    rig.command(word, target, pdo=pdo)
    rig.run(1500)
    assert velocity(rig) == pytest.approx(1000, rel=0.02)


# Profile velocity


@pytest.mark.parametrize("params", [RE50, EC45], ids=["RE50", "EC45"])
@pytest.mark.parametrize("target", [500, -2000])
def test_a_velocity_is_reached_along_the_ramp_and_told(params: object, target: int) -> None:
    rig = Rig(RE50 if params is RE50 else EC45)
    rig.enable(OperationMode.PROFILE_VELOCITY)
    rig.write(cia402.PROFILE_ACCELERATION, 4000, 4)
    assert rig.has(cia402.STANDING)
    rig.command(ENABLE, target, pdo=2)
    rig.run(abs(target) * 1000 // 8000)
    assert velocity(rig) == pytest.approx(target / 2, abs=60)
    assert not rig.has(cia402.TARGET_REACHED)
    rig.run(1000)
    assert rig.has(cia402.TARGET_REACHED)
    assert not rig.has(cia402.STANDING)
    assert rig.motor.speed_radps * RPM_PER_RADPS == pytest.approx(target, abs=5)


def test_a_change_of_direction_goes_through_zero() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_VELOCITY)
    rig.command(ENABLE, 1000, pdo=2)
    rig.run(500)
    rig.command(ENABLE, -1000, pdo=2)
    seen = []
    for _ in range(500):
        rig.run(1)
        seen.append(velocity(rig))
    assert seen[-1] == pytest.approx(-1000, abs=10)
    assert all(later <= earlier + 10 for earlier, later in itertools.pairwise(seen))


def test_velocity_is_bounded_and_a_bounded_target_says_so() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_VELOCITY)
    rig.write(cia402.PROFILE_VELOCITY_MAX, 800, 4)
    rig.command(ENABLE, 5000, pdo=2)
    rig.run(500)
    assert velocity(rig) == pytest.approx(800, abs=10)
    assert rig.has(cia402.LIMIT_ACTIVE)


def test_the_supply_bounds_the_speed_and_the_drive_the_current() -> None:
    rig = Rig(RE50)
    rig.enable(OperationMode.PROFILE_VELOCITY)
    rig.write(cia402.PROFILE_ACCELERATION, 1_000_000, 4)
    rig.command(ENABLE, 5000, pdo=2)
    highest_a = 0.0
    for _ in range(1000):
        rig.run(1)
        highest_a = max(highest_a, abs(rig.motor.current_a))
    assert 24.0 < highest_a <= 25.0
    assert 0.9 * RE50.no_load_speed_radps < rig.motor.speed_radps < RE50.no_load_speed_radps


def test_max_current_bounds_the_torque() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_VELOCITY)
    assert rig.write(cia402.CURRENT_MAX, 500, 2) == 0  # permille of 2 A
    rig.command(ENABLE, 3000, pdo=2)
    highest_a = 0.0
    for _ in range(200):
        rig.run(1)
        highest_a = max(highest_a, abs(rig.motor.current_a))
    assert highest_a == pytest.approx(1.0)


# Homing


def home(rig: Rig, method: HomingMethod, *, offset: int = 0) -> None:
    rig.enable(OperationMode.HOMING)
    assert rig.write(cia402.HOMING_METHOD, method, 1) == 0
    assert rig.write(cia402.HOME_OFFSET, offset, 4) == 0
    rig.command(ENABLE | cia402.HOMING_START)


def test_homing_here_makes_this_place_the_offset() -> None:
    rig = Rig(angle_rad=3.0)
    home(rig, HomingMethod.HERE, offset=250)
    rig.run(20)
    assert rig.has(cia402.HOMING_ATTAINED | cia402.TARGET_REACHED)
    assert position(rig) == 250


@pytest.mark.parametrize(
    ("method", "turn"), [(HomingMethod.INDEX_POSITIVE, 1), (HomingMethod.INDEX_NEGATIVE, 0)]
)
def test_homing_on_the_index_finds_the_next_whole_turn(method: HomingMethod, turn: int) -> None:
    rig = Rig(angle_rad=2.0)
    home(rig, method, offset=100)
    assert not rig.has(cia402.HOMING_ATTAINED)
    rig.run(2000)
    assert rig.has(cia402.HOMING_ATTAINED | cia402.TARGET_REACHED)
    true_counts = rig.motor.angle_rad / math.tau * COUNTS_PER_REV
    assert position(rig) - 100 == pytest.approx(true_counts - turn * COUNTS_PER_REV, abs=1)


@pytest.mark.parametrize(
    ("method", "side"), [(HomingMethod.STOP_POSITIVE, 1), (HomingMethod.STOP_NEGATIVE, -1)]
)
def test_homing_against_the_end_stop_is_soft_and_finds_it(
    method: HomingMethod, side: int
) -> None:
    rig = Rig(replace(EC45, stop_rad=5.0))
    highest_a = 0.0
    rig.enable(OperationMode.HOMING)
    rig.write(cia402.HOMING_METHOD, method, 1)
    rig.write(cia402.HOMING_CURRENT, 800, 2)
    rig.write(cia402.HOME_OFFSET, side * 3000, 4)
    rig.command(ENABLE | cia402.HOMING_START)
    while not rig.has(cia402.HOMING_ATTAINED):
        rig.run(1)
        highest_a = max(highest_a, abs(rig.motor.current_a))
        assert rig.now_ns < 5000 * MS
    assert rig.motor.angle_rad == pytest.approx(side * 5.0)
    assert highest_a == pytest.approx(0.8)
    rig.run(100)
    assert position(rig) == side * 3000
    assert rig.has(cia402.TARGET_REACHED)


def test_homing_that_meets_a_stop_before_the_index_fails_and_says_so() -> None:
    rig = Rig(replace(EC45, stop_rad=2.5), angle_rad=2.0)
    home(rig, HomingMethod.INDEX_POSITIVE)
    rig.run(2000)
    assert rig.has(cia402.HOMING_ERROR | cia402.TARGET_REACHED)
    assert not rig.has(cia402.HOMING_ATTAINED)


def test_homing_is_interrupted_when_its_bit_goes() -> None:
    rig = Rig(angle_rad=2.0)
    home(rig, HomingMethod.INDEX_POSITIVE)
    rig.run(50)
    rig.command(ENABLE)
    rig.run(500)
    assert rig.has(cia402.TARGET_REACHED)
    assert not rig.has(cia402.HOMING_ATTAINED)
    assert velocity(rig) == 0
    assert rig.motor.angle_rad < math.tau


def test_halt_pauses_a_search() -> None:
    rig = Rig(angle_rad=2.0)
    home(rig, HomingMethod.INDEX_POSITIVE)
    rig.run(50)
    rig.command(ENABLE | cia402.HOMING_START | cia402.HALT)
    rig.run(500)
    held = position(rig)
    rig.run(500)
    assert position(rig) == held
    rig.command(ENABLE | cia402.HOMING_START)
    rig.run(2000)
    assert rig.has(cia402.HOMING_ATTAINED)


# Modes and their objects


def test_a_change_of_mode_moves_nothing_that_was_not_asked_for() -> None:
    rig = Rig()
    rig.enable(OperationMode.PROFILE_POSITION)
    move(rig, NOW, 5000)
    rig.run(1500)
    rig.write(cia402.MODE, OperationMode.PROFILE_VELOCITY, 1)
    assert rig.read(cia402.MODE_DISPLAY, 1) == OperationMode.PROFILE_VELOCITY
    rig.run(300)
    assert position(rig) == pytest.approx(5000, abs=1)
    rig.command(ENABLE, 600, pdo=2)
    rig.run(300)
    rig.write(cia402.MODE, OperationMode.PROFILE_POSITION, 1)
    rig.run(500)
    assert velocity(rig) == 0


@pytest.mark.parametrize(
    ("key", "value", "width", "abort"),
    [
        (cia402.MODE, 2, 1, ABORT_VALUE),
        (cia402.MODE, -1, 1, ABORT_VALUE),
        (cia402.HOMING_METHOD, 17, 1, ABORT_VALUE),
        (cia402.QUICK_STOP_OPTION, 3, 2, ABORT_VALUE),
        (cia402.HALT_OPTION, 0, 2, ABORT_VALUE),
        (cia402.ABORT_CONNECTION_OPTION, 4, 2, ABORT_VALUE),
        (cia402.FAULT_REACTION_OPTION, 3, 2, ABORT_TOO_HIGH),
        (cia402.PROFILE_ACCELERATION, 0, 4, ABORT_TOO_LOW),
        (cia402.PROFILE_VELOCITY, 25_001, 4, ABORT_TOO_HIGH),
        (cia402.STATUSWORD, 0, 2, 0x06010002),
        (cia402.TARGET_POSITION, 0, 2, 0x06070010),
        (0x607D03, 0, 4, 0x06090011),
        (0x607000, 0, 4, 0x06020000),
    ],
)
def test_sdo_refuses_what_a_drive_does_not_take(
    key: int, value: int, width: int, abort: int
) -> None:
    rig = Rig()
    before = dict(rig.drive.values)
    assert rig.write(key, value, width) == abort
    assert rig.drive.values == before


@pytest.mark.parametrize("target", [-3.7, 1.0, 2500.0, 123_456.0])
@pytest.mark.parametrize("acceleration", [1000.0, 700_000.0])
def test_a_reference_stops_on_its_target_and_keeps_every_limit(
    target: float, acceleration: float
) -> None:
    reference, before = Reference(), 0.0
    limit = acceleration * 0.001 * (1 + 1e-9)
    for _ in range(400_000):
        reference.approach(target, 80_000.0, acceleration, acceleration, 0.001)
        assert abs(reference.velocity) <= 80_000.0
        assert abs(reference.velocity - before) <= limit
        before = reference.velocity
        if reference.velocity == 0.0 and abs(reference.position - target) < 1e-6:
            break
    assert reference.position == pytest.approx(target, abs=1e-6)
    assert reference.velocity == 0.0
