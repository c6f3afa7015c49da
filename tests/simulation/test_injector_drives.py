"""Faults of motor drives on the bus, in a car whose motors hang on some."""

from __future__ import annotations

import numpy as np
import pytest

from canbus.cia402_power import PowerState
from dbc.messages import ErrorCode, Mode, Reason, Request
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from simulation.injector import Injector
from simulation.plant.drive_train import DriveUnit
from simulation.world import World
from tests.scenarios.driving import Drive
from vehicles import load_vehicle

pytestmark = pytest.mark.whole_car

BAJA = load_vehicle("baja_5b")
K = FaultKind
STEERING, LEFT, RIGHT = "SteeringDrive", "LeftWheelDrive", "RightWheelDrive"


class Case:
    """A car that drives itself through a bend, and an injector."""

    def __init__(self) -> None:
        self.drive = Drive(vehicle=BAJA).go(1.5, 0.2)
        self.world = self.drive.world
        self.injector = Injector(self.world, np.random.default_rng(1))
        self.began_ns = self.world.now_ns

    def inject(self, kind: FaultKind, target: str, **more: float) -> Case:
        self.injector.begin(Fault(kind=kind, target=target, **more))
        return self

    def unit(self, name: str) -> DriveUnit:
        train = self.drive.car.train
        assert train is not None
        return next(unit for unit in train.units if unit.name == name)

    @property
    def answered_ms(self) -> float:
        return (self.drive.emergencies[0][0] - self.began_ns) / 1e6


SILENT = (ErrorCode.ER2, Reason.NODE_SILENT)
OF_STEERING = (ErrorCode.ER4, Reason.MOTOR_FAULT)
OF_WHEEL = (ErrorCode.ER1, Reason.MOTOR_FAULT)


@pytest.mark.parametrize(
    ("kind", "target", "said", "within_ms"),
    [
        (K.DRIVE_FAULT, STEERING, OF_STEERING, 21.0),
        (K.DRIVE_FAULT, LEFT, OF_WHEEL, 21.0),
        (K.DRIVE_FAULT, RIGHT, OF_WHEEL, 21.0),
        (K.DRIVE_DEAD, STEERING, SILENT, 100.0),
        (K.DRIVE_DEAD, LEFT, SILENT, 100.0),
        (K.DRIVE_DEAD, RIGHT, SILENT, 100.0),
        (K.DRIVE_MUTE, STEERING, SILENT, 100.0),
        (K.DRIVE_MUTE, LEFT, SILENT, 100.0),
        (K.DRIVE_MUTE, RIGHT, SILENT, 100.0),
        (K.DRIVE_DEAF, STEERING, OF_STEERING, 200.0),  # misses its ECU for 150 ms
        (K.DRIVE_DEAF, LEFT, OF_WHEEL, 200.0),
        (K.DRIVE_DEAF, RIGHT, OF_WHEEL, 200.0),
    ],
)
def test_a_fault_of_a_drive_stops_the_car_with_its_code(
    kind: FaultKind, target: str, said: tuple[ErrorCode, Reason], within_ms: float
) -> None:
    case = Case().inject(kind, target)
    case.drive.run(0.3)
    assert case.drive.first_emergency() == said
    assert case.answered_ms < within_ms
    assert case.drive.brakes_to_standstill()


@pytest.mark.parametrize("kind", [K.DRIVE_FAULT, K.DRIVE_DEAD, K.DRIVE_MUTE, K.DRIVE_DEAF])
def test_with_the_fault_over_the_car_is_reset_and_drives_again(kind: FaultKind) -> None:
    case = Case().inject(kind, LEFT, for_s=0.5)
    drive = case.drive
    drive.run(4.0)
    assert drive.is_in(Mode.EMERGENCY) and case.injector.active == []
    drive.request(Request.RESET)
    assert drive.is_in(Mode.MANUAL)
    drive.run(1.5)  # its setting up
    drive.press_button()
    drive.engage()
    assert drive.is_in(Mode.AUTOMATIC), drive.log()


def test_a_drive_that_trips_cannot_be_reset_before_the_fault_is_over() -> None:
    case = Case().inject(K.DRIVE_FAULT, RIGHT)
    case.drive.run(3.0)
    assert case.unit(RIGHT).drive.state is PowerState.FAULT
    case.injector.heal()
    case.drive.run(1.5)  # reset once a second by its ECU
    assert case.unit(RIGHT).drive.state is not PowerState.FAULT


def test_a_dead_drive_comes_back_with_nothing_remembered() -> None:
    case = Case()
    before = case.unit(STEERING).drive
    case.inject(K.DRIVE_DEAD, STEERING, for_s=0.2)
    case.drive.run(0.1)
    assert not case.unit(STEERING).is_alive
    case.drive.run(0.2)
    assert case.unit(STEERING).is_alive and case.unit(STEERING).drive is not before


def test_faults_of_one_drive_overlap_and_the_last_to_end_ends_them() -> None:
    case = Case().inject(K.DRIVE_DEAD, LEFT, for_s=0.2).inject(K.DRIVE_DEAD, LEFT, for_s=0.6)
    case.inject(K.DRIVE_FAULT, RIGHT, for_s=0.2).inject(K.DRIVE_FAULT, RIGHT, for_s=3.0)
    case.drive.run(0.4)
    assert not case.unit(LEFT).is_alive and case.unit(RIGHT).is_tripped
    case.drive.run(2.4)
    assert case.unit(LEFT).is_alive
    assert case.unit(RIGHT).drive.state is PowerState.FAULT  # reset once a second, in vain
    case.drive.run(2.0)
    assert case.unit(RIGHT).drive.state is not PowerState.FAULT


def test_a_drive_that_comes_back_while_it_is_broken_trips_again() -> None:
    case = Case().inject(K.DRIVE_FAULT, LEFT)
    case.drive.run(0.1)
    assert case.unit(LEFT).drive.state is PowerState.FAULT
    case.inject(K.DRIVE_DEAD, LEFT, for_s=0.3)
    case.drive.run(1.0)
    assert case.unit(LEFT).drive.state is PowerState.FAULT


def test_a_car_without_drives_has_none_of_their_faults() -> None:
    world = World(load_vehicle("tabby_evo"), seed=1)
    faults = Injector(world, np.random.default_rng(1))
    with pytest.raises(AssertionError, match="no motor drives"):
        faults.begin(Fault(kind=K.DRIVE_MUTE, target=LEFT))
