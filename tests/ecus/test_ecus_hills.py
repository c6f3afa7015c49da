"""Hills: the brake ECU lets go late and slowly, the throttle ECU pushes against it meanwhile."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from dbc.messages import Mode
from ecus.brake_servo.control import SLOPE_RAD_MIN
from ecus.throttle.hill_start import HillPhase
from ecus.throttle.ports import IDLE, dac_code
from tests.ecus.ecus_fakes import Rig, changed, tabby

BRAKE = tabby().brake
HOLD = BRAKE.hold_ratio
ZERO = dac_code(0.0)
HOLD_STEPS, EASE_STEPS = 45, 50
"""0.45 s and 0.5 s (docs/safety.md); these and those below are written a second time by hand."""


# The brake ECU -----------------------------------------------------------------------------------


def holding(slope_rad: float, hold: float = HOLD) -> Rig:
    """Stands in AUTOMATIC with the brake on."""
    rig = Rig("BrakeServo")
    rig.sense(slope_rad=slope_rad)
    rig.steps(60)
    rig.drive(hold)
    rig.steps(60)
    assert rig.output.actuator.servo_position_ratio == pytest.approx(hold, abs=0.001)
    return rig


def released(rig: Rig, steps: int) -> list[float]:
    """Where the servo is sent in the steps after the command to let go."""
    rig.setpoint = 0.0
    return [rig.step().servo_position_ratio for _ in range(steps)]


@pytest.mark.parametrize("slope_rad", [0.0, SLOPE_RAD_MIN - 0.001, 0.001 - SLOPE_RAD_MIN])
def test_on_the_level_the_brake_is_let_go_at_once(slope_rad: float) -> None:
    assert released(holding(slope_rad), 12)[-1] == 0.0


@pytest.mark.parametrize("slope_rad", [SLOPE_RAD_MIN + 0.001, -0.03, 0.14, -0.14, math.nan])
def test_on_a_hill_or_without_a_reading_it_stays_on_and_is_eased(slope_rad: float) -> None:
    positions = released(holding(slope_rad), HOLD_STEPS + EASE_STEPS + 12)
    assert min(positions[: HOLD_STEPS]) == pytest.approx(HOLD, abs=0.001)
    half = positions[HOLD_STEPS + EASE_STEPS // 2]
    assert half == pytest.approx(HOLD / 2.0, abs=0.03)
    assert all(b <= a for a, b in pairwise(positions))
    assert positions[-1] == 0.0


def test_a_moving_car_is_never_held_against_its_command() -> None:
    rig = holding(0.0)
    rig.sense(slope_rad=0.14)
    rig.speed_mps = 0.3
    rig.steps(30)
    assert released(rig, 12)[-1] == 0.0


def test_what_is_felt_while_stopping_is_no_hill() -> None:
    rig = holding(0.0)
    rig.speed_mps = 2.0
    rig.sense(slope_rad=-0.2)  # 2 m/s2 of braking
    rig.steps(20)
    rig.speed_mps = 0.0
    rig.sense(slope_rad=0.0)
    rig.steps(100)
    assert released(rig, 12)[-1] == 0.0


def test_told_to_brake_again_it_brakes_at_once_and_the_next_start_has_its_whole_time() -> None:
    rig = holding(0.14)
    released(rig, HOLD_STEPS + EASE_STEPS // 2)
    rig.setpoint = HOLD
    assert rig.steps(12).servo_position_ratio == pytest.approx(HOLD, abs=0.001)
    positions = released(rig, HOLD_STEPS)
    assert min(positions) == pytest.approx(HOLD, abs=0.001)


def test_an_emergency_outranks_the_easing() -> None:
    rig = holding(0.14)
    released(rig, HOLD_STEPS + 5)
    assert rig.emergency().steps(2).servo_position_ratio == 1.0


# The throttle ECU --------------------------------------------------------------------------------

NOTICE_STEPS, BUILD_STEPS, INTERLOCK_STEPS = 20, 40, 40
TARGET_RADPS = 1.0 / tabby().geometry.wheel_radius_m


def braked(servo: float = HOLD, applied: float = HOLD) -> Rig:
    """Told to stand, and held by the brake ECU."""
    rig = Rig("Throttle")
    rig.servo, rig.servo_applied = servo, applied
    rig.drive(0.0)
    rig.steps(30)
    return rig


def pushes(rig: Rig, steps: int) -> list[int]:
    rig.setpoint = TARGET_RADPS
    return [rig.step().throttle_dac_code for _ in range(steps)]


def test_a_brake_that_is_held_for_long_is_pushed_against_up_to_what_it_holds() -> None:
    codes = pushes(braked(), NOTICE_STEPS + BUILD_STEPS + 20)
    assert set(codes[: NOTICE_STEPS - 1]) == {ZERO}
    assert all(b >= a for a, b in pairwise(codes))
    hold_mps2 = HOLD * BRAKE.deceleration_mps2_full
    full_mps2 = 128.0 * 5.8 / (0.287 * 880.0)  # UAH's motor and gear
    assert codes[-1] == dac_code(hold_mps2 / full_mps2)


def test_the_echo_stays_at_zero_while_it_pushes() -> None:
    rig = braked()
    pushes(rig, 60)
    assert rig.now_sent("STATUS")[0].applied_wheel_speed_radps == 0.0


@pytest.mark.parametrize(("servo", "applied"), [(HOLD, 0.0), (HOLD, math.nan), (0.0, HOLD)])
def test_a_servo_that_is_stuck_or_off_is_not_pushed_against(
    servo: float, applied: float
) -> None:
    rig = braked(servo, applied)
    codes = pushes(rig, 100)
    loop_alone = servo == 0.0  # released: the speed loop drives at once
    assert (max(codes) > ZERO) is loop_alone


def test_told_to_stand_nothing_pushes() -> None:
    rig = braked()
    assert rig.steps(100) == IDLE


def test_braked_on_the_way_nothing_pushes() -> None:
    rig = braked()
    rig.speed_mps = 2.0
    rig.steps(30)
    assert max(pushes(rig, 100)) == ZERO


def test_a_car_that_moves_is_driven_by_its_loop_which_allows_for_the_brake() -> None:
    rig = braked()
    before = pushes(rig, 60)[-1]
    rig.speed_mps = 0.3
    rig.steps(5)
    assert rig.now_sent("STATUS")[0].applied_wheel_speed_radps > 0.0
    assert rig.output.actuator.throttle_dac_code > ZERO
    rig.servo = rig.servo_applied = 0.0  # what the brake took is no longer asked of the motor
    assert rig.steps(3).throttle_dac_code < before


def test_without_news_of_the_brake_the_push_ends() -> None:
    rig = braked()
    assert pushes(rig, 60)[-1] > ZERO
    rig.servo = None
    assert rig.steps(8).throttle_dac_code == ZERO


def test_an_unreadable_servo_ends_a_hill_start() -> None:
    for speed_mps in (0.0, 0.3):  # it pushes, and it moves
        rig = braked()
        assert pushes(rig, 60)[-1] > ZERO
        rig.speed_mps = speed_mps
        rig.steps(5)
        rig.servo = math.nan
        assert rig.steps(3).throttle_dac_code == ZERO


@pytest.mark.parametrize("end", ["driver", "emergency"])
def test_the_next_hill_start_begins_without_torque(end: str) -> None:
    rig = braked()
    assert pushes(rig, 60)[-1] > ZERO
    if end == "driver":
        rig.mode, rig.is_authorised = Mode.MANUAL, False
    else:
        rig.emergency()
    rig.steps(3)
    assert rig.node._hill.phase is HillPhase.NONE and rig.node._hill.push_mps2 == 0.0


def test_the_contact_waits_for_the_end_of_a_push() -> None:
    rig = Rig("Throttle", changed(tabby(), traction={"reverse_speed_mps_max": 1.5}))
    rig.servo = rig.servo_applied = HOLD
    rig.drive(0.0)
    rig.steps(30)
    assert pushes(rig, 100)[-1] > ZERO  # longer than the interlock
    rig.setpoint = -TARGET_RADPS
    rig.steps(5)  # bus and setpoint have come
    selected = []
    for _ in range(INTERLOCK_STEPS + 10):
        actuator = rig.step()
        selected.append(actuator.reverse_selected)
        assert selected[-1] or actuator.throttle_dac_code == ZERO
    assert not any(selected[: INTERLOCK_STEPS - 6]) and selected[-1]


def test_a_hold_that_a_driver_ended_is_not_eased_in_the_next_drive() -> None:
    rig = holding(0.14)
    released(rig, HOLD_STEPS + 5)
    rig.mode, rig.is_authorised = Mode.MANUAL, False
    rig.steps(3)
    assert rig.node._hill._since_ns is None
