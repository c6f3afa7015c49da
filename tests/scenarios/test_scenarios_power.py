"""All nodes lose their power at once, and come back knowing nothing of what was before."""

from __future__ import annotations

import pytest

from dbc.messages import Mode, Reason
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from simulation.injector import Injector
from tests.scenarios.driving import Drive

pytestmark = pytest.mark.whole_car

FULL_NS = 350_000_000
"""The watchdogs' 50 ms, the servo's 290 ms, and what the grid of the plant adds."""


def brown_out(drive: Drive, span_s: float) -> None:
    faults = Injector(drive.world, drive.world.fault_rng)
    faults.begin(Fault(kind=FaultKind.BROWN_OUT, value=span_s))


@pytest.mark.parametrize("span_s", [0.06, 0.2, 0.3, 0.5, 1.0, 3.0])
def test_power_lost_while_driving_ends_at_a_stand_with_the_brake_never_let_go(
    span_s: float,
) -> None:
    drive = Drive().go(5.0, 0.02)
    begin_ns = drive.world.now_ns
    brown_out(drive, span_s)
    before = 0.0
    while abs(drive.speed) > 0.02:
        drive.run(0.02)
        assert drive.brake >= before - 0.03, drive.log()  # the sensor's noise and dead band
        before = drive.brake
        assert drive.world.now_ns < begin_ns + 4_000_000_000
    drive.run(max(span_s, 0.5))
    assert drive.brake > 0.9 and drive.car.truth.relay_closed
    assert drive.is_in(Mode.EMERGENCY)
    assert any(
        message.reason is Reason.ADOPTED for _, sender, message in drive.emergencies
        if sender == "Supervisor"
    )


def test_after_that_the_driver_gets_his_car_back_by_the_button() -> None:
    drive = Drive().go(5.0)
    brown_out(drive, 0.3)
    drive.brakes_to_standstill()
    drive.run(1.0)
    drive.press_button()
    drive.run(0.5)
    assert drive.is_in(Mode.MANUAL) and not drive.car.truth.relay_closed
    assert drive.brake < 0.02
    drive.press_button()
    drive.run(0.7)
    drive.engage()
    assert drive.is_in(Mode.AUTOMATIC), drive.state.why_not_engaged


@pytest.mark.parametrize("span_s", [0.06, 0.3, 1.0])
def test_power_lost_under_a_human_driver_brakes_nothing(span_s: float) -> None:
    drive = Drive().start()
    drive.car.driver.throttle_pedal_ratio = 0.3
    drive.run(3.0)
    assert drive.speed > 1.0
    brown_out(drive, span_s)
    for _ in range(100):
        drive.run(0.02)
        assert drive.brake < 0.02 and not drive.car.truth.relay_closed
    assert drive.is_in(Mode.MANUAL)


@pytest.mark.parametrize("name", ["Supervisor", "BrakeServo"])
def test_one_node_that_loses_its_power_while_driving_lets_no_brake_go(name: str) -> None:
    drive = Drive().go(5.0)
    faults = Injector(drive.world, drive.world.fault_rng)
    faults.begin(Fault(kind=FaultKind.RESTART, target=name, value=0.2))
    before = 0.0
    while abs(drive.speed) > 0.02:
        drive.run(0.02)
        assert drive.brake >= before - 0.03, drive.log()
        before = drive.brake
    assert drive.is_in(Mode.EMERGENCY)


def test_a_brake_ecu_that_restarts_while_the_supervisor_is_dead_lets_no_brake_go() -> None:
    """Nobody tells it who drives: its watchdog goes on braking, as the relay is closed."""
    drive = Drive().go(6.0)
    drive.stop_node("Supervisor")
    drive.run(0.4)
    drive.world.stations["BrakeServo"].restart()
    before = drive.brake
    assert before > 0.5
    while abs(drive.speed) > 0.02:
        drive.run(0.02)
        assert drive.brake >= before - 0.03, drive.log()
        before = drive.brake
