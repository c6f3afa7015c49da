"""CANopen as others see it: a plain `canopen` client on the bus."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import canopen
import pytest
from canopen.sdo.exceptions import SdoAbortedError

from canbus.node import NODE_IDS
from dbc.messages import Emcy, ErrorCode, Mode
from tests.vcan.shell import cansend
from tests.vcan.stack import Stack, pause

EDS = {"Supervisor": "supervisor", "Steering": "steering", "Throttle": "throttle",
       "BrakeServo": "brake_servo", "SafetyMonitor": "safety_monitor"}
ABORT_TOO_LOW, ABORT_TOO_HIGH, ABORT_STATE = 0x0609_0032, 0x0609_0031, 0x0800_0022
ABORT_READ_ONLY, ABORT_NO_OBJECT = 0x0601_0002, 0x0602_0000
"""CiA 301, table 22."""


@pytest.fixture
def client() -> Iterator[Any]:
    """Somebody's network with all nodes in it."""
    network = canopen.Network()
    network.connect(interface="socketcan", channel="vcan0")
    for node, name in EDS.items():
        path = files("dbc").joinpath("eds", f"{name}.eds")
        network.add_node(canopen.RemoteNode(NODE_IDS[node], str(path)))
    yield network
    network.disconnect()


def test_every_node_is_what_its_eds_says(parked: Stack, client: Any) -> None:
    for node in EDS:
        remote = client[NODE_IDS[node]]
        remote.nmt.wait_for_heartbeat(1.0)
        assert remote.nmt.state == "OPERATIONAL"
        assert remote.sdo[0x1000].raw == remote.object_dictionary[0x1000].default
        for number in range(1, remote.sdo[0x2100][0].raw + 1):
            assert isinstance(remote.sdo[0x2100][number].raw, int)


def test_a_parameter_is_written_in_manual_within_its_range_alone(
    parked: Stack, client: Any
) -> None:
    brake = client[NODE_IDS["BrakeServo"]]
    on_time = brake.sdo[0x2100][1]
    before = on_time.raw
    on_time.raw = before + 1000
    assert on_time.raw == before + 1000
    parked.event("brake_servo", "on_time_s_max =")
    for value, code in ((0, ABORT_TOO_LOW), (2**31 - 1, ABORT_TOO_HIGH)):
        with pytest.raises(SdoAbortedError) as refusal:
            brake.sdo.download(0x2100, 1, value.to_bytes(4, "little"))
        assert refusal.value.code == code
    on_time.raw = before
    for index, code in ((0x1000, ABORT_READ_ONLY), (0x5FFF, ABORT_NO_OBJECT)):
        with pytest.raises(SdoAbortedError) as refusal:
            brake.sdo.download(index, 0, b"\0\0\0\0")
        assert refusal.value.code == code


def test_nothing_is_written_while_the_car_drives(driving: Stack, client: Any) -> None:
    brake = client[NODE_IDS["BrakeServo"]]
    with pytest.raises(SdoAbortedError) as refusal:
        brake.sdo[0x2100][1].raw = 20_000
    assert refusal.value.code == ABORT_STATE
    assert driving.mode is Mode.AUTOMATIC


def test_an_emergency_is_heard(driving: Stack, client: Any) -> None:
    heard: list[Any] = []
    client[NODE_IDS["Steering"]].emcy.add_callback(heard.append)
    driving.break_("steering_motor_fault")
    driving.brakes()
    assert 0xFF00 + ErrorCode.ER4 in [error.code for error in heard]


def test_a_strangers_stop_is_obeyed_into_the_safe_state_and_reported(driving: Stack) -> None:
    since_s = cansend("000#0202")
    driving.brakes()
    driving.event("steering", "obeyed STOP")
    emcy = [line.content for line in driving.log(since_s) if line.can_id == 0x082]
    assert any(isinstance(e, Emcy) and e.er_code is ErrorCode.ER2 for e in emcy)
    driving.event("supervisor", "000#0202")


def test_with_the_supervisor_suspended_another_master_drives_the_nmt_states(
    parked: Stack, client: Any
) -> None:
    parked.kill("supervisor", signal.SIGSTOP)
    pause(0.2)
    steering = client[NODE_IDS["Steering"]]
    for command, state in (("PRE-OPERATIONAL", "PRE-OPERATIONAL"), ("STOPPED", "STOPPED"),
                           ("OPERATIONAL", "OPERATIONAL")):
        steering.nmt.state = command
        pause(0.2)
        steering.nmt.wait_for_heartbeat(1.0)
        assert steering.nmt.state == state
    assert abs(parked.truth().speed_mps) < 0.01
