"""The master's side: NMT frames, heartbeats, and the non-blocking SDO reader."""

from __future__ import annotations

from importlib.resources import files

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canbus.canopen_node import CanopenNode
from canbus.canopen_protocol import (
    NmtCommand,
    NmtState,
    SdoAbort,
    SdoClient,
    heartbeat_state,
    nmt_frame,
)
from canbus.frame import Frame, FrameKind

DETERMINISTIC = settings(derandomize=True, deadline=None)
MS = 1_000_000


def reply(text: str, node_id: int = 2) -> Frame:
    return Frame(0x580 + node_id, bytes.fromhex(text))


def gateway() -> CanopenNode:
    return CanopenNode(
        6,
        str(files("dbc").joinpath("eds", "gateway.eds")),
        dbc_hash=0xCAFE,
        vehicle_hash=7,
        parameters={"command_timeout_s": 0.3},
    )


@pytest.mark.parametrize(
    ("command", "data"),
    [
        (NmtCommand.START, "0102"),
        (NmtCommand.STOP, "0202"),
        (NmtCommand.ENTER_PRE_OPERATIONAL, "8002"),
        (NmtCommand.RESET_NODE, "8102"),
        (NmtCommand.RESET_COMMUNICATION, "8202"),
    ],
)
def test_nmt_frames_are_those_of_the_standard(command: NmtCommand, data: str) -> None:
    assert nmt_frame(command, 2) == Frame(0x000, bytes.fromhex(data))


@pytest.mark.parametrize("node_id", [-1, 128])
def test_nmt_frame_for_an_impossible_node_is_a_programmers_error(node_id: int) -> None:
    with pytest.raises(AssertionError):
        nmt_frame(NmtCommand.START, node_id)


@pytest.mark.parametrize("state", NmtState)
@pytest.mark.parametrize("can_id", [0x701, 0x77F])
def test_heartbeat_tells_the_state(state: NmtState, can_id: int) -> None:
    assert heartbeat_state(Frame(can_id, bytes([state]))) is state


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x700, b"\x05"),
        Frame(0x780, b"\x05"),
        Frame(0x182, b"\x05"),
        Frame(0x702, b""),
        Frame(0x702, b"\x05\x00"),
        Frame(0x702, b"\x06"),
        Frame(0x702, b"\x85"),
        Frame(0x702, b"\x05", FrameKind.FD),
        Frame(0x702, b"", FrameKind.REMOTE),
    ],
    ids=str,
)
def test_what_is_no_heartbeat_tells_nothing(frame: Frame) -> None:
    assert heartbeat_state(frame) is None


def test_reader_gets_values_from_a_node() -> None:
    node, reader = gateway(), SdoClient()
    node.step(0)
    keys = [(6, 0x2000, 1), (6, 0x2000, 2), (6, 0x2100, 1), (6, 0x1018, 2)]
    for key in keys:
        reader.request(*key)
    frames: list[Frame] = []
    for step in range(1, 10):
        frames = node.step(step * 10 * MS, reader.step(step * 10 * MS, frames))
    assert reader.results == dict(zip(keys, (0xCAFE, 7, 300, 6), strict=True))
    assert not reader.busy


def test_client_writes_in_order_and_reports_what_was_written_or_refused() -> None:
    node, client = gateway(), SdoClient()
    node.step(0)
    node.writable = True
    for value in (100, 200):
        client.write(6, 0x1017, 0, value, 2)
        client.write(6, 0x1017, 0, value, 2)  # under way already
    sent: list[str] = []
    frames: list[Frame] = []
    for step in range(1, 6):
        asked = client.step(step * MS, frames)
        sent += [frame.data.hex() for frame in asked]
        frames = node.step(step * MS, asked)
    assert sent == ["2b17100064000000", "2b171000c8000000"]
    assert client.results == {(6, 0x1017, 0): 200}
    assert node.number(0x1017) == 200
    node.writable = False
    client.write(6, 0x1017, 0, 50, 2)
    client.step(8 * MS, node.step(7 * MS, client.step(7 * MS)))
    assert client.results == {(6, 0x1017, 0): SdoAbort(0x08000022)}
    assert node.number(0x1017) == 200


@pytest.mark.parametrize(
    ("value", "byte_count", "data"),
    [
        (5, 1, "2f00600005000000"),
        (-2, 2, "2b006000feff0000"),
        (0x123456, 3, "2700600056341200"),
        (-1, 4, "23006000ffffffff"),
    ],
)
def test_a_write_says_its_length(value: int, byte_count: int, data: str) -> None:
    client = SdoClient()
    client.write(0x11, 0x6000, 0, value, byte_count)
    assert client.step(0) == [Frame(0x611, bytes.fromhex(data))]
    client.step(1, [Frame(0x591, bytes.fromhex("4b00600000000000"))])  # an answer to a reading
    assert client.bad_frames == 1
    assert client.busy


def test_reader_reports_the_servers_abort() -> None:
    node, reader = gateway(), SdoClient()
    node.step(0)
    reader.request(6, 0x3000, 0)
    reader.step(2, node.step(1, reader.step(1)))
    assert reader.results == {(6, 0x3000, 0): SdoAbort(0x06020000)}


def test_reader_gives_up_what_does_not_fit_into_one_frame_and_tells_the_server() -> None:
    node, reader = gateway(), SdoClient()
    node.step(0)
    reader.request(6, 0x1008, 0)
    abort = reader.step(2, node.step(1, reader.step(1)))
    assert reader.results == {(6, 0x1008, 0): SdoAbort(0x05040001)}
    assert abort == [Frame(0x606, bytes.fromhex("80 08 10 00 01 00 04 05"))]
    assert node.step(3, abort) == []


