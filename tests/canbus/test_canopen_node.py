"""A node's CANopen side in virtual time, against frames by hand and a real canopen client."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import canopen
import pytest
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError
from hypothesis import given, settings
from hypothesis import strategies as st

from canbus.canopen_device import DOWNLOAD_BYTES_MAX
from canbus.canopen_node import (
    CanopenEvent,
    CanopenEventKind,
    CanopenNode,
    NmtCommand,
    NmtState,
    nmt_frame,
)
from canbus.canopen_schedule import EMCY_QUEUE_MAX
from canbus.frame import Frame, FrameKind

MS = 1_000_000
NODE_ID = 2
EDS = str(files("dbc").joinpath("eds", "steering.eds"))
VALUES = {
    "position_gain_per_s": 12.5,
    "rate_gain": 1.0,
    "integral_gain_per_s2": 2.0,
    "wheel_rate_radps_max": 8.727,
    "wheel_angle_rad_max": 9.25,
    "driver_torque_nm_max": 3.0,
    "command_timeout_s": 0.06,
}
TIMEOUT = 0x2100, 7
BOOT_UP = Frame(0x702, b"\x00")
PRE_OPERATIONAL = Frame(0x702, b"\x7f")


def make(
    *,
    parameters: dict[str, float] | None = None,
    eds: str | Path = EDS,
    heartbeat_period_ns: int = 50 * MS,
    emcy_inhibit_ns: int = 50 * MS,
) -> CanopenNode:
    return CanopenNode(
        NODE_ID,
        eds,
        dbc_hash=0xDEADBEEF,
        vehicle_hash=0x12345678,
        parameters=VALUES if parameters is None else parameters,
        heartbeat_period_ns=heartbeat_period_ns,
        emcy_inhibit_ns=emcy_inhibit_ns,
    )


def booted(*, heartbeat_period_ns: int = 50 * MS, emcy_inhibit_ns: int = 50 * MS) -> CanopenNode:
    node = make(heartbeat_period_ns=heartbeat_period_ns, emcy_inhibit_ns=emcy_inhibit_ns)
    assert node.step(0) == [BOOT_UP]
    return node


def request(text: str) -> Frame:
    return Frame(0x600 + NODE_ID, bytes.fromhex(text))


def answer(node: CanopenNode, text: str, now_ns: int = 1) -> str:
    """The answer to one SDO request, as hex."""
    (frame,) = node.step(now_ns, [request(text)])
    assert frame.can_id == 0x580 + NODE_ID
    return frame.data.hex(" ")


def abort_code(node: CanopenNode, text: str) -> int:
    reply = bytes.fromhex(answer(node, text))
    assert reply[0] == 0x80
    return int.from_bytes(reply[4:], "little")


class Client:
    """A real canopen client whose waiting steps the node in virtual time."""

    def __init__(self, node: CanopenNode) -> None:
        self.node = node
        self.now_ns = 0
        self.to_node: list[Frame] = []
        self.seen: list[Frame] = []
        client = self

        class Network(canopen.Network):
            def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
                client.to_node.append(Frame(can_id, bytes(data)))

        class Responses:
            def __init__(self) -> None:
                self.items: list[bytes] = []

            def put(self, item: bytes) -> None:
                self.items.append(item)

            def empty(self) -> bool:
                self.items.clear()
                return True

            def get(self, block: bool, timeout: float) -> bytes:
                deadline_ns = client.now_ns + round(timeout * 1e9)
                while not self.items and client.now_ns < deadline_ns:
                    client.run(10 * MS)
                if not self.items:
                    raise queue.Empty
                return self.items.pop(0)

        self.network = Network()
        self.remote = self.network.add_node(NODE_ID, EDS)
        self.remote.sdo.responses = Responses()

    def run(self, duration_ns: int) -> None:
        """Step the node every 10 ms and hand its frames to the client."""
        for _ in range(duration_ns // (10 * MS)):
            self.now_ns += 10 * MS
            received, self.to_node = self.to_node, []
            for frame in self.node.step(self.now_ns, received):
                self.seen.append(frame)
                self.network.notify(frame.can_id, bytearray(frame.data), self.now_ns / 1e9)


@pytest.fixture
def client() -> Client:
    client = Client(make())
    client.run(10 * MS)
    return client


# Boot-up, heartbeat and NMT


def test_first_step_announces_the_node_once_and_goes_pre_operational() -> None:
    assert make().state is NmtState.INITIALISING
    node = make()
    assert node.step(7) == [BOOT_UP]
    assert node.state is NmtState.PRE_OPERATIONAL
    assert node.step(8) == []


def test_no_thread_is_started() -> None:
    before = threading.active_count()
    node = booted()
    for step in range(20):
        node.step(step * 10 * MS, [nmt_frame(NmtCommand.START, 0)])
    assert threading.active_count() == before


def test_heartbeat_comes_every_50_ms_exactly() -> None:
    node = booted()
    times = [now for now in range(1, 1001) if node.step(now * MS) == [PRE_OPERATIONAL]]
    assert times == list(range(50, 1001, 50))


def test_late_steps_shift_no_later_heartbeat_and_make_up_for_none() -> None:
    node = booted()
    assert node.step(57 * MS) == [PRE_OPERATIONAL]
    assert node.step(99 * MS) == []
    assert node.step(100 * MS) == [PRE_OPERATIONAL]
    assert node.step(490 * MS) == [PRE_OPERATIONAL]
    assert node.step(499 * MS) == []
    assert node.step(500 * MS) == [PRE_OPERATIONAL]


@pytest.mark.parametrize(
    ("command", "state"),
    [
        (NmtCommand.START, NmtState.OPERATIONAL),
        (NmtCommand.STOP, NmtState.STOPPED),
        (NmtCommand.ENTER_PRE_OPERATIONAL, NmtState.PRE_OPERATIONAL),
    ],
)
@pytest.mark.parametrize("before", [NmtCommand.START, NmtCommand.STOP])
@pytest.mark.parametrize("target", [0, NODE_ID])
def test_nmt_commands_are_obeyed_reported_and_seen_in_the_heartbeat(
    command: NmtCommand, state: NmtState, before: NmtCommand, target: int
) -> None:
    node = booted()
    node.step(1, [nmt_frame(before, NODE_ID)])
    node.poll_events()
    assert node.step(2, [nmt_frame(command, target)]) == []
    assert node.state is state
    assert node.poll_events() == [CanopenEvent(kind=CanopenEventKind.NMT_COMMAND, command=command)]
    assert node.poll_events() == []
    assert node.step(50 * MS) == [Frame(0x702, bytes([state]))]


def test_nmt_command_for_another_node_is_ignored() -> None:
    node = booted()
    for command in NmtCommand:
        assert node.step(1, [nmt_frame(command, NODE_ID + 1)]) == []
    assert node.state is NmtState.PRE_OPERATIONAL
    assert node.poll_events() == []
    assert node.bad_frames == 0


@pytest.mark.parametrize("command", [NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION])
def test_nmt_reset_announces_the_node_once_and_tells_the_owner_once(command: NmtCommand) -> None:
    node = booted()
    node.step(1, [nmt_frame(NmtCommand.START, 0)])
    node.poll_events()
    assert node.step(12 * MS, [nmt_frame(command, NODE_ID)]) == [BOOT_UP]
    assert node.state is NmtState.PRE_OPERATIONAL
    assert node.poll_events() == [CanopenEvent(kind=CanopenEventKind.RESET_NODE, command=command)]
    times = [now for now in range(13, 300) if node.step(now * MS) == [PRE_OPERATIONAL]]
    assert times == [62, 112, 162, 212, 262]


def test_reset_of_a_stopped_node_makes_it_answer_again() -> None:
    node = booted()
    node.step(1, [nmt_frame(NmtCommand.STOP, 0)])
    node.step(2, [nmt_frame(NmtCommand.RESET_NODE, 0)])
    assert answer(node, "40 00 10 00 00 00 00 00") == "43 00 10 00 00 00 00 00"


def test_node_reset_brings_parameters_back_and_communication_reset_does_not() -> None:
    node = booted()
    node.writable = True
    assert answer(node, "23 00 21 07 f4 01 00 00") == "60 00 21 07 00 00 00 00"
    assert answer(node, "2b 17 10 00 0a 00 00 00") == "60 17 10 00 00 00 00 00"
    node.step(2 * MS, [nmt_frame(NmtCommand.RESET_COMMUNICATION, 0)])
    assert node.parameters["command_timeout_s"] == 0.5
    assert answer(node, "40 17 10 00 00 00 00 00") == "4b 17 10 00 32 00 00 00"
    node.step(3 * MS, [nmt_frame(NmtCommand.RESET_NODE, 0)])
    assert dict(node.parameters) == VALUES
    assert answer(node, "40 00 21 07 00 00 00 00") == "43 00 21 07 3c 00 00 00"
    assert answer(node, "40 00 20 01 00 00 00 00") == "43 00 20 01 ef be ad de"


# Bad frames


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x000, b""),
        Frame(0x000, b"\x01"),
        Frame(0x000, b"\x01\x02\x00"),
        Frame(0x000, b"\x63\x02"),
        Frame(0x000, b"\x50\x02"),
        Frame(0x000, b"\x01\x02", FrameKind.EXTENDED),
        Frame(0x000, b"", FrameKind.REMOTE),
        Frame(0x602, b""),
        Frame(0x602, b"\x40\x00\x10"),
        Frame(0x602, bytes(7)),
        Frame(0x602, b"\x40\x00\x10\x00\x00\x00\x00\x00", FrameKind.FD),
        Frame(0x602, b"\x40\x00\x10\x00\x00\x00\x00\x00", FrameKind.EXTENDED),
    ],
    ids=str,
)
def test_bad_frames_are_counted_and_change_nothing(frame: Frame) -> None:
    node = booted()
    assert node.step(1, [frame]) == []
    assert node.bad_frames == 1
    assert node.state is NmtState.PRE_OPERATIONAL
    assert node.poll_events() == []


def test_other_identifiers_are_ignored() -> None:
    node = booted()
    others = [can_id for can_id in range(0x800) if can_id not in node.acceptance]
    assert len(others) == 0x800 - 2
    assert node.step(1, [Frame(can_id, b"\x01\x02") for can_id in others]) == []
    assert node.bad_frames == 0
    assert node.state is NmtState.PRE_OPERATIONAL


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    frames=st.lists(
        st.builds(
            Frame,
            st.sampled_from([0x000, *[0x602] * 5]),
            st.binary(max_size=8) | st.binary(min_size=8, max_size=8),
        ),
        max_size=12,
    ),
    writable=st.booleans(),
)
def test_no_sequence_of_frames_raises_or_starts_the_node_unasked(
    frames: list[Frame], writable: bool
) -> None:
    node = booted()
    node.step(0, [nmt_frame(NmtCommand.START, 0)])
    node.poll_events()
    node.writable = writable
    before = dict(node.parameters)
    sent = node.step(0, frames)
    assert {frame.can_id for frame in sent} <= {0x582, 0x702}
    assert all(len(frame.data) == (8 if frame.can_id == 0x582 else 1) for frame in sent)
    for event in node.poll_events():
        writes = event.kind is CanopenEventKind.PARAMETER_WRITTEN
        assert writable or not writes
    resets = any(f.data[:1] == b"\x81" and f.can_id == 0 for f in frames)
    assert writable or resets or dict(node.parameters) == before


@pytest.mark.parametrize(
    ("first", "code"),
    [
        ("60 00 00 00 00 00 00 00", 0x05040001),  # a segment to read, of nothing
        ("00 00 00 00 00 00 00 00", 0x05040001),  # a segment to write, of nothing
        ("c2 00 10 00 00 00 00 00", 0x05040001),  # block download
        ("a3 00 00 00 00 00 00 00", 0x05040001),  # block upload, start without initiate
        ("e0 00 00 00 00 00 00 00", 0x05040001),  # no such command
    ],
)
def test_stray_first_requests_are_aborted_and_do_not_raise(first: str, code: int) -> None:
    node = booted()
    assert abort_code(node, first) == code
    assert answer(node, "40 00 10 00 00 00 00 00") == "43 00 10 00 00 00 00 00"


def test_an_abort_by_the_client_ends_the_transfer_without_an_answer() -> None:
    node = booted()
    answer(node, "40 08 10 00 00 00 00 00")
    assert node.step(2, [request("80 08 10 00 00 00 04 05")]) == []
    assert abort_code(node, "60 00 00 00 00 00 00 00") == 0x05040001


# SDO by hand


def test_string_is_read_in_segments() -> None:
    node = booted()
    assert answer(node, "40 08 10 00 00 00 00 00") == "41 08 10 00 0c 00 00 00"
    assert answer(node, "60 00 00 00 00 00 00 00") == "00 " + b"Steerin".hex(" ")
    assert answer(node, "70 00 00 00 00 00 00 00") == "15 " + b"g ECU\0\0".hex(" ")
    assert abort_code(node, "60 00 00 00 00 00 00 00") == 0x05040001


def test_wrong_toggle_bit_ends_the_transfer() -> None:
    node = booted()
    answer(node, "40 08 10 00 00 00 00 00")
    assert abort_code(node, "70 00 00 00 00 00 00 00") == 0x05030000
    assert abort_code(node, "60 00 00 00 00 00 00 00") == 0x05040001


def test_block_upload_is_answered_by_a_normal_one() -> None:
    node = booted()
    assert answer(node, "a0 00 20 01 10 00 00 00") == "43 00 20 01 ef be ad de"


def test_parameter_may_be_written_in_segments() -> None:
    node = booted()
    node.writable = True
    assert answer(node, "21 00 21 07 04 00 00 00") == "60 00 21 07 00 00 00 00"
    assert answer(node, "07 f4 01 00 00 00 00 00") == "20 00 00 00 00 00 00 00"
    assert node.parameters["command_timeout_s"] == 0.5


@pytest.mark.parametrize("last", ["05 f4 01 00 00 00 00 00", "01 f4 01 00 00 00 00 00"])
def test_segmented_write_of_wrong_length_is_refused(last: str) -> None:
    node = booted()
    node.writable = True
    answer(node, "20 00 21 07 00 00 00 00")
    assert abort_code(node, last) == 0x06070010
    assert node.parameters["command_timeout_s"] == 0.06


def test_endless_segmented_write_is_cut_off() -> None:
    node = booted()
    node.writable = True
    answer(node, "20 00 21 07 00 00 00 00")
    toggles = ["00", "10"] * 20
    replies = [answer(node, f"{toggle} 01 02 03 04 05 06 07") for toggle in toggles]
    aborted = next(number for number, reply in enumerate(replies) if reply.startswith("80"))
    assert aborted * 7 <= DOWNLOAD_BYTES_MAX + 7
    assert replies[aborted].endswith("10 00 07 06")


def test_stopped_node_answers_no_sdo() -> None:
    node = booted()
    node.step(1, [nmt_frame(NmtCommand.STOP, 0)])
    assert node.step(2, [request("40 00 10 00 00 00 00 00")]) == []
    assert node.bad_frames == 0


# SDO through a real client


def test_client_reads_identity_configuration_and_names(client: Client) -> None:
    sdo = client.remote.sdo
    assert sdo["Device type"].raw == 0
    assert sdo["Error register"].raw == 0
    assert [sdo["Identity object"][sub].raw for sub in (1, 2, 3, 4)] == [0, 2, 0x10000, 0]
    assert sdo["Manufacturer device name"].raw == "Steering ECU"
    assert sdo["Manufacturer software version"].raw == "0.1.0"
    assert sdo["COB-ID EMCY"].raw == 0x082
    assert sdo["Inhibit time EMCY"].raw == 500
    assert sdo["Producer heartbeat time"].raw == 50
    assert [sdo["SDO server parameter"][sub].raw for sub in (1, 2)] == [0x602, 0x582]
    assert sdo["configuration"]["dbc_hash"].raw == 0xDEADBEEF
    assert sdo["configuration"]["vehicle_hash"].raw == 0x12345678


def test_client_reads_every_parameter_in_its_unit(client: Client) -> None:
    record = client.remote.sdo["parameters"]
    assert {name: record[name].phys for name in VALUES} == pytest.approx(VALUES)


def test_client_writes_a_parameter_and_the_owner_is_told_in_si(client: Client) -> None:
    client.node.writable = True
    client.remote.sdo["parameters"]["position_gain_per_s"].phys = 20.125
    assert client.node.parameters["position_gain_per_s"] == 20.125
    assert client.node.poll_events() == [
        CanopenEvent(
            kind=CanopenEventKind.PARAMETER_WRITTEN, name="position_gain_per_s", value=20.125
        )
    ]
    assert client.remote.sdo["parameters"]["position_gain_per_s"].phys == pytest.approx(20.125)


def put(client: Client, index: int, subindex: int, data: bytes) -> int:
    """Abort code that writing gives."""
    with pytest.raises(SdoAbortedError) as caught:
        client.remote.sdo.download(index, subindex, data)
    return int(caught.value.code)


def number(value: int) -> bytes:
    return value.to_bytes(4, "little", signed=True)


def test_nothing_is_writable_until_the_owner_allows_it(client: Client) -> None:
    assert put(client, *TIMEOUT, number(500)) == 0x08000022
    assert put(client, 0x1017, 0, b"\x0a\x00") == 0x08000022
    assert client.node.parameters["command_timeout_s"] == 0.06
    assert client.node.poll_events() == []
    client.run(200 * MS)
    heartbeats = [frame for frame in client.seen if frame == PRE_OPERATIONAL]
    assert len(heartbeats) == client.now_ns // (50 * MS)


@pytest.mark.parametrize(
    ("raw", "code"),
    [(59, 0x06090032), (-1, 0x06090032), (1251, 0x06090031), (2**31 - 1, 0x06090031)],
)
def test_values_beyond_the_limits_are_refused_and_not_stored(
    client: Client, raw: int, code: int
) -> None:
    client.node.writable = True
    assert put(client, *TIMEOUT, number(raw)) == code
    assert client.remote.sdo["parameters"]["command_timeout_s"].raw == 60
    assert client.node.poll_events() == []


@pytest.mark.parametrize("raw", [60, 1250])
def test_values_at_the_limits_are_taken(client: Client, raw: int) -> None:
    client.node.writable = True
    client.remote.sdo.download(*TIMEOUT, number(raw))
    assert client.node.parameters["command_timeout_s"] == raw / 1000


@pytest.mark.parametrize(
    ("index", "subindex", "data", "code"),
    [
        (*TIMEOUT, b"\x32\x00", 0x06070010),
        (*TIMEOUT, bytes(3), 0x06070010),
        (0x1017, 0, bytes(4), 0x06070010),
        (0x1001, 0, b"\x01", 0x06010002),
        (0x1018, 1, bytes(4), 0x06010002),
        (0x2000, 1, bytes(4), 0x06010002),
        (0x2100, 0, b"\x01", 0x06010002),
        (0x2100, 8, bytes(4), 0x06090011),
        (0x1017, 1, b"\x0a\x00", 0x06090011),
        (0x3000, 0, bytes(4), 0x06020000),
        (0x1017, 0, b"\xe9\x03", 0x06090031),
    ],
)
def test_each_forbidden_write_has_its_abort_code(
    client: Client, index: int, subindex: int, data: bytes, code: int
) -> None:
    client.node.writable = True
    assert put(client, index, subindex, data) == code


@pytest.mark.parametrize(
    ("index", "subindex", "code"),
    [(0x3000, 0, 0x06020000), (0x2100, 99, 0x06090011), (0x1000, 1, 0x06090011)],
)
def test_reading_what_is_not_there_has_its_abort_code(
    client: Client, index: int, subindex: int, code: int
) -> None:
    with pytest.raises(SdoAbortedError) as caught:
        client.remote.sdo.upload(index, subindex)
    assert caught.value.code == code


def test_client_of_a_stopped_node_waits_in_vain(client: Client) -> None:
    client.remote.nmt.state = "STOPPED"
    client.run(10 * MS)
    with pytest.raises(SdoCommunicationError):
        client.remote.sdo.upload(0x1000, 0)


def test_real_master_sees_boot_up_and_states(client: Client) -> None:
    assert client.remote.nmt.state == "PRE-OPERATIONAL"
    client.remote.nmt.state = "OPERATIONAL"
    client.run(60 * MS)
    assert client.node.state is NmtState.OPERATIONAL
    assert client.seen[-1] == Frame(0x702, b"\x05")
    client.remote.nmt.state = "RESET"
    client.run(500 * MS)
    assert client.seen.count(BOOT_UP) == 2
    assert client.remote.nmt.state == "PRE-OPERATIONAL"


def test_heartbeat_time_written_by_a_client_takes_effect_without_a_second_boot_up(
    client: Client,
) -> None:
    client.node.writable = True
    client.remote.sdo["Producer heartbeat time"].raw = 100
    written_ns = client.now_ns
    client.seen.clear()
    client.run(90 * MS)
    assert client.seen == []
    client.run(910 * MS)
    assert client.now_ns == written_ns + 1000 * MS
    assert client.seen == [PRE_OPERATIONAL] * 10
    client.remote.sdo["Producer heartbeat time"].raw = 0
    client.seen.clear()
    client.run(1000 * MS)
    assert client.seen == []
    assert client.remote.sdo["Producer heartbeat time"].raw == 0


# Emergencies


def test_emergency_carries_code_register_and_manufacturer_bytes() -> None:
    node = booted()
    node.emergency(1, 0x8130, 0x11, b"\x05\x00\x01")
    assert node.step(1) == [Frame(0x082, bytes.fromhex("30 81 11 05 00 01 00 00"))]
    assert answer(node, "40 01 10 00 00 00 00 00", 2) == "4f 01 10 00 11 00 00 00"
    assert node.step(3) == []


def test_real_consumer_understands_the_emergency(client: Client) -> None:
    client.node.emergency(client.now_ns, 0xFF05, 0x81, b"\x05")
    client.run(10 * MS)
    (entry,) = client.remote.emcy.active
    assert (entry.code, entry.register, entry.data) == (0xFF05, 0x81, b"\x05\0\0\0\0")


def test_emergencies_keep_their_order_and_the_inhibit_time() -> None:
    node = booted(heartbeat_period_ns=0)
    for number_ in range(3):
        node.emergency(10 * MS, 0xFF00 + number_, 1)
    sent = {now: node.step(now * MS) for now in range(10, 200)}
    assert {now: frames[0].data[0] for now, frames in sent.items() if frames} == {
        10: 0,
        60: 1,
        110: 2,
    }
    node.emergency(300 * MS, 0xFF07, 1)
    assert node.step(300 * MS)[0].data[0] == 7


def test_inhibit_time_written_by_a_client_takes_effect() -> None:
    node = booted(heartbeat_period_ns=0, emcy_inhibit_ns=0)
    node.writable = True
    assert answer(node, "2b 15 10 00 64 00 00 00") == "60 15 10 00 00 00 00 00"
    for _ in range(2):
        node.emergency(0, 0xFF00, 1)
    times = [now for now in range(1, 50) if node.step(now * MS)]
    assert times == [1, 11]


def test_queue_of_emergencies_is_bounded_and_the_latest_survives() -> None:
    node = booted(heartbeat_period_ns=0)
    for code in range(EMCY_QUEUE_MAX + 3):
        node.emergency(0, code, 1)
    assert node.emcy_dropped == 3
    sent = [frame.data[0] for now in range(1000) for frame in node.step(now * MS)]
    assert sent == list(range(3, EMCY_QUEUE_MAX + 3))


def test_stopped_node_holds_emergencies_back_until_it_is_started() -> None:
    node = booted(heartbeat_period_ns=0)
    node.step(1, [nmt_frame(NmtCommand.STOP, 0)])
    node.emergency(2, 0xFF05, 1)
    assert [node.step(now * MS) for now in range(1, 100)] == [[]] * 99
    (frame,) = node.step(100 * MS, [nmt_frame(NmtCommand.START, 0)])
    assert frame.can_id == 0x082


def test_node_reset_forgets_waiting_emergencies_and_the_error_register() -> None:
    node = booted(heartbeat_period_ns=0)
    node.emergency(0, 0xFF05, 1)
    node.emergency(0, 0xFF06, 1)
    assert len(node.step(0)) == 1
    node.step(1, [nmt_frame(NmtCommand.RESET_NODE, 0)])
    assert [node.step(now * MS) for now in range(1, 200)] == [[]] * 199
    assert answer(node, "40 01 10 00 00 00 00 00", 200 * MS) == "4f 01 10 00 00 00 00 00"


@pytest.mark.parametrize(
    "arguments", [(0x10000, 0, b""), (-1, 0, b""), (0, 256, b""), (0, 0, bytes(6))]
)
def test_emergency_that_fits_no_frame_is_a_programmers_error(
    arguments: tuple[int, int, bytes],
) -> None:
    with pytest.raises(AssertionError):
        booted().emergency(0, *arguments)


# Construction


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"command_timeout_s": 2.0}, r"command_timeout_s: 2.0 s; allowed 0.06 to 1.25"),
        ({"command_timeout_s": 0.059}, r"command_timeout_s: 0.059 s; allowed 0.06 to 1.25"),
        ({"rate_gain": float("nan")}, "rate_gain: nan"),
        ({"rate_gain": float("inf")}, "rate_gain: inf"),
        ({"gain": 1.0}, "unknown: gain"),
    ],
)
def test_wrong_parameter_is_refused_by_name(change: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(parameters=VALUES | change)


def test_missing_parameters_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="missing: command_timeout_s, rate_gain"):
        make(
            parameters={
                name: value
                for name, value in VALUES.items()
                if name not in ("rate_gain", "command_timeout_s")
            }
        )


def test_parameter_is_rounded_to_its_factor() -> None:
    assert make(parameters=VALUES | {"rate_gain": 1.23456}).parameters["rate_gain"] == 1.235


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: make(heartbeat_period_ns=50 * MS + 1), "heartbeat"),
        (lambda: make(heartbeat_period_ns=1001 * MS), "heartbeat"),
        (lambda: make(heartbeat_period_ns=-MS), "heartbeat"),
        (lambda: make(emcy_inhibit_ns=150_001), "Inhibit"),
        (
            lambda: CanopenNode(2, EDS, dbc_hash=1 << 32, vehicle_hash=0, parameters=VALUES),
            "dbc_hash",
        ),
        (lambda: CanopenNode(0, EDS, dbc_hash=0, vehicle_hash=0, parameters=VALUES), "node id 0"),
        (lambda: CanopenNode(128, EDS, dbc_hash=0, vehicle_hash=0, parameters=VALUES), "1 to 127"),
    ],
)
def test_wrong_configuration_is_refused_by_name(
    build: Callable[[], CanopenNode], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        build()


def test_eds_may_be_given_as_text_or_path() -> None:
    text = Path(EDS).read_text(encoding="ascii")
    for eds in (text, Path(EDS)):
        node = make(eds=eds)
        assert node.step(0) == [BOOT_UP]
        assert answer(node, "40 00 20 01 00 00 00 00") == "43 00 20 01 ef be ad de"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[1017]", "[5017]", "no object 1017"),
        ("Factor=0.001", "Factor=0", "Factor of position_gain_per_s"),
        ("LowLimit=1000\n", "", "position_gain_per_s needs LowLimit"),
        ("LowLimit=1000\n", "LowLimit=50000\n", "position_gain_per_s is above"),
        ("DataType=0x0004", "DataType=0x0003", "position_gain_per_s must be INTEGER32"),
        (
            "[2100]\nParameterName=parameters\nObjectType=0x9",
            "[2100]\nParameterName=p\nObjectType=0x7\nDataType=0x7\nAccessType=ro",
            "2100 must be a record",
        ),
    ],
)
def test_incomplete_eds_is_refused_by_name(old: str, new: str, message: str) -> None:
    text = Path(EDS).read_text(encoding="ascii")
    assert old in text
    with pytest.raises(ValueError, match=message):
        make(eds=text.replace(old, new, 1))


def test_missing_eds_file_is_named() -> None:
    with pytest.raises(OSError, match=r"nowhere\.eds"):
        make(eds="nowhere.eds")
