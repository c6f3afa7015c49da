"""The client that never waits, against the simulated drive: it stops rather than guesses."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canbus import cia402
from canbus.canopen_protocol import HEARTBEAT_ID, NmtCommand, NmtState, nmt_frame
from canbus.cia402 import OperationMode
from canbus.cia402_power import STATE_AFTER, PowerState, command_of
from canbus.drive_client import (
    CONTROLWORD,
    QUIET_NS,
    RESET_NS,
    SILENCE_NS,
    DriveClient,
    DriveTrouble,
    DriveWish,
    Setting,
)
from canbus.frame import Frame, FrameKind, ReceivedFrame
from simulation.drives.faults import DriveFault
from tests.simulation.drive_rig import MASTER_ID, MS, NODE_ID, QUICK_STOP, Rig

POSITION, VELOCITY = OperationMode.PROFILE_POSITION, OperationMode.PROFILE_VELOCITY
FOLLOW, STOP, RELEASE = DriveWish.FOLLOW, DriveWish.STOP, DriveWish.RELEASE


class Axis(Rig):
    """A drive, a node that steps a client every 10 ms, and the NMT master with its heartbeat."""

    def __init__(self, mode: OperationMode, *settings: Setting) -> None:
        super().__init__()
        self.client = DriveClient(NODE_ID, MASTER_ID, mode, settings)
        self.wish = RELEASE
        self.target: Callable[[float], int] = lambda _: 0
        self.is_cut = False
        self.is_master_alive = True
        self.commands: list[Frame] = []
        self._inbox: list[ReceivedFrame] = []
        self._taken = 0

    def follow(self, duration_ms: int, wish: DriveWish, target: int = 0) -> None:
        self.wish, self.target = wish, lambda _: target
        self.live(duration_ms)

    def live(self, duration_ms: int) -> None:
        for _ in range(duration_ms):
            self.run(1)
            if not self.is_cut:
                new = self.seen[self._taken :]
                self._inbox += [ReceivedFrame(now_ns, frame) for now_ns, frame in new]
            self._taken = len(self.seen)
            if self.now_ns % (10 * MS) == 0 and self.is_master_alive:
                received, self._inbox = self._inbox, []
                target = self.target(self.now_ns / 1e9)
                self.commands = self.client.step(self.now_ns, received, self.wish, target)
                self.send(*self.commands)
            if self.now_ns % (50 * MS) == 0 and self.is_master_alive:
                self.send(self.heartbeat())

    def begin(self) -> None:
        self.live(60)  # the first heartbeat, then the settings, one answer a step
        self.live(60)
        self.send(nmt_frame(NmtCommand.START, 0))
        self.live(40)
        assert self.client.is_ready


def turning(speed_rpm: int = 800) -> Axis:
    axis = Axis(VELOCITY)
    axis.begin()
    axis.follow(600, FOLLOW, speed_rpm)
    assert axis.client.is_following
    assert axis.client.velocity_rpm == pytest.approx(speed_rpm, abs=10)
    return axis


@pytest.mark.parametrize("wish", DriveWish)
@pytest.mark.parametrize("state", PowerState)
def test_every_command_leads_where_the_wish_wants(wish: DriveWish, state: PowerState) -> None:
    command = command_of(CONTROLWORD[wish][state], 0)
    assert command is not None
    after = STATE_AFTER[state][command]
    moving = {PowerState.OPERATION_ENABLED}
    if wish is FOLLOW:
        assert after is not state or state in moving | {
            PowerState.NOT_READY_TO_SWITCH_ON,
            PowerState.FAULT,
            PowerState.FAULT_REACTION_ACTIVE,
        }
    else:
        assert after not in moving
        assert wish is STOP or after not in (PowerState.SWITCHED_ON, PowerState.QUICK_STOP_ACTIVE)


def test_nothing_is_commanded_before_the_drive_was_heard_and_set_up() -> None:
    axis = Axis(VELOCITY)
    axis.wish = FOLLOW
    axis.live(200)
    assert not axis.client.is_ready
    assert axis.commands == []
    assert axis.drive.state is PowerState.SWITCH_ON_DISABLED
    assert axis.read(0x101601, 4) == MASTER_ID << 16 | 150
    assert axis.drive.values[cia402.MODE_DISPLAY] == VELOCITY


def test_a_ready_drive_is_switched_on_and_follows_within_60_ms() -> None:
    axis = Axis(VELOCITY)
    axis.begin()
    assert axis.drive.state is PowerState.SWITCH_ON_DISABLED
    axis.follow(60, FOLLOW, 800)
    assert axis.client.is_following
    axis.follow(500, FOLLOW, 800)
    assert axis.client.velocity_rpm == pytest.approx(800, abs=10)


def test_positions_that_move_every_step_are_followed() -> None:
    axis = Axis(POSITION, Setting(key=cia402.PROFILE_VELOCITY, value=3000, byte_count=4))
    axis.begin()
    axis.follow(100, FOLLOW, 0)
    start_s = axis.now_ns / 1e9
    axis.target = lambda now_s: round(4000 * math.sin(2.0 * (now_s - start_s)))
    worst = 0
    for _ in range(300):
        axis.live(10)
        worst = max(worst, abs(axis.client.position - axis.target(axis.now_ns / 1e9)))
    assert worst < 400  # 8000 units/s and 40 ms
    axis.follow(1000, FOLLOW, -2500)
    assert axis.client.position == pytest.approx(-2500, abs=1)


@pytest.mark.parametrize("mode", [POSITION, VELOCITY])
def test_switching_on_moves_nothing_by_itself(mode: OperationMode) -> None:
    axis = Axis(mode)
    axis.begin()
    axis.motor.angle_rad = 2.0
    axis.live(50)
    before = axis.client.position
    axis.wish = FOLLOW
    axis.target = lambda _: before if mode is POSITION else 0
    axis.live(500)
    assert axis.client.is_following
    assert axis.motor.angle_rad == pytest.approx(2.0, abs=0.005)


def test_release_takes_the_current_off_and_stop_brakes() -> None:
    axis = turning()
    axis.follow(20, RELEASE, 800)
    assert axis.motor.current_a == 0.0
    assert axis.drive.state is PowerState.SWITCH_ON_DISABLED
    axis = turning()
    axis.follow(300, STOP, 800)
    assert axis.drive.state is PowerState.QUICK_STOP_ACTIVE
    assert axis.client.velocity_rpm == 0
    axis.follow(500, FOLLOW, 800)
    assert axis.client.velocity_rpm == pytest.approx(800, abs=10)


# Trouble


@pytest.mark.parametrize("fault", [kind for kind in DriveFault if kind is not DriveFault.HEARTBEAT])
def test_a_fault_is_trouble_within_30_ms_and_is_never_reset_unasked(fault: DriveFault) -> None:
    axis = turning()
    axis.drive.fail(fault)
    axis.live(30)
    assert axis.client.trouble is DriveTrouble.FAULT
    assert axis.client.error_code == fault.value.error_code
    assert not axis.client.is_ready
    axis.drive.mend(fault)
    axis.live(1000)
    assert axis.drive.state is PowerState.FAULT
    axis.client.reset(axis.now_ns)
    axis.live(600)
    assert axis.client.trouble is None
    assert axis.client.velocity_rpm == pytest.approx(800, abs=10)


def test_a_reset_with_the_cause_there_brings_the_trouble_back() -> None:
    axis = turning()
    axis.drive.fail(DriveFault.OVERTEMPERATURE)
    axis.live(500)
    axis.client.reset(axis.now_ns)
    axis.live(RESET_NS // MS + 20)
    assert axis.client.trouble is DriveTrouble.FAULT
    axis.drive.mend(DriveFault.OVERTEMPERATURE)
    axis.live(500)
    assert axis.drive.state is PowerState.FAULT


def test_a_reset_that_nothing_needed_resets_no_later_fault() -> None:
    axis = turning()
    axis.client.reset(axis.now_ns)
    axis.live(RESET_NS // MS + 20)
    axis.drive.fail(DriveFault.OVERTEMPERATURE)
    axis.live(1)
    axis.drive.mend(DriveFault.OVERTEMPERATURE)
    axis.live(800)
    assert axis.drive.state is PowerState.FAULT


def test_an_emergency_alone_is_a_fault() -> None:
    axis = turning()
    axis._inbox.append(
        ReceivedFrame(axis.now_ns, Frame(0x80 + NODE_ID, bytes.fromhex("1042090000000000")))
    )
    axis.live(10)
    assert axis.client.trouble is DriveTrouble.FAULT
    assert axis.client.error_code == 0x4210
    axis.live(300)
    assert axis.drive.state is PowerState.QUICK_STOP_ACTIVE


def test_a_silent_drive_is_trouble_after_60_ms_and_is_told_to_stop_all_the_same() -> None:
    axis = turning()
    axis.is_cut = True
    axis.live(SILENCE_NS // MS - 20)
    assert axis.client.trouble is None
    axis.live(40)
    assert axis.client.trouble is DriveTrouble.SILENT
    assert [frame.data[0] for frame in axis.commands] == [QUICK_STOP]
    axis.live(300)
    assert axis.drive.state is PowerState.QUICK_STOP_ACTIVE
    axis.is_cut = False
    axis.live(100)
    assert axis.client.trouble is DriveTrouble.SILENT, "it stays until somebody resets"


def test_a_node_that_dies_is_noticed_by_the_drive_itself() -> None:
    axis = turning()
    axis.is_master_alive = False
    axis.live(500)
    assert axis.drive.state is PowerState.FAULT
    assert abs(axis.motor.speed_radps) < 1.0


def test_a_drive_that_restarts_is_trouble_and_is_set_up_anew() -> None:
    axis = turning()
    axis.send(nmt_frame(NmtCommand.RESET_NODE, NODE_ID))
    axis.live(200)
    assert axis.client.trouble is DriveTrouble.RESTARTED
    assert axis.motor.current_a == 0.0
    assert axis.drive.values[cia402.MODE_DISPLAY] == VELOCITY
    axis.send(nmt_frame(NmtCommand.START, 0))
    axis.live(300)
    assert axis.drive.state is PowerState.SWITCH_ON_DISABLED
    axis.client.reset(axis.now_ns)
    axis.live(600)
    assert axis.client.velocity_rpm == pytest.approx(800, abs=10)


@pytest.mark.parametrize("is_started_at_once", [True, False])
def test_a_drive_whose_boot_up_was_lost_is_set_up_again(is_started_at_once: bool) -> None:
    axis = Axis(VELOCITY)
    axis.begin()
    axis.is_cut = True
    axis.send(nmt_frame(NmtCommand.RESET_NODE, NODE_ID))
    axis.live(10)
    axis.is_cut = False
    if not is_started_at_once:
        axis.live(150)
        assert axis.read(0x101601, 4) == MASTER_ID << 16 | 150
    axis.send(nmt_frame(NmtCommand.START, 0))
    axis.live(500)
    axis.client.reset(axis.now_ns)
    axis.live(10)
    assert axis.client.is_ready
    assert axis.read(0x101601, 4) == MASTER_ID << 16 | 150


def test_a_heartbeat_that_comes_behind_the_first_pdo_is_no_restart() -> None:
    axis = turning()
    before_start = Frame(HEARTBEAT_ID + NODE_ID, bytes([NmtState.PRE_OPERATIONAL]))
    axis.client.hear(axis.now_ns, [ReceivedFrame(axis.now_ns, before_start)])
    assert axis.client.trouble is None and axis.client.is_ready
    axis.client.hear(axis.now_ns, [ReceivedFrame(axis.now_ns + QUIET_NS, before_start)])
    assert axis.client.trouble is DriveTrouble.RESTARTED


def test_a_setting_that_the_drive_refuses_keeps_it_out_of_use() -> None:
    axis = Axis(VELOCITY, Setting(key=cia402.PROFILE_ACCELERATION, value=0, byte_count=4))
    axis.live(120)
    axis.send(nmt_frame(NmtCommand.START, 0))
    axis.follow(300, FOLLOW, 800)
    assert axis.client.trouble is DriveTrouble.REFUSED
    assert axis.drive.state is PowerState.SWITCH_ON_DISABLED


def test_a_mode_that_somebody_else_changed_is_not_followed() -> None:
    axis = turning()
    axis.write(cia402.MODE, POSITION, 1)
    axis.live(300)
    assert not axis.client.is_ready
    assert axis.drive.state is PowerState.QUICK_STOP_ACTIVE


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    frames=st.lists(
        st.builds(
            Frame,
            st.sampled_from([0x091, 0x191, 0x291, 0x591, 0x711]),
            st.binary(max_size=8) | st.binary(min_size=7, max_size=8),
            st.sampled_from([FrameKind.DATA] * 5 + [FrameKind.REMOTE, FrameKind.EXTENDED]),
        ),
        max_size=20,
    )
)
def test_no_frames_raise_and_none_make_an_unready_drive_run(frames: list[Frame]) -> None:
    client = DriveClient(NODE_ID, MASTER_ID, VELOCITY)
    for number, frame in enumerate(frames):
        sent = client.step(number * 10 * MS, [ReceivedFrame(0, frame)], FOLLOW, 500)
        for command in sent:
            if command.can_id == 0x311 and not client.is_ready:
                assert command.data[:6] in (bytes((QUICK_STOP, 0, 0, 0, 0, 0)), bytes(6))


@pytest.mark.parametrize("data", [b"", bytes(6), bytes(8)], ids=["0", "6", "8"])
def test_a_pdo_of_wrong_length_is_counted_and_not_believed(data: bytes) -> None:
    axis = turning()
    before = axis.client.position
    axis._inbox = [ReceivedFrame(axis.now_ns, Frame(0x180 + NODE_ID, data))]
    axis.client.step(axis.now_ns, axis._inbox, FOLLOW, 800)
    assert axis.client.bad_frames == 1
    assert axis.client.position == before


@pytest.mark.parametrize(
    ("node_id", "mode", "message"),
    [
        (NODE_ID, OperationMode.HOMING, "HOMING: a drive follows"),
        (6, VELOCITY, "drive 6: allowed 17 to 127"),
        (128, VELOCITY, "drive 128"),
    ],
)
def test_wrong_configuration_of_a_client_is_refused(
    node_id: int, mode: OperationMode, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        DriveClient(node_id, MASTER_ID, mode)