def test_reader_asks_one_node_one_question_at_a_time_and_all_nodes_at_once() -> None:
    reader = SdoClient()
    for node_id in (2, 3):
        for subindex in (1, 2):
            reader.request(node_id, 0x2000, subindex)
    first = reader.step(0)
    assert [(frame.can_id, frame.data.hex()) for frame in first] == [
        (0x602, "4000200100000000"),
        (0x603, "4000200100000000"),
    ]
    assert reader.step(1) == []
    second = reader.step(2, [reply("43 00 20 01 01 00 00 00")])
    assert [(frame.can_id, frame.data[3]) for frame in second] == [(0x602, 2)]


def test_reader_repeats_an_unanswered_question_and_then_reports_the_time_out() -> None:
    reader = SdoClient(timeout_ns=200 * MS, attempts=3)
    reader.request(2, 0x2000, 1)
    sent = [now for now in range(0, 1000, 10) if reader.step(now * MS)]
    assert sent == [0, 200, 400]
    assert reader.results == {(2, 0x2000, 1): SdoAbort(0x05040000)}
    assert not reader.busy


def test_silent_node_does_not_hold_up_its_next_question() -> None:
    reader = SdoClient(timeout_ns=200 * MS, attempts=1)
    reader.request(2, 0x2000, 1)
    reader.request(2, 0x2000, 2)
    sent = [now for now in range(0, 1000, 10) if reader.step(now * MS)]
    assert sent == [0, 200]
    assert len(reader.results) == 2


def test_late_and_repeated_answers_are_not_taken_for_the_next_one() -> None:
    reader = SdoClient(timeout_ns=200 * MS)
    reader.request(2, 0x2000, 1)
    reader.request(2, 0x2000, 2)
    reader.step(0)
    reader.step(200 * MS)  # asked twice, so answered twice
    reader.step(210 * MS, [reply("43 00 20 01 11 00 00 00")])
    reader.step(220 * MS, [reply("43 00 20 01 99 00 00 00")])
    assert reader.results == {(2, 0x2000, 1): 0x11}
    reader.step(230 * MS, [reply("43 00 20 02 22 00 00 00")])
    assert reader.results[2, 0x2000, 2] == 0x22
    reader.step(240 * MS, [reply("43 00 20 02 33 00 00 00")])
    assert reader.results[2, 0x2000, 2] == 0x22


@pytest.mark.parametrize(
    ("answer", "value"),
    [
        ("4f 00 20 01 ff aa bb cc", 0xFF),
        ("4b 00 20 01 34 12 bb cc", 0x1234),
        ("47 00 20 01 56 34 12 cc", 0x123456),
        ("43 00 20 01 78 56 34 f2", 0xF2345678),
        ("42 00 20 01 78 56 34 12", 0x12345678),
    ],
)
def test_only_the_bytes_that_count_are_taken(answer: str, value: int) -> None:
    reader = SdoClient()
    reader.request(2, 0x2000, 1)
    reader.step(0)
    reader.step(1, [reply(answer)])
    assert reader.results == {(2, 0x2000, 1): value}


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x582, b"\x43\x00\x20\x01"),
        Frame(0x582, b""),
        Frame(0x582, b"", FrameKind.REMOTE),
        Frame(0x582, bytes.fromhex("4300200101000000"), FrameKind.FD),
        Frame(0x582, bytes.fromhex("6000200100000000")),
    ],
    ids=str,
)
def test_malformed_answers_are_counted_and_waited_past(frame: Frame) -> None:
    reader = SdoClient()
    reader.request(2, 0x2000, 1)
    reader.step(0)
    reader.step(1, [frame])
    assert reader.bad_frames == 1
    reader.step(2, [reply("43 00 20 01 05 00 00 00")])
    assert reader.results == {(2, 0x2000, 1): 5}


def test_answers_of_nodes_that_were_not_asked_are_ignored() -> None:
    reader = SdoClient()
    reader.request(2, 0x2000, 1)
    reader.step(0)
    reader.step(1, [reply("43 00 20 01 05 00 00 00", node_id=3), Frame(0x123, bytes(8))])
    assert reader.results == {}
    assert reader.bad_frames == 0


def test_asking_again_forgets_the_old_answer_and_asks_once() -> None:
    reader = SdoClient()
    for _ in range(3):
        reader.request(2, 0x2000, 1)
    assert len(reader.step(0)) == 1
    reader.request(2, 0x2000, 1)
    reader.step(1, [reply("43 00 20 01 05 00 00 00")])
    assert not reader.busy
    reader.request(2, 0x2000, 1)
    assert reader.results == {}
    assert reader.busy
    assert len(reader.step(2)) == 1


@DETERMINISTIC
@given(frames=st.lists(st.builds(Frame, st.integers(0x580, 0x5FF), st.binary(max_size=8))))
def test_no_answer_raises(frames: list[Frame]) -> None:
    reader = SdoClient()
    for node_id in range(1, 128):
        reader.request(node_id, 0, 0)
    reader.step(0)
    reader.step(1, frames)


@pytest.mark.parametrize(("timeout_ns", "attempts"), [(0, 1), (-1, 1), (1, 0)])
def test_impossible_timeouts_are_refused(timeout_ns: int, attempts: int) -> None:
    with pytest.raises(ValueError, match="timeout"):
        SdoClient(timeout_ns=timeout_ns, attempts=attempts)
