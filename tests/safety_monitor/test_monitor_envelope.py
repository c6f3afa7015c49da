"""The motion envelope of TABBY EVO: every limit a second time by hand, dense around its edge."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from dbc.messages import Mode, MonitorReason
from tests.safety_monitor.monitor_bus import (
    BRAKE,
    DENY,
    NAN,
    PERMIT,
    RADIUS_M,
    TABBY,
    Answer,
    MonitorBus,
)

SPEED_MPS_MAX = 8.2
LATERAL_MPS2_MAX = 3.0
JERK_MPS3_MAX = 5.0
ANGLE_RAD_MAX = 9.45
RATE_RADPS_MAX = 11.0
ANGLE_DIVERGENCE_RAD_MAX = 1.2
SPEED_DIVERGENCE_MPS_MAX = 1.5
BRAKE_DIVERGENCE_MAX = 0.3
AXLE_MPS_MAX = 1.0
WHEELBASE_M = 2.36
RATIO = 40.0

HOLD_CYCLES = 3
"""A limit must be exceeded for 30 ms: three cycles after the first reading beyond it."""


def lateral_mps2(wheel_radps: float, angle_rad: float) -> float:
    """v^2 times the curvature of the bicycle model."""
    return (wheel_radps * RADIUS_M) ** 2 * math.tan(angle_rad / RATIO) / WHEELBASE_M


def judged(bus: MonitorBus) -> MonitorReason:
    """The reason after the hold time of the envelope."""
    return bus.run(10 * (HOLD_CYCLES + 1)).told[1]


def expects(is_beyond: bool, reason: MonitorReason) -> MonitorReason:
    return reason if is_beyond else MonitorReason.NONE


def manual() -> MonitorBus:
    return MonitorBus().permitted()


# Each limit, dense -----------------------------------------------------------------------------


REVERSE_MPS_MAX = 2.2
"""1.5 m/s backwards, and the 0.7 m/s that forwards has above 7.5 m/s."""


@pytest.mark.parametrize(
    ("sign", "limit_mps", "first_raw", "rear_radps"),
    [(1.0, SPEED_MPS_MAX, 2840, 28.0), (-1.0, REVERSE_MPS_MAX, 750, 7.5)],
)
def test_speed_edge_to_a_hundredth_of_a_radian_per_second(
    sign: float, limit_mps: float, first_raw: int, rear_radps: float
) -> None:
    bus = manual()
    for raw in range(first_raw, first_raw + 40):
        bus.say("THROTTLE_STATUS", wheel_speed_radps=sign * raw * 0.01)
        bus.say("BRAKE_STATUS", rear_wheel_speed_radps=sign * rear_radps)  # of coarser resolution
        beyond = raw * 0.01 * RADIUS_M > limit_mps
        told = judged(bus)
        # After a breach it takes half a second to be permitted again: STARTING is no finding.
        assert (told is MonitorReason.SPEED) == beyond, raw
    assert bus.answers[-1].told == (DENY, MonitorReason.SPEED, 0x183)


@pytest.mark.parametrize("fast", ["THROTTLE_STATUS", "BRAKE_STATUS"])
def test_the_faster_axle_is_the_speed(fast: str) -> None:
    bus = manual()
    bus.say_speed(8.0)
    bus.run(20)
    signal = "wheel_speed_radps" if fast == "THROTTLE_STATUS" else "rear_wheel_speed_radps"
    bus.say(fast, **{signal: 8.4 / RADIUS_M})
    assert judged(bus) is MonitorReason.SPEED


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_steering_angle_edge_to_half_a_milliradian(sign: float) -> None:
    bus = manual()
    for raw in range(18_000, 18_860, 20):  # approached at 1 rad/s
        bus.say("STEER_STATUS", steering_wheel_angle_rad=sign * raw * 0.0005)
        bus.tick()
    for raw in range(18_860, 18_940):
        bus.say("STEER_STATUS", steering_wheel_angle_rad=sign * raw * 0.0005)
        told = judged(bus)
        if raw >= 18_866:  # the approach from zero has left the windows
            assert (told is MonitorReason.STEERING_ANGLE) == (raw * 0.0005 > ANGLE_RAD_MAX), raw
    assert bus.answers[-1].told == (DENY, MonitorReason.STEERING_ANGLE, 0x182)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("raw_step", [200, 215, 218, 219, 221, 222, 225, 240])
def test_steering_rate_edge_to_half_a_milliradian_per_cycle(raw_step: int, sign: int) -> None:
    bus = manual()
    for n in range(40):
        bus.say("STEER_STATUS", steering_wheel_angle_rad=sign * n * raw_step * 0.0005)
        bus.tick()
    beyond = raw_step * 0.0005 / 0.01 > RATE_RADPS_MAX
    assert bus.answers[-1].told[1] is expects(beyond, MonitorReason.STEERING_RATE)
    assert bus.answers[-1].told[2] == (0x182 if beyond else 0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_lateral_acceleration_edge_to_half_a_milliradian(sign: float) -> None:
    bus = manual()
    wheel_radps = 24.0
    bus.say_speed(wheel_radps * RADIUS_M)
    edge_rad = RATIO * math.atan(LATERAL_MPS2_MAX * WHEELBASE_M / (wheel_radps * RADIUS_M) ** 2)
    edge_raw = int(edge_rad / 0.0005)
    for raw in range(0, edge_raw - 30, 60):  # 3 rad/s: 1.5 m/s3
        bus.say("STEER_STATUS", steering_wheel_angle_rad=sign * raw * 0.0005)
        bus.tick()
    assert bus.answers[-1].told == (PERMIT, MonitorReason.NONE, 0)
    for raw in range(edge_raw - 30, edge_raw + 30):
        bus.say("STEER_STATUS", steering_wheel_angle_rad=sign * raw * 0.0005)
        told = judged(bus)
        beyond = lateral_mps2(wheel_radps, raw * 0.0005) > LATERAL_MPS2_MAX
        assert (told is MonitorReason.LATERAL_ACCELERATION) == beyond, raw
    assert bus.answers[-1].told == (DENY, MonitorReason.LATERAL_ACCELERATION, 0x182)


@pytest.mark.parametrize("delta_raw", [-80, -3, -1, 1, 3, 15])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_lateral_jerk_is_judged_over_half_a_second(delta_raw: int, sign: float) -> None:
    bus = manual()
    angle_rad = 8.0
    for n in range(101):
        bus.say("STEER_STATUS", steering_wheel_angle_rad=sign * angle_rad * n / 100)
        bus.tick()
    bus.run(600)
    # In one cycle from rest to this speed: the mean over 0.5 s is twice the lateral acceleration.
    curvature = math.tan(angle_rad / RATIO) / WHEELBASE_M
    edge_raw = math.floor(10 * math.sqrt(JERK_MPS3_MAX * 0.5 / curvature) / RADIUS_M)
    raw = edge_raw + delta_raw + (delta_raw < 0)
    bus.say_speed(raw * 0.1 * RADIUS_M)  # the rear wheels' resolution
    beyond = 2.0 * lateral_mps2(raw * 0.1, angle_rad) > JERK_MPS3_MAX
    assert beyond == (delta_raw > 0)
    assert judged(bus) is expects(beyond, MonitorReason.LATERAL_JERK)


def test_a_jerk_that_is_spread_over_more_than_half_a_second_is_gentle() -> None:
    bus = manual()
    for n in range(101):
        bus.say("STEER_STATUS", steering_wheel_angle_rad=8.0 * n / 100)
        bus.tick()
    bus.run(600)
    final = 28.0
    for n in range(1, 81):  # 0.8 s to 5.6 m/s2 would be the same step spread out
        bus.say_speed(final * math.sqrt(n / 80) * RADIUS_M * 0.8)
        assert bus.tick().told[1] is not MonitorReason.LATERAL_JERK


# Persistence, to the cycle -----------------------------------------------------------------------


def cycles_until(bus: MonitorBus, reason: MonitorReason, most: int = 400) -> tuple[int, Answer]:
    """Cycles after the first reading beyond the limit at which the reason is told."""
    for n in range(most):
        answer = bus.tick()
        if answer.told[1] is reason:
            return n, answer
    raise AssertionError(f"{reason.name} never told: {answer.told}")


def test_the_envelope_waits_30_ms() -> None:
    bus = MonitorBus().driving()
    bus.say("STEER_STATUS", applied_steering_wheel_angle_rad=NAN)
    bus.say("THROTTLE_STATUS", applied_wheel_speed_radps=NAN)
    bus.say_speed(8.5)
    cycles, answer = cycles_until(bus, MonitorReason.SPEED)
    assert cycles == HOLD_CYCLES and answer.told == (BRAKE, MonitorReason.SPEED, 0x183)
    assert answer.verdict is not None
    assert answer.verdict.value == pytest.approx(1000 * 8.5 / SPEED_MPS_MAX, abs=6)


def test_three_readings_beyond_a_limit_do_not_brake_and_are_forgotten() -> None:
    bus = MonitorBus().driving()
    bus.say("THROTTLE_STATUS", applied_wheel_speed_radps=NAN)
    bus.forget()
    for _ in range(5):
        bus.say_speed(8.5)
        bus.run(10 * HOLD_CYCLES)
        bus.say_speed(8.0)
        bus.tick()
    assert bus.told_ever() == {PERMIT}


@pytest.mark.parametrize(
    ("name", "signal", "limit", "step", "cycles", "reason", "can_id"),
    [
        ("STEER_STATUS", "applied_steering_wheel_angle_rad", ANGLE_DIVERGENCE_RAD_MAX, 0.0005,
         20, MonitorReason.STEERING_DIVERGENCE, 0x182),
        ("THROTTLE_STATUS", "applied_wheel_speed_radps", SPEED_DIVERGENCE_MPS_MAX / RADIUS_M, 0.01,
         100, MonitorReason.SPEED_DIVERGENCE, 0x183),
        ("BRAKE_STATUS", "applied_position_ratio", BRAKE_DIVERGENCE_MAX, 0.002,
         45, MonitorReason.BRAKE_DIVERGENCE, 0x184),
    ],
)
def test_echo_and_measured_may_differ_by_the_limit_and_for_so_long(
    name: str,
    signal: str,
    limit: float,
    step: float,
    cycles: int,
    reason: MonitorReason,
    can_id: int,
) -> None:
    within = math.floor(limit / step - 1e-6) * step
    bus = MonitorBus().driving()
    bus.say(name, **{signal: within})
    bus.forget()
    bus.run(2_000)
    assert bus.told_ever() == {PERMIT}
    bus.say(name, **{signal: within + 2 * step})
    seen, answer = cycles_until(bus, reason)
    assert seen == cycles and answer.told == (BRAKE, reason, can_id)


def test_a_divergence_that_heals_in_time_is_forgotten() -> None:
    bus = MonitorBus().driving()
    bus.forget()
    for _ in range(4):
        bus.say("STEER_STATUS", applied_steering_wheel_angle_rad=2.0)
        bus.run(200)
        bus.say("STEER_STATUS", applied_steering_wheel_angle_rad=0.0)
        bus.tick()
    assert bus.told_ever() == {PERMIT}


def test_axles_that_disagree_by_more_than_1_mps_for_200_ms_brake() -> None:
    bus = MonitorBus().driving(speed_mps=5.0)
    bus.say("BRAKE_STATUS", rear_wheel_speed_radps=(5.0 - 0.95) / RADIUS_M)
    bus.forget()
    bus.run(1_000)
    assert bus.told_ever() == {PERMIT}
    bus.say("BRAKE_STATUS", rear_wheel_speed_radps=(5.0 - 1.05) / RADIUS_M)
    seen, answer = cycles_until(bus, MonitorReason.SPEED_DIVERGENCE)
    assert seen == 20 and answer.told == (BRAKE, MonitorReason.SPEED_DIVERGENCE, 0x184)


def test_in_a_turn_the_driven_wheels_are_faster_by_the_cosine_of_the_road_wheel() -> None:
    bus = manual()
    angle_rad, rear_mps = 9.4, 5.3  # 13.5 degrees of road wheel: 2.8 % of 5.3 m/s
    for n in range(1, 101):
        bus.say("STEER_STATUS", steering_wheel_angle_rad=angle_rad * n / 100)
        bus.tick()
    front_mps = rear_mps / math.cos(angle_rad / RATIO)
    for excess_mps, is_fine in ((0.95, True), (1.05, False)):
        front_radps = (front_mps + excess_mps) / RADIUS_M
        for n in range(1, 201):
            bus.say("THROTTLE_STATUS", wheel_speed_radps=front_radps * n / 200)
            bus.say("BRAKE_STATUS", rear_wheel_speed_radps=rear_mps / RADIUS_M * n / 200)
            bus.tick()
        told = bus.run(300).told
        assert (told[1] is MonitorReason.NONE) == is_fine, told


# Command against measured ------------------------------------------------------------------------

FOLLOW_CYCLES = {
    # 1.25 x (lock to lock at 8.73 rad/s; 7.5 m/s at 2.0 m/s2; 0.29 s of servo) + 0.5 s
    "STEER_COMMAND": math.ceil(100 * (1.25 * 2 * 9.25 / 8.73 + 0.5)),
    "THROTTLE_COMMAND": math.ceil(100 * (1.25 * 7.5 / 2.0 + 0.5)),
    "BRAKE_COMMAND": math.ceil(100 * (1.25 * 0.29 + 0.5)),
}


@pytest.mark.parametrize(
    ("name", "signal", "value", "reason", "can_id"),
    [
        ("STEER_COMMAND", "steering_wheel_angle_rad", 1.25, MonitorReason.STEERING_DIVERGENCE,
         0x202),
        ("STEER_COMMAND", "steering_wheel_angle_rad", -1.25, MonitorReason.STEERING_DIVERGENCE,
         0x202),
        ("THROTTLE_COMMAND", "wheel_speed_radps", 1.55 / RADIUS_M, MonitorReason.SPEED_DIVERGENCE,
         0x203),
        ("BRAKE_COMMAND", "position_ratio", 0.31, MonitorReason.BRAKE_DIVERGENCE, 0x204),
    ],
)
def test_a_command_that_is_not_followed_brakes_although_the_echo_agrees(
    name: str, signal: str, value: float, reason: MonitorReason, can_id: int
) -> None:
    bus = MonitorBus().driving()
    bus.say(name, **{signal: value})
    seen, answer = cycles_until(bus, reason, 1_000)
    assert seen == FOLLOW_CYCLES[name] and answer.told == (BRAKE, reason, can_id)


def test_a_command_within_the_limit_may_stay_unreached_for_ever() -> None:
    bus = MonitorBus().driving()
    bus.say("STEER_COMMAND", steering_wheel_angle_rad=1.15)
    bus.say("THROTTLE_COMMAND", wheel_speed_radps=1.45 / RADIUS_M)
    bus.say("BRAKE_COMMAND", position_ratio=0.29)
    bus.forget()
    bus.run(8_000)
    assert bus.told_ever() == {PERMIT}


def test_too_much_brake_and_a_command_that_changes_sides_are_no_breach() -> None:
    bus = MonitorBus().driving()
    bus.say("BRAKE_STATUS", servo_position_ratio=0.9, applied_position_ratio=0.9)
    bus.forget()
    for n in range(8):
        bus.say("STEER_COMMAND", steering_wheel_angle_rad=9.0 if n % 2 else -9.0)
        bus.run(1_000)
    assert bus.told_ever() == {PERMIT}


def test_a_command_is_not_held_against_a_controlled_stop_nor_against_a_driver() -> None:
    for mode in (Mode.STOPPING, Mode.MANUAL):
        bus = MonitorBus().driving()
        bus.say_mode(mode)
        bus.say("STEER_COMMAND", steering_wheel_angle_rad=5.0)
        bus.say("STEER_STATUS", applied_steering_wheel_angle_rad=0.0)
        bus.run(8_000)
        assert bus.answers[-1].told == (PERMIT, MonitorReason.NONE, 0)


# Backwards -------------------------------------------------------------------------------------


def test_a_car_without_reverse_may_roll_backwards_as_fast_as_forwards() -> None:
    traction = replace(TABBY.traction, reverse_speed_mps_max=0.0)
    bus = MonitorBus(replace(TABBY, traction=traction)).permitted()
    bus.say_speed(-8.0)
    assert judged(bus) is MonitorReason.NONE
    bus.say_speed(-8.4)
    assert judged(bus) is MonitorReason.SPEED


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_100_ms_faster_than_a_walk_against_the_setpoint_brakes(sign: float) -> None:
    for speed_mps, is_hazard in ((0.28, False), (0.33, True)):
        bus = MonitorBus().driving()
        bus.forget()
        bus.say_speed(sign * speed_mps)  # both axles, and the setpoint with them
        bus.say("THROTTLE_STATUS", applied_wheel_speed_radps=-sign * 0.1)
        bus.run(90)
        assert bus.told_ever() == {PERMIT}
        told = bus.run(40).told
        assert (told == (BRAKE, MonitorReason.SPEED_DIVERGENCE, 0x183)) is is_hazard, speed_mps


@pytest.mark.parametrize("applied_radps", [0.0, NAN, 2.0])
def test_no_setpoint_and_one_that_is_followed_are_no_wrong_way(applied_radps: float) -> None:
    bus = MonitorBus().driving()
    bus.forget()
    bus.say_speed(0.5)
    bus.say("THROTTLE_STATUS", applied_wheel_speed_radps=applied_radps)
    bus.run(200)
    assert bus.told_ever() == {PERMIT}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_wrong_way_is_judged_by_the_command_when_nothing_is_applied(sign: float) -> None:
    for command_radps, is_hazard in ((0.0, False), (sign, False), (NAN, False), (-sign, True)):
        bus = MonitorBus().driving()
        bus.forget()
        bus.say_speed(sign * 0.5)
        bus.say("THROTTLE_COMMAND", wheel_speed_radps=command_radps)  # the echo stays at 0
        told = bus.run(140).told
        assert (told == (BRAKE, MonitorReason.SPEED_DIVERGENCE, 0x183)) is is_hazard


def test_wrong_way_needs_a_setpoint() -> None:
    """A driver may go backwards, whichever sign a NaN has; NaN passes for no number."""
    for nan in (NAN, -NAN):
        bus = manual()
        bus.say_speed(-1.0)
        bus.say("THROTTLE_STATUS", applied_wheel_speed_radps=nan)
        bus.forget()
        bus.run(300)
        assert bus.told_ever() == {PERMIT}


def test_an_axle_that_stands_shows_no_wrong_way() -> None:
    bus = MonitorBus().driving()
    bus.forget()
    bus.say_speed(0.5)
    bus.say("BRAKE_STATUS", rear_wheel_speed_radps=0.0)
    bus.say("THROTTLE_STATUS", applied_wheel_speed_radps=-0.1)
    bus.run(200)
    assert bus.told_ever() == {PERMIT}
