"""Faults of the real world: dead and stopped processes, a link that is down, a full queue."""

from __future__ import annotations

import signal
from functools import partial

import pytest

from dbc.messages import EmergencyBrake, ErrorCode, Mode, Reason
from runtime.nodes import NODES
from tests.vcan.answers import emcy, is_missed
from tests.vcan.shell import cansend, run
from tests.vcan.stack import VEHICLE_BUS, Stack, pause

MALFORMED = {
    "181#00": "181#00: length",
    "00000182#0000000000000000": "(extended)",
    "203#R": "203#R",
    "204#DE10000000000000": "204#DE10000000000000: crc",
    "7FF#01": "7FF#01 (data)",
    "602#2200000000": "ignored an NMT or SDO frame: malformed",
}
"""As `cansend` writes them, and what some node says of them."""



def loses(stack: Stack, name: str, number: signal.Signals) -> None:
    """A node falls silent while the car drives: ER2 in time, brakes on."""
    since_s = stack.kill(name, number)
    is_missed(stack, f"ER2: {name}, {number.name}", since_s, stack.first_brake(since_s))
    stack.brakes()


def has_said(stack: Stack, text: str) -> bool:
    """Whether some node has reported it."""
    return any(text in stack.said(name) for name in NODES)


@pytest.mark.parametrize("name", [name for name in NODES if name != "steering"])
def test_a_killed_node_stops_the_car(name: str, driving: Stack) -> None:
    loses(driving, name, signal.SIGKILL)


def test_a_node_that_was_killed_is_rearmed_without_restarting_the_others(driving: Stack) -> None:
    pids = {name: process.pid for name, process in driving.processes.items() if name != "steering"}
    loses(driving, "steering", signal.SIGKILL)
    driving.recover()  # the dead one is started again; reset at standstill
    assert pids.items() <= {name: p.pid for name, p in driving.processes.items()}.items()
    driving.drive()
    assert driving.mode is Mode.AUTOMATIC


@pytest.mark.parametrize("name", NODES)
def test_a_node_that_is_stopped_and_goes_on_finds_the_car_braking(
    name: str, driving: Stack
) -> None:
    loses(driving, name, signal.SIGSTOP)
    driving.kill(name, signal.SIGCONT)
    pause(0.5)
    assert driving.mode is not Mode.AUTOMATIC
    assert abs(driving.truth().speed_mps) < 0.01


def test_a_link_that_goes_down_stops_the_car_and_its_return_does_not_start_it(
    driving: Stack,
) -> None:
    run(f"ip link set {VEHICLE_BUS} down")
    try:
        driving.brakes()
    finally:
        run(f"ip link set {VEHICLE_BUS} up")
    pause(0.5)
    assert driving.mode is not Mode.AUTOMATIC
    assert abs(driving.truth().speed_mps) < 0.01
    driving.recover()
    driving.drive()


def test_a_full_transmit_queue_stops_the_car_and_no_old_frame_leaves_late(driving: Stack) -> None:
    run(f"tc qdisc add dev {VEHICLE_BUS} root tbf rate 1kbit burst 64 limit 64")
    try:
        driving.brakes()
        driving.event("steering", "the bus refused them")
    finally:
        run(f"tc qdisc del dev {VEHICLE_BUS} root")
    pause(0.3)
    assert driving.mode is not Mode.AUTOMATIC
    assert abs(driving.truth().speed_mps) < 0.01


def test_foreign_traffic_in_its_own_range_is_tolerated(driving: Stack) -> None:
    since_s = cansend("400#00")
    run("cangen vcan0 -g 2 -I 400 -L 8 -n 250")  # half a second, 500 frames/s
    pause(0.2)
    assert driving.mode is Mode.AUTOMATIC
    assert not [line for line in driving.log(since_s) if 0x010 < line.can_id < 0x020]
    driving.event("safety_monitor", "400#")


def test_a_babbling_node_never_makes_the_car_go_on_unwatched(driving: Stack) -> None:
    """At full speed with random identifiers, ours among them: the car brakes, and stays so."""
    run("cangen vcan0 -g 0 -I i -L 8 -n 3000")
    pause(0.3)
    assert driving.mode is not Mode.AUTOMATIC
    driving.brakes()


def test_a_bus_off_controller_stops_the_car(driving: Stack) -> None:
    since_s = cansend("20000040#0000000000000000")  # an error frame: CAN_ERR_BUSOFF
    message = driving.first_brake(since_s).content
    assert isinstance(message, EmergencyBrake)
    # All hear it; the safety monitor, if its cycle is the next, has its verdict alone to give.
    assert message.reason in (Reason.BUS_OFF, Reason.VERDICT_BRAKE), message
    emcy(driving, since_s, "Supervisor", ErrorCode.ER2)
    driving.brakes()


def test_malformed_frames_are_reported_and_move_nothing(driving: Stack) -> None:
    for text, reported in MALFORMED.items():
        since_s = cansend(text)
        driving.wait(partial(has_said, driving, reported), 1.0)
        assert driving.mode is Mode.AUTOMATIC, text
        assert not [line for line in driving.log(since_s) if 0x010 < line.can_id < 0x020], text
