"""Ears on a bus. UDP stands in for CAN: stamps, queue and drops are of the socket layer, which both
share; the bytes are those of linux/can.h."""

from __future__ import annotations

import errno
import select
import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

import can
import pytest

from canbus.bus import BusError
from canbus.heard import (
    CLASSICAL,
    ERROR_CLASSES_ALL,
    ERROR_FLAG,
    EXTENDED_FLAG,
    FD_BIT_RATE_SWITCH,
    REMOTE_FLAG,
    Heard,
)
from canbus.listener import PythonCanListener, SocketcanListener, open_can_socket

WAIT_NS = 1_000_000_000
EPOCH_NS = 1_800_000_000_000_000_000
SO_TIMESTAMPNS = 35


def classical(word: int, data: bytes = b"", length: int | None = None) -> bytes:
    return struct.pack("=IB3x8s", word, len(data) if length is None else length, data)


def fd(word: int, data: bytes, flags: int) -> bytes:
    return struct.pack("=IBB2x64s", word, len(data), flags, data)


class Wires:
    """Two channels, can0 and can1, with a sender each."""

    def __init__(self) -> None:
        self.senders: dict[str, socket.socket] = {}
        self.asked: list[tuple[str, int]] = []
        self.with_stamps = True
        self.failing: dict[str, int] = {}

    def open(self, channel: str, error_classes: int) -> socket.socket:
        self.asked.append((channel, error_classes))
        if channel in self.failing:
            raise OSError(self.failing[channel], "no")
        receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        receiver.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, self.with_stamps)
        receiver.bind(("127.0.0.1", 0))
        old = self.senders.pop(channel, None)
        if old is not None:
            old.close()
        self.senders[channel] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.senders[channel].connect(receiver.getsockname())
        return receiver

    def send(self, channel: str, raw: bytes) -> None:
        self.senders[channel].send(raw)


@pytest.fixture(scope="module")
def stamps() -> Iterator[None]:
    """The kernel begins to stamp arrivals a moment after the first socket has asked for it.

    Until then a frame's stamp is the time of its reading: looked at again and again, 2 ms later.
    """
    wires = Wires()
    with wires.open("can0", 0) as receiver:
        while True:
            wires.send("can0", bytes(16))
            select.select([receiver], [], [], 1.0)
            threading.Event().wait(0.002)
            before_ns = time.time_ns()
            _, ancillary, _, _ = receiver.recvmsg(72, 64)
            seconds, nanoseconds = struct.unpack("@ll", ancillary[0][2])
            if seconds * 1_000_000_000 + nanoseconds < before_ns:
                break
        yield
    wires.senders["can0"].close()


@pytest.fixture
def wires(stamps: None) -> Iterator[Wires]:
    wires = Wires()
    yield wires
    for sender in wires.senders.values():
        sender.close()


def listener(wires: Wires, *channels: str) -> SocketcanListener:
    return SocketcanListener(channels, realtime=lambda: EPOCH_NS, open_socket=wires.open)


@pytest.mark.parametrize(
    ("raw", "word", "data", "length", "fd_flags"),
    [
        (classical(0x123, b"\x01\x02"), 0x123, b"\x01\x02", 2, CLASSICAL),
        (classical(0x123), 0x123, b"", 0, CLASSICAL),
        (classical(1 | EXTENDED_FLAG, b"\x01"), 1 | EXTENDED_FLAG, b"\x01", 1, CLASSICAL),
        (classical(0x123 | REMOTE_FLAG, length=8), 0x123 | REMOTE_FLAG, b"", 8, CLASSICAL),
        (classical(0x40 | ERROR_FLAG, bytes(8)), 0x40 | ERROR_FLAG, bytes(8), 8, CLASSICAL),
        (fd(0x123, bytes(range(12)), FD_BIT_RATE_SWITCH), 0x123, bytes(range(12)), 12, 1),
        (fd(0x123, bytes(8), 0), 0x123, bytes(8), 8, 0),
    ],
)  # fmt: skip
def test_every_kind_of_frame_is_heard_whole(
    wires: Wires, raw: bytes, word: int, data: bytes, length: int, fd_flags: int
) -> None:
    with listener(wires, "can0") as ears:
        wires.send("can0", raw)
        (heard,) = ears.hear(WAIT_NS)
    assert heard[1:] == ("can0", word, data, length, fd_flags, False)
    assert heard.time_ns > EPOCH_NS // 2 and heard.time_ns != EPOCH_NS  # the kernel's stamp


def test_without_a_stamp_the_time_of_reading_is_taken(wires: Wires) -> None:
    wires.with_stamps = False
    with listener(wires, "can0") as ears:
        wires.send("can0", classical(1))
        assert ears.hear(WAIT_NS)[0].time_ns == EPOCH_NS


def test_several_channels_are_heard_in_order_of_time(wires: Wires) -> None:
    with listener(wires, "can0", "can1") as ears:
        for number in range(20):
            wires.send(f"can{number % 2}", classical(number))
        heard = ears.hear(WAIT_NS)
        while len(heard) < 20:
            heard += ears.hear(WAIT_NS)
    assert [item.word for item in heard] == list(range(20))
    assert [item.channel for item in heard] == ["can0", "can1"] * 10


def test_a_silent_bus_answers_nothing_after_the_wait(wires: Wires) -> None:
    with listener(wires, "can0") as ears:
        assert ears.hear(0) == []


