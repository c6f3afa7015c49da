"""The steering and the speed loop, each on a simple plant."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ecus.steering.control import SteeringLoop
from ecus.steering.params import SteeringParams
from ecus.throttle.control import INTEGRAL_MPS2_MAX, SpeedLoop, actuator_of
from ecus.throttle.params import ThrottleParams
from ecus.throttle.ports import IDLE, ThrottleActuator, dac_code
from tests.ecus.ecus_fakes import tabby

RADIUS_M = 0.287
GEAR = 5.8
DT_S = 0.01
MS = 1_000_000
NODES = ("Steering", "Throttle", "BrakeServo", "SafetyMonitor", "Gateway")





# Steering loop -------------------------------------------------------------------------------

STEER = SteeringParams.of(tabby())


def _profile(targets: list[float], start: float = 0.0) -> list[tuple[float, float]]:
    """Reference and its rate after each step of a list of targets."""
    loop = SteeringLoop()
    loop.start(start)
    found = []
    for target in targets:
        loop.measure(loop.reference_rad, DT_S)
        loop.update(target, DT_S, STEER)
        found.append((loop.reference_rad, loop.reference_rate_radps))
    return found


def _is_within_limits(profile: list[tuple[float, float]]) -> bool:
    rates = [0.0, *(rate for _, rate in profile)]
    accelerations = [(b - a) / DT_S for a, b in pairwise(rates)]
    return (
        max(map(abs, rates)) <= STEER.wheel_rate_radps_max + 1e-9
        and max(map(abs, accelerations)) <= STEER.wheel_acceleration_radps2_max + 1e-6
    )


@given(st.lists(st.floats(-20, 20), min_size=1, max_size=12), st.integers(1, 40))
def test_steering_reference_never_exceeds_rate_and_acceleration(
    targets: list[float], hold: int
) -> None:
    profile = _profile([target for target in targets for _ in range(hold)])
    assert _is_within_limits(profile)


@pytest.mark.parametrize("target", [0.001, 0.01, 0.1, 0.5, 1.0, 3.0, -0.05, -2.0, -9.25])
def test_steering_reference_reaches_its_target_without_overshoot(target: float) -> None:
    profile = _profile([target] * 200)
    sign = math.copysign(1.0, target)
    assert max(sign * reference for reference, _ in profile) <= abs(target) + 0.011
    assert profile[-1][0] == pytest.approx(target, abs=1e-6)
    assert profile[-1][1] == pytest.approx(0.0, abs=1e-4)


def test_steering_reference_stays_within_the_rack() -> None:
    assert _profile([30.0] * 300)[-1][0] == pytest.approx(9.25, abs=1e-6)
    assert max(reference for reference, _ in _profile([30.0] * 300)) <= 9.25 + 0.02


def _column(loop: SteeringLoop, target: float, steps: int, load_duty: float = 0.0) -> list[float]:
    """A column with a first-order motor and dry friction; angle after each step."""
    angle = rate = 0.0
    angles = []
    loop.measure(angle, DT_S)
    loop.start(angle)
    for _ in range(steps):
        loop.measure(angle, DT_S)
        duty = loop.update(target, DT_S, STEER)
        assert abs(duty) <= 1.0
        for _ in range(10):
            drive = duty - load_duty
            if rate == 0.0 and abs(drive) <= STEER.motor_friction_duty_ratio:
                continue
            against = math.copysign(STEER.motor_friction_duty_ratio, rate or drive)
            wanted = (drive - against) * STEER.motor_free_speed_radps
            before, rate = rate, rate + (wanted - rate) * 0.001 / STEER.motor_time_constant_s
            rate = 0.0 if before * rate < 0.0 else rate  # friction stops, it does not turn back
            angle += rate * 0.001
        angles.append(angle)
    return angles


@pytest.mark.parametrize("target", [0.1, 0.5, 3.0, -6.0])
def test_steering_loop_on_a_simple_column_settles_with_little_overshoot(target: float) -> None:
    angles = _column(SteeringLoop(), target, 300)
    overshoot = max(angle * math.copysign(1.0, target) for angle in angles) - abs(target)
    assert overshoot <= max(0.0392 * abs(target), 0.05)  # UAH: 3.92 %; 0.07 deg of road wheel
    assert angles[-1] == pytest.approx(target, abs=0.03)


def test_steering_integrator_takes_away_a_constant_load() -> None:
    angles = _column(SteeringLoop(), 2.0, 600, load_duty=0.12)
    assert angles[-1] == pytest.approx(2.0, abs=0.02)


def test_steering_integrator_does_not_wind_up_on_a_blocked_wheel() -> None:
    loop = SteeringLoop()
    loop.start(0.0)
    for _ in range(2000):
        loop.measure(0.0, DT_S)
        assert loop.update(6.0, DT_S, STEER) <= 1.0
    assert abs(loop._integral) <= 0.25
    loop.measure(6.5, DT_S)
    duties = []
    for _ in range(100):
        loop.measure(6.5, DT_S)
        duties.append(loop.update(6.0, DT_S, STEER))
    assert duties[-1] < 0.0


def test_steering_rate_is_forgotten_with_a_broken_sensor() -> None:
    loop = SteeringLoop()
    loop.measure(1.0, DT_S)
    assert loop.rate_radps == 0.0
    for step in range(1, 60):
        loop.measure(1.0 + step * 0.02, DT_S)
    assert loop.rate_radps == pytest.approx(2.0, rel=0.01)
    loop.measure(math.nan, DT_S)
    assert loop.rate_radps == 0.0
    loop.measure(9.0, DT_S)
    assert loop.rate_radps == 0.0


# Speed loop ----------------------------------------------------------------------------------

SPEED = replace(ThrottleParams.of(tabby()), drive_lag_s=0.0)  # as the simple car


def _acceleration(output: ThrottleActuator) -> float:
    """What the two DAC codes ask for, m/s2."""
    throttle = (output.throttle_dac_code - 410) / (3686 - 410)
    regen = (output.regen_dac_code - 410) / (3686 - 410)
    return (
        throttle * SPEED.drive_acceleration_mps2_full - regen * SPEED.regen_deceleration_mps2_full
    )


def _car(loop: SpeedLoop, target: float, steps: int, speed: float = 0.0, slope: float = 0.0) -> (
    list[float]
):
    speeds = []
    for _ in range(steps):
        output = loop.update(target, speed, DT_S, SPEED, is_servo_braking=False)
        resistance = SPEED.rolling_resistance_mps2 if speed > 0.0 else 0.0
        speed = max(speed + (_acceleration(output) - resistance - slope) * DT_S, 0.0)
        speeds.append(speed)
    return speeds


def test_speed_loop_on_a_simple_car_reaches_the_speed_without_overshoot() -> None:
    loop = SpeedLoop()
    loop.start(0.0)
    speeds = _car(loop, 6.9, 1500)
    assert max(speeds) <= 6.9 * 1.02
    assert speeds[-1] == pytest.approx(6.9, abs=0.05)
    accelerations = [(b - a) / DT_S for a, b in pairwise(speeds)]
    assert max(accelerations) <= 2.0 * 1.15


def _lagging_overshoot(drive_lag_s: float) -> float:
    """Of a car whose drive takes 0.4 s, driven by a loop that allows for so much; m/s."""
    loop, params = SpeedLoop(), replace(SPEED, drive_lag_s=drive_lag_s)
    speed = drive = highest = 0.0
    for _ in range(1000):
        asked = loop.update(4.0, speed, DT_S, params, is_servo_braking=False)
        drive += DT_S / 0.4 * (_acceleration(asked) - drive)
        speed = max(speed + (drive - (SPEED.rolling_resistance_mps2 if speed else 0.0)) * DT_S, 0.0)
        highest = max(highest, speed)
    return highest - 4.0


def test_a_speed_loop_that_allows_for_a_slow_drive_does_not_overshoot() -> None:
    assert _lagging_overshoot(0.0) > 0.25
    assert _lagging_overshoot(0.4) < 0.05
    loop = SpeedLoop()  # and begins again where it is
    loop.start(3.0)
    params = replace(SPEED, drive_lag_s=0.4)
    held = loop.update(3.0, 3.0, DT_S, params, is_servo_braking=False)
    assert _acceleration(held) == pytest.approx(SPEED.rolling_resistance_mps2, abs=0.01)


def test_speed_loop_climbs_and_regenerates_to_standstill() -> None:
    loop = SpeedLoop()
    loop.start(5.0)
    assert _car(loop, 5.0, 2000, 5.0, slope=0.8)[-1] == pytest.approx(5.0, abs=0.05)
    assert _car(loop, 0.0, 1000, 5.0)[-1] < 0.12


def test_speed_integrator_freezes_while_the_servo_brakes() -> None:
    loop = SpeedLoop()
    loop.start(5.0)
    _car(loop, 5.0, 500, 5.0, slope=0.4)
    before = loop._integral_mps2
    assert before > 0.1
    for _ in range(300):
        output = loop.update(5.0, 1.0, DT_S, SPEED, is_servo_braking=True)
        assert output.throttle_dac_code == dac_code(0.0)
    assert loop._integral_mps2 == before
    output = loop.update(0.0, 5.0, DT_S, SPEED, is_servo_braking=True)
    assert output.regen_dac_code > dac_code(0.0)


def test_speed_integrator_does_not_wind_up_at_saturation() -> None:
    loop = SpeedLoop()
    loop.start(0.0)
    for _ in range(3000):  # held back by something: full torque, no speed
        loop.update(7.0, 0.0, DT_S, SPEED, is_servo_braking=False)
    assert loop._integral_mps2 < INTEGRAL_MPS2_MAX
    stuck = loop._integral_mps2
    loop.update(7.0, 20.0, DT_S, SPEED, is_servo_braking=False)
    assert loop._integral_mps2 <= stuck


def test_speed_integrator_is_bounded() -> None:
    loop = SpeedLoop()
    loop.start(5.0)
    for _ in range(5000):
        loop.update(5.0, 4.8, DT_S, SPEED, is_servo_braking=False)
    assert loop._integral_mps2 == INTEGRAL_MPS2_MAX


def test_speed_loop_asks_nothing_of_the_motor_at_standstill() -> None:
    loop = SpeedLoop()
    loop.start(-3.0)
    assert loop.reference_mps == 0.0
    assert loop.update(0.0, 0.05, DT_S, SPEED, is_servo_braking=False) == IDLE
    assert loop.update(math.nan, 0.05, DT_S, SPEED, is_servo_braking=False) == IDLE
    assert loop.update(-9.0, -0.05, DT_S, SPEED, is_servo_braking=False) == IDLE


@pytest.mark.parametrize("speed", [0.2, 2.0])
def test_a_car_that_is_to_stand_is_not_pushed_while_its_drive_lags(speed: float) -> None:
    loop, params = SpeedLoop(), replace(SPEED, drive_lag_s=0.4)
    loop.start(speed)
    while loop.reference_mps > 0.0:
        loop.update(0.0, speed, DT_S, params, is_servo_braking=False)
    for _ in range(100):
        asked = loop.update(0.0, speed, DT_S, params, is_servo_braking=False)
        assert asked.throttle_dac_code == IDLE.throttle_dac_code


@given(st.floats(-2, 40), st.floats(0, 10))
def test_speed_reference_obeys_its_limits(target: float, speed: float) -> None:
    loop = SpeedLoop()
    loop.start(speed)
    before = loop.reference_mps
    for _ in range(30):
        loop.update(target, speed, DT_S, SPEED, is_servo_braking=False)
        change = loop.reference_mps - before
        assert -0.02 - 1e-9 <= change <= 0.02 + 1e-9
        before = loop.reference_mps


def test_drive_and_regeneration_are_never_asked_for_together() -> None:
    for acceleration in (-9.0, -1.0, -0.01, 0.0, 0.01, 1.0, 9.0):
        output = actuator_of(acceleration, SPEED)
        assert IDLE.throttle_dac_code in (output.throttle_dac_code, output.regen_dac_code)


def test_motor_without_regeneration_asks_for_none() -> None:
    params = replace(SPEED, regen_deceleration_mps2_full=0.0)
    assert actuator_of(-3.0, params) == IDLE
