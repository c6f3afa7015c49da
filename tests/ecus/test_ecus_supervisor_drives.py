"""The supervisor and the motor drives: it starts them, it alone, and knows their identifiers."""

from __future__ import annotations

import pytest

from canbus.canopen_protocol import NMT_ID, NmtState
from canbus.cia402 import identifiers
from canbus.frame import Frame, FrameKind
from dbc.messages import Inhibit, Mode
from tests.ecus.supervisor_fakes import Street
from tests.vehicles.drive_car import CAR, LEFT, RIGHT, STEER

IDS = sorted(identifiers(CAR.drive_node_ids))
START = {node_id: bytes((1, node_id)) for node_id in CAR.drive_node_ids}


def beat(street: Street, node_id: int, state: int) -> None:
    street.extra.append(Frame(0x700 + node_id, bytes((state,))))


def starts(street: Street, span_ms: int) -> list[bytes]:
    """NMT commands to drives within a span."""
    street.sent.clear()
    street.steps(span_ms // 10)
    return [f.data for f in street.sent if f.can_id == NMT_ID and f.data in START.values()]


def test_a_drive_that_is_heard_is_started_and_again_until_it_is_operational() -> None:
    street = Street(CAR)
    assert starts(street, 300) == []
    beat(street, STEER, NmtState.INITIALISING)
    assert starts(street, 10) == [START[STEER]]
    beat(street, STEER, NmtState.PRE_OPERATIONAL)
    assert starts(street, 180) == []
    assert starts(street, 30) == [START[STEER]]
    beat(street, STEER, NmtState.OPERATIONAL)
    assert starts(street, 500) == []


def test_a_drive_that_restarts_in_manual_is_started_anew() -> None:
    street = Street(CAR)
    for node_id in (LEFT, RIGHT):
        beat(street, node_id, NmtState.OPERATIONAL)
    assert starts(street, 500) == []
    beat(street, RIGHT, NmtState.INITIALISING)
    assert starts(street, 20) == [START[RIGHT]]


def test_no_drive_is_started_while_the_car_drives_itself() -> None:
    street = Street(CAR).automatic()
    beat(street, LEFT, NmtState.INITIALISING)
    assert starts(street, 500) == []
    assert street.mode is Mode.AUTOMATIC


def test_a_malformed_heartbeat_of_a_drive_starts_nothing() -> None:
    street = Street(CAR)
    street.extra.append(Frame(0x700 + LEFT, b"\x7f\x00"))
    street.extra.append(Frame(0x700 + LEFT, b"\x7f", FrameKind.REMOTE))
    assert starts(street, 300) == []


@pytest.mark.parametrize("can_id", IDS, ids=hex)
def test_an_identifier_of_a_drive_is_a_strangers_only_where_there_is_none(can_id: int) -> None:
    for vehicle, expected in ((CAR, Inhibit.NOT_REQUESTED), (None, Inhibit.FOREIGN_FRAME)):
        street = Street(vehicle).ready()
        street.extra.append(Frame(can_id, bytes(8)))
        street.steps(2)
        assert street.shown.inhibit is expected


def test_a_frame_of_another_kind_is_a_strangers_even_so() -> None:
    street = Street(CAR).ready()
    street.extra.append(Frame(IDS[0], b"", FrameKind.REMOTE))
    street.steps(2)
    assert street.shown.inhibit is Inhibit.FOREIGN_FRAME

