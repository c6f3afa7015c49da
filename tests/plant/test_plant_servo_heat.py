"""UWA's servo: it burns if it pulls for too long, and TABBY's, whose heat nobody has given, not."""

from __future__ import annotations

import pytest

from simulation.plant.brakes import Brakes
from simulation.plant.derived import plant_of
from simulation.plant.fsae_electric import SERVO_HEAT
from simulation.plant.params import TABBY_EVO
from vehicles import load_vehicle

UWA = load_vehicle("fsae_electric")
PLANT = plant_of(UWA)


def pull(brakes: Brakes, ratio: float, span_s: float) -> None:
    for _ in range(round(span_s * 1e9) // PLANT.step_ns):
        brakes.step(ratio, True, 1.0, False, 0.0)


def test_a_servo_that_pulls_for_two_minutes_burns_and_never_brakes_again() -> None:
    brakes = Brakes(PLANT.brakes, PLANT.step_ns)
    pull(brakes, 1.0, 115.0)
    assert brakes.servo_ratio == 1.0
    pull(brakes, 1.0, 10.0)
    assert brakes.servo_ratio == 0.0
    pull(brakes, 0.0, 60.0)
    pull(brakes, 1.0, 1.0)
    assert brakes.servo_ratio == 0.0, "burnt is burnt"


def test_it_may_hold_for_ever_and_cools_when_it_rests() -> None:
    brakes = Brakes(PLANT.brakes, PLANT.step_ns)
    pull(brakes, UWA.brake.hold_ratio, 900.0)
    heat = brakes.heat
    assert heat is not None
    assert heat.heat_ratio == pytest.approx(UWA.brake.hold_ratio**2, rel=0.1)
    pull(brakes, 1.0, UWA.brake.on_time_s_max)
    hot_ratio = heat.heat_ratio
    assert hot_ratio < 0.5 * SERVO_HEAT.burnt_ratio
    pull(brakes, 0.0, 100.0)
    assert heat.heat_ratio < 0.7 * hot_ratio and not heat.is_burnt


def test_only_uwas_servo_burns() -> None:
    assert PLANT.brakes.servo_heat == SERVO_HEAT
    assert TABBY_EVO.brakes.servo_heat is None
    brakes = Brakes(TABBY_EVO.brakes, TABBY_EVO.step_ns)
    pull(brakes, 1.0, 300.0)
    assert brakes.servo_ratio == 1.0
