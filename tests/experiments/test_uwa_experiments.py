"""UWA's experiments: the pinned plant, the paper's board, the filtered PWM."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from experiments.uah.tuning import candidates
from experiments.uwa.brake import TRAVEL_DEG
from experiments.uwa.paper_board import SUPPLY_V, PidGains, UwaBoard, column_rad, steer_byte
from experiments.uwa.stack import PLANT, VEHICLE, UwaStack
from experiments.uwa.steering import cycles, stack_turn
from experiments.uwa.throttle import FILTER_S, PWM_HZ, filtered_v, multimeter_v, ripple_v
from experiments.uwa.tuning import GRID, TUNED, Judged, best, cars, judged
from simulation.plant.car import Car
from simulation.plant.derived import derived, plant_of
from simulation.plant.fsae_electric import CIRCUITS, SERVO_HEAT

STILL = PidGains(proportional=0.0, integral_per_s=0.0, derivative_s=0.0)


def board(gains: PidGains = STILL) -> UwaBoard:
    return UwaBoard(Car(PLANT, np.random.default_rng(0)), gains)


def test_the_plant_is_the_cars_own_and_pinned_where_the_paper_measured_it() -> None:
    pattern = derived(VEHICLE)
    assert plant_of(VEHICLE) == PLANT
    expected = replace(
        pattern,
        hardware=replace(pattern.hardware, circuits=CIRCUITS),
        steering=replace(pattern.steering, coulomb_torque_nm=3.1),
        brakes=replace(pattern.brakes, servo_dead_band_ratio=0.010, servo_heat=SERVO_HEAT),
        sensors=replace(
            pattern.sensors,
            column_angle_step_rad=4.4 / 4.0 * 5.0 / 1023,
            column_angle_noise_rad=4.4 / 4.0 * 5.0 / 1023 / 2.0,
            column_angle_zero_rad=ZERO_RAD,
        ),
    )
    assert expected == PLANT
    assert PLANT.brakes.servo_travel_s == 0.29
    assert PLANT.steering.motor_no_load_speed_radps == pytest.approx(5.6)
    assert PLANT.steering.scrub_torque_nm == pytest.approx(7.309, abs=0.001)
    assert PLANT.steering.motor_stall_torque_nm == pytest.approx(46.78, abs=0.01)


ZERO_RAD = 0.013
"""Of the hall sensor, fitted to Table 3."""


@pytest.mark.parametrize("steer", [-128, -1, 0, 84, 127])
def test_a_steering_command_is_a_share_of_the_wheels_range(steer: int) -> None:
    assert column_rad(steer) == pytest.approx(steer / 128.0 * 2.0)
    assert steer_byte(column_rad(steer)) == steer


def test_an_angle_beyond_the_range_is_the_largest_command() -> None:
    assert (steer_byte(9.0), steer_byte(-9.0)) == (127, -128)


def test_the_board_turns_the_column_towards_its_command_and_not_without_gains() -> None:
    driven, still = board(replace(STILL, proportional=0.03)), board()
    for one in (driven, still):
        one.tell(steer=64)
        one.run_for(1.0)
    assert math.degrees(driven.run.column_angle_rad[-1]) > 40.0
    assert abs(math.degrees(still.run.column_angle_rad[-1])) < 0.1


def test_commands_that_stop_coming_brake_at_the_next_look_but_one() -> None:
    one = board()
    one.tell(accelerate=20)
    one.run_for(0.59)
    one.run_for(0.30, is_told=False)
    assert max(one.servo_ratio) == 0.0
    one.run_for(0.35, is_told=False)
    assert one.servo_ratio[-1] == pytest.approx(1.0)
    one.tell(brake=0)
    one.run_for(0.5)
    assert one.servo_ratio[-1] == pytest.approx(1.0), "an emergency stays"


@pytest.mark.parametrize("wrong", [{"brake": 256}, {"accelerate": -1}, {"steer": 128}])
def test_the_board_has_no_command_beyond_a_byte(wrong: dict[str, int]) -> None:
    with pytest.raises(AssertionError):
        board().tell(**wrong)


@pytest.mark.parametrize("duty", [0.02, 0.5, 0.9])
def test_the_filtered_pwm_is_what_a_filter_makes_of_pulses(duty: float) -> None:
    steps, volts, seen = 2000, 0.0, []
    period_s = 1.0 / PWM_HZ
    for number in range(900 * steps):
        inside = number % steps
        target = SUPPLY_V if inside < duty * steps else 0.0
        volts += (target - volts) * period_s / steps / FILTER_S
        if number >= 899 * steps:
            seen.append(volts)
    at = (np.arange(steps) + 1.0) / steps
    assert filtered_v(duty, PWM_HZ, FILTER_S, at) == pytest.approx(np.array(seen), abs=2e-4)
    assert max(seen) - min(seen) == pytest.approx(ripple_v(duty, PWM_HZ, FILTER_S), abs=1e-4)


def test_a_multimeter_shows_the_share_of_five_volts() -> None:
    assert multimeter_v(0) == 0.0
    assert multimeter_v(51) == pytest.approx(1.0, abs=1e-3)
    assert multimeter_v(255) == pytest.approx(5.0, abs=1e-3)


def test_the_servos_dead_band_is_below_a_degree() -> None:
    assert 0.6 < PLANT.brakes.servo_dead_band_ratio * TRAVEL_DEG < 1.0


@pytest.mark.slow
def test_the_tuned_gains_are_better_than_their_neighbours_in_the_grid() -> None:
    around = [(gains, judged(gains)) for gains in candidates(GRID, TUNED)]
    assert best(around) == TUNED


def test_a_candidate_that_overshoots_is_not_taken() -> None:
    slow, wild = {"rate_gain": 1.0}, {"rate_gain": 0.0}
    found = [
        (slow, Judged(error_deg=0.5, overshoot_percent=12.0)),
        (wild, Judged(error_deg=0.1, overshoot_percent=12.1)),
    ]
    assert best(found) == slow


def test_the_cars_of_the_tuning_differ_in_one_number_each() -> None:
    found = dict(cars())
    assert found.pop("as fitted") == PLANT and len(found) == 7
    for plant in found.values():
        changed = [
            name for name in PLANT.steering.__dataclass_fields__
            if getattr(plant.steering, name) != getattr(PLANT.steering, name)
        ]  # fmt: skip
        assert len(changed) == 1 and replace(plant, steering=PLANT.steering) == PLANT


@pytest.mark.slow
def test_without_the_calibration_the_zero_comes_on_top() -> None:
    """What the documents say of it."""
    targets, reached = cycles(stack_turn(UwaStack(0)), 2)
    left_deg = float(np.abs(reached - targets)[targets == 15.0].mean())
    zero_deg = math.degrees(ZERO_RAD) / 5.0  # 0.15 deg, and 0.105 deg with the calibration
    assert 0.8 * zero_deg < left_deg - 0.105 < 1.1 * zero_deg
