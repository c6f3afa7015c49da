"""The steering drive and its counts: where the wheel's zero lies in them, and where it may not."""

from __future__ import annotations

import struct

import pytest

from canbus import cia402
from canbus.canopen_protocol import HEARTBEAT_ID, SDO_REQUEST_ID, SDO_RESPONSE_ID, NmtState
from canbus.cia402 import OperationMode
from canbus.frame import Frame, ReceivedFrame
from dbc.messages import ErrorCode, Reason
from ecus.steering.drive import SteeringDrive
from tests.vehicles.drive_car import CAR, STEER

STEP_NS = 10_000_000
START_NS = 1_000_000_000
SWITCH_ON_DISABLED = 0x40
COUNTS_MAX = 2**31 - 1


class Placed:
    """A steering drive that stands somewhere in its counts, set up, its motor off."""

    def __init__(self, position: int) -> None:
        assert CAR.drives is not None
        self.drive = SteeringDrive(CAR, CAR.drives)
        self.position = position
        self.now_ns = 0
        self._answers: list[Frame] = []

    def step(self) -> list[tuple[ErrorCode, Reason]]:
        self.now_ns += STEP_NS
        mode = OperationMode.PROFILE_POSITION
        word = SWITCH_ON_DISABLED
        frames = [
            Frame(cia402.POSITION_ID + STEER, struct.pack("<Hib", word, self.position, mode)),
            Frame(cia402.VELOCITY_ID + STEER, struct.pack("<Hih", word, 0, 0)),
            Frame(HEARTBEAT_ID + STEER, bytes((NmtState.OPERATIONAL,))),
            *self._answers,
        ]
        received = [ReceivedFrame(self.now_ns, frame) for frame in frames]
        causes = self.drive.hear(self.now_ns, received, is_needed=False)
        self.drive.measure(0.0)
        self._answers = [
            Frame(SDO_RESPONSE_ID + STEER, bytes((0x60,)) + frame.data[1:4] + bytes(4))
            for frame in self.drive.frames()
            if frame.can_id == SDO_REQUEST_ID + STEER
        ]
        return [(cause.code, cause.reason) for cause in causes]


@pytest.mark.parametrize("position", [COUNTS_MAX - 5000, 5000 - COUNTS_MAX])
def test_a_position_at_the_end_of_its_range_is_no_exception(position: int) -> None:
    placed = Placed(position)
    for _ in range(START_NS // STEP_NS):
        assert placed.step() == []
    assert placed.drive.client.is_ready and not placed.drive.is_ready
    for angle_rad in (-1.0, 1.0):
        placed.drive.turn_to(angle_rad)
        assert placed.drive.frames()
    placed.step()
    assert placed.step() == [(ErrorCode.ER2, Reason.NODE_SILENT)]


def test_a_position_within_its_range_is_used() -> None:
    placed = Placed(COUNTS_MAX - 50_000)
    for _ in range(2 * START_NS // STEP_NS):
        assert placed.step() == []
    assert placed.drive.is_ready