def test_error_classes_reach_the_socket_of_their_channel(wires: Wires) -> None:
    ears = SocketcanListener(
        ["can0", "can1"], realtime=lambda: 0, error_classes=[0x40, 0], open_socket=wires.open
    )
    with ears:
        assert wires.asked == [("can0", 0x40), ("can1", 0)]
    with listener(wires, "can0"):
        assert wires.asked[-1] == ("can0", ERROR_CLASSES_ALL)


def test_frames_lost_in_the_queue_are_counted(
    wires: Wires, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("canbus.listener.make_room", lambda sock, frames: frames)
    with listener(wires, "can0") as ears:
        number = next(iter(ears._sockets))
        ears._sockets[number][0].setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
        assert ears.lost == 0
        for _ in range(200):
            wires.send("can0", classical(1))
        lost = ears.lost
        heard = len(ears.hear(WAIT_NS))
        assert lost > 0 and heard + lost == 200
    assert ears.lost == lost  # a closed socket's are not forgotten


def test_a_channel_that_cannot_be_opened_closes_the_others_and_says_why(wires: Wires) -> None:
    wires.failing["can1"] = errno.ENODEV
    ears = listener(wires, "can0", "can1")
    with pytest.raises(BusError, match=r"'can1'.*no such device"), ears:
        pass
    assert not ears._sockets


class GoneSocket(socket.socket):
    """A socket whose interface fails when it is read."""

    error = errno.ENODEV

    def recvmsg(self, *arguments: object) -> Any:
        raise OSError(self.error, "Network is down")


@pytest.mark.parametrize("number", [errno.ENODEV, errno.ENETDOWN])
def test_a_channel_that_fails_is_told_and_heard_again_when_it_is_back(
    wires: Wires, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(GoneSocket, "error", number)
    now_ns = [EPOCH_NS]

    def open_gone(channel: str, error_classes: int) -> socket.socket:
        plain = wires.open(channel, error_classes)
        return plain if len(wires.asked) > 1 else GoneSocket(fileno=plain.detach())

    ears = SocketcanListener(["can0"], realtime=lambda: now_ns[0], open_socket=open_gone)
    with ears:
        wires.send("can0", classical(1))
        assert ears.hear(WAIT_NS) == []
        (note,) = ears.notes()
        assert ears.notes() == []
        if number == errno.ENETDOWN:
            assert note == "can0: Network is down"
            return
        assert note == "can0: gone; waiting for it to come back"
        ears.hear(0)
        assert ears.notes() == ["can0: back"]
        wires.send("can0", classical(2))
        assert [item.word for item in ears.hear(WAIT_NS)] == [2]


def test_a_device_that_is_gone_is_looked_for_once_a_second(wires: Wires) -> None:
    now_ns = [EPOCH_NS]
    ears = SocketcanListener(["can0"], realtime=lambda: now_ns[0], open_socket=wires.open)
    with ears:
        ears._close(next(iter(ears._sockets)))
        ears._gone.add(0)
        wires.failing["can0"] = errno.ENODEV
        tries = len(wires.asked)
        for _ in range(3):
            ears.hear(0)
        assert len(wires.asked) == tries + 1
        now_ns[0] += 1_000_000_000
        ears.hear(0)
        assert len(wires.asked) == tries + 2


def test_no_such_interface_is_an_oserror_and_leaves_nothing_open() -> None:
    with pytest.raises(OSError):
        open_can_socket("nowhere7", 0)


def test_python_cans_frames_keep_every_flag() -> None:
    clock = iter(range(EPOCH_NS, EPOCH_NS + 10_000)).__next__
    ears = PythonCanListener("virtual", ["ears a", "ears b"], clock=clock, realtime=clock)
    with (
        can.Bus(interface="virtual", channel="ears a", ignore_config=True) as first,
        can.Bus(interface="virtual", channel="ears b", ignore_config=True) as second,
        ears,
    ):
        first.send(can.Message(arbitration_id=0x123, data=b"\x01", is_extended_id=False))
        second.send(can.Message(arbitration_id=0x1234567, data=b"\x02", is_extended_id=True))
        first.send(
            can.Message(arbitration_id=0x123, is_remote_frame=True, dlc=8, is_extended_id=False)
        )
        first.send(can.Message(arbitration_id=4, is_error_frame=True, data=bytes(8)))
        first.send(
            can.Message(
                arbitration_id=0x123, data=bytes(12), is_fd=True, bitrate_switch=True,
                error_state_indicator=True, is_extended_id=False,
            )
        )  # fmt: skip
        heard = ears.hear(WAIT_NS)
        assert ears.hear(0) == [] and ears.lost == 0 and ears.notes() == []
    told = [item[1:-1] for item in heard]
    assert not any(item.is_sent for item in heard)
    assert told == [
        ("ears a", 0x123, b"\x01", 1, CLASSICAL),
        ("ears a", 0x123 | REMOTE_FLAG, b"", 8, CLASSICAL),
        ("ears a", 4 | ERROR_FLAG, bytes(8), 8, CLASSICAL),
        ("ears a", 0x123, bytes(12), 12, 3),
        ("ears b", 0x1234567 | EXTENDED_FLAG, b"\x02", 1, CLASSICAL),
    ]
    assert all(isinstance(item, Heard) for item in heard)
