"""Steer, throttle and brake ECU: bad frames (ER0) and strangers move nothing."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canbus.frame import Frame, FrameKind
from canbus.node import EventKind
from dbc.endpoint import SPEC_OF_NAME, Endpoint
from dbc.messages import ErrorCode, NodeState, Reason
from dbc.protection import protect
from tests.ecus.actuator_causes import (
    NAMES,
    SETPOINT,
)
from tests.ecus.ecus_fakes import (
    Rig,
    flags,
)

# Bad frames (ER0) ----------------------------------------------------------------------------


def _corrupt(frame: Frame) -> Frame:
    return Frame(frame.can_id, frame.data[:-1] + bytes([frame.data[-1] ^ 0x10]))


def _value_out_of_range(rig: Rig) -> list[Frame]:
    spec = SPEC_OF_NAME[f"{rig.prefix}_COMMAND"]
    payload = (0x7FFF if rig.name != "BrakeServo" else 0xFFFE) << 32
    data = bytearray(payload.to_bytes(8, "little"))
    counter = rig.peers["Gateway"]._sent[spec.name].counter
    assert spec.data_id is not None
    return [Frame(spec.can_id, protect(data, spec.data_id, counter))]


BAD_COMMANDS: dict[str, Callable[[Rig], list[Frame]]] = {
    "length": lambda rig: [
        Frame(f.can_id, f.data[:7]) for f in [rig.command_frame(0.0, 0.0)]
    ],
    "remote": lambda rig: [Frame(rig.command_frame(0.0, 0.0).can_id, b"", FrameKind.REMOTE)],
    "fd": lambda rig: [
        Frame(f.can_id, f.data, FrameKind.FD) for f in [rig.command_frame(0.0, 0.0)]
    ],
    "crc": lambda rig: [_corrupt(rig.command_frame(0.0, 0.0))],
    "value": _value_out_of_range,
    "repeat": lambda rig: [rig.command_frame(SETPOINT[rig.name], 0.0)] * 2,
    "jump": lambda rig: [rig.command_frame(0.0, 0.0) for _ in range(4)][-1:],
}
FAULT_NAME = {
    "length": "length", "remote": "kind", "fd": "kind", "crc": "crc", "value": "value",
    "repeat": "repeated", "jump": "sequence",
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", BAD_COMMANDS)
def test_bad_frame_is_ignored_counted_reported_and_moves_nothing(name: str, kind: str) -> None:
    rig = Rig(name).drive(SETPOINT[name])
    rig.steps(2)
    before = dict(rig.node.endpoint.counts)
    believed = rig.node.endpoint.newest(f"{rig.prefix}_COMMAND").content
    rig.age_ms = None
    rig.extra = BAD_COMMANDS[kind](rig)
    rig.step()
    fault = FAULT_NAME[kind]
    counted = {f.name.lower(): n - before[f] for f, n in rig.node.endpoint.counts.items()}
    assert counted == {**dict.fromkeys(counted, 0), fault: 1}
    assert [t for t in rig.logged(EventKind.FRAME) if t.endswith(f": {fault}")]
    assert rig.logged(EventKind.CODE) == ["ER0 BAD_FRAME"]
    assert flags(rig.now_sent("DRIVER")[0]) == {0}
    (emcy,) = rig.all_sent("EMCY")
    assert (emcy.er_code, emcy.reason, emcy.er_bits) == (ErrorCode.ER0, Reason.BAD_FRAME, 1)
    assert emcy.error_code == 0xFF00
    assert rig.state is NodeState.ACTIVE and not rig.all_sent("EMERGENCY_BRAKE")
    assert rig.node.endpoint.newest(f"{rig.prefix}_COMMAND").content == believed


@pytest.mark.parametrize("name", NAMES)
def test_bad_frame_report_ends_after_a_second_and_never_latches(name: str) -> None:
    rig = Rig(name).drive()
    rig.extra.append(Frame(SPEC_OF_NAME["SUPERVISOR_STATE"].can_id, bytes(3)))
    rig.steps(100)
    assert flags(rig.all_sent("DRIVER")[-1]) == {0}
    rig.steps(4)
    assert flags(rig.all_sent("DRIVER")[-1]) == set()
    assert rig.state is NodeState.ACTIVE


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "frame", [Frame(0x000, b"\x02"), Frame(0x000, b"\x07\x00"), Frame(0x000, b"", FrameKind.REMOTE)]
)
def test_malformed_nmt_frame_is_reported_and_moves_nothing(name: str, frame: Frame) -> None:
    rig = Rig(name).drive()
    rig.extra.append(frame)
    rig.step()
    assert rig.state is NodeState.ACTIVE
    assert rig.logged(EventKind.CODE) == ["ER0 BAD_FRAME"]
    assert rig.node.shell.canopen.bad_frames == 1


@pytest.mark.parametrize("name", NAMES)
def test_every_single_lost_frame_is_tolerated(name: str) -> None:
    rig = Rig(name).drive(SETPOINT[name])
    for drop in range(8):
        rig.step(frames=rig._peer_frames()[drop % 4 + 1 :] if drop % 2 else [])
        rig.steps(3)
    assert rig.state is NodeState.ACTIVE and not rig.events


# Strangers -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_29_bit_frame_with_our_number_is_reported_and_moves_nothing(name: str) -> None:
    rig = Rig(name).drive()
    own = SPEC_OF_NAME[f"{rig.prefix}_STATUS"].can_id
    rig.extra.append(Frame(own, bytes(8), FrameKind.EXTENDED))
    rig.extra.append(Frame(SPEC_OF_NAME["SUPERVISOR_STATE"].can_id, bytes(8), FrameKind.EXTENDED))
    rig.step()
    assert rig.state is NodeState.ACTIVE and not rig.logged(EventKind.CODE)
    assert len(rig.logged(EventKind.FOREIGN)) == 2


@pytest.mark.parametrize("name", NAMES)
def test_stranger_with_an_unprotected_identifier_of_ours_is_reported_only(name: str) -> None:
    rig = Rig(name).drive()
    rig.extra.append(Frame(SPEC_OF_NAME[f"{rig.prefix}_HEARTBEAT"].can_id, b"\x05"))
    rig.step()
    assert rig.state is NodeState.ACTIVE and not rig.logged(EventKind.CODE)
    assert len(rig.logged(EventKind.FOREIGN)) == 1


@pytest.mark.parametrize("name", NAMES)
def test_frame_with_our_identifier_that_nobody_would_believe_is_reported_only(name: str) -> None:
    rig = Rig(name).drive()
    rig.extra.append(
        _corrupt(Endpoint(name, ()).frame(f"{rig.prefix}_STATUS", rig.node._status()))
    )
    rig.step()
    assert rig.state is NodeState.ACTIVE and not rig.logged(EventKind.CODE)
    assert len(rig.logged(EventKind.FOREIGN)) == 1


@pytest.mark.parametrize("name", NAMES)
def test_every_identifier_of_ours_is_let_through_to_notice_strangers(name: str) -> None:
    rig = Rig(name)
    own = {spec.can_id for spec in SPEC_OF_NAME.values() if spec.sender == name}
    assert own <= rig.node.acceptance
    assert SPEC_OF_NAME["FAILSAFE"].can_id in rig.node.acceptance and 0x000 in rig.node.acceptance
