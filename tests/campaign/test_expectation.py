"""What a fault asks for, of the car that it strikes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from campaign.expectation import DEAF_MS, GRIP_SHARE, PATH, expected, grip_share
from campaign.result import Demand
from oracle.settings import Settings
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from vehicles import known_vehicles, load_vehicle

K = FaultKind


@pytest.mark.parametrize("name", known_vehicles())
def test_on_the_shipped_cars_a_third_of_a_drivers_strength_is_felt(name: str) -> None:
    assert grip_share(Settings.of(load_vehicle(name))) == GRIP_SHARE


@pytest.mark.parametrize(
    "higher", [{"driver_torque_nm": 6.0}, {"throttle_pedal_ratio": 0.6},
               {"brake_pedal_ratio": 0.6}],
)
def test_a_car_with_higher_thresholds_asks_for_a_firmer_grip(higher: dict[str, float]) -> None:
    grip = grip_share(Settings.of(load_vehicle("tabby_evo"), **higher))
    assert grip == pytest.approx(0.6)
    fault = Fault(kind=K.DRIVER_GRABS, target="steering", value=0.5)
    assert expected(fault).demand is Demand.HANDOVER
    assert expected(fault, grip).demand is Demand.ANY
    assert expected(replace(fault, value=0.7), grip).demand is Demand.HANDOVER


@pytest.mark.parametrize("kind", [K.DRIVE_FAULT, K.DRIVE_DEAD, K.DRIVE_MUTE])
def test_a_drive_that_is_gone_asks_for_the_brake_within_100_ms(kind: FaultKind) -> None:
    ask = expected(Fault(kind=kind, target="SteeringDrive", for_s=1.0))
    assert (ask.demand, ask.budget_ms) == (Demand.BRAKE, 100.0) and PATH in ask.excuses


@pytest.mark.parametrize(
    ("target", "stays"),
    [
        ("SteeringDrive", "steering coasts on ER4 and ER6"),
        ("LeftWheelDrive", "no drive torque while emergency braking"),
        ("RightWheelDrive", "no drive torque while emergency braking"),
    ],
)
def test_a_deaf_drive_goes_on_until_it_has_missed_its_ecu_for_150_ms(
    target: str, stays: str
) -> None:
    ask = expected(Fault(kind=K.DRIVE_DEAF, target=target, for_s=1.0))
    assert (ask.demand, ask.budget_ms) == (Demand.BRAKE, DEAF_MS)
    assert ask.excuses == {PATH, stays} and 150.0 < DEAF_MS < 175.0
    assert expected(Fault(kind=K.DRIVE_DEAF, target=target, for_s=0.1)).budget_ms is None
