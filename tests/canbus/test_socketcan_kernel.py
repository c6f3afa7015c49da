"""The same on a kernel with SocketCAN and the right to make devices, as in the virtual machine:
`dbw vm run -- .venv/bin/python -m pytest tests/canbus/test_socketcan_kernel.py`."""

from __future__ import annotations

import os
import shutil
import socket
import struct
import subprocess
import threading
from collections.abc import Iterator

import can
import pytest

from canbus.bus import BusStatistics
from canbus.frame import Frame, FrameKind
from canbus.python_can_bus import PythonCanBus
from canbus.socketcan import FRAME_BYTES, SO_MEMINFO
from gateway.connect import BusLink
from runtime.clock import NS_PER_MS, monotonic_ns, realtime_ns
from tests.gateway.scripted import Rig
from vehicles import load_vehicle

CHANNEL = "vcan77"


def ip(*arguments: str) -> bool:
    return subprocess.run(["ip", *arguments], capture_output=True, check=False).returncode == 0


def make_device() -> bool:
    return ip("link", "add", "dev", CHANNEL, "type", "vcan") and ip("link", "set", CHANNEL, "up")


def has_socketcan() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return os.geteuid() == 0 and shutil.which("ip") is not None


pytestmark = [
    pytest.mark.wall_clock,
    pytest.mark.skipif(not has_socketcan(), reason="no SocketCAN, or no right to make devices"),
]


def open_bus(backlog_frames: int | None = None) -> PythonCanBus:
    return PythonCanBus(
        "socketcan",
        CHANNEL,
        clock=monotonic_ns,
        realtime=realtime_ns,
        backlog_frames=backlog_frames,
    )


@pytest.fixture
def pair() -> Iterator[tuple[PythonCanBus, PythonCanBus]]:
    """Sender and receiver on a device of their own."""
    assert make_device()
    try:
        with open_bus() as sender, open_bus(backlog_frames=639) as receiver:
            yield sender, receiver
    finally:
        ip("link", "del", CHANNEL)


Pair = tuple[PythonCanBus, PythonCanBus]


def queue_bytes(bus: PythonCanBus) -> int:
    assert bus._socket is not None
    info = bus._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 36)
    used: int = struct.unpack("@9I", info)[0]
    return used


def test_a_frame_costs_what_the_queue_is_sized_with(pair: Pair) -> None:
    sender, receiver = pair
    for length in range(9):
        assert sender.send(Frame(0x181, bytes(length)))
    assert queue_bytes(receiver) == 9 * FRAME_BYTES


def test_the_queue_holds_what_was_asked_for_and_the_rest_is_counted(pair: Pair) -> None:
    sender, receiver = pair
    assert all(sender.send(Frame(0x181, bytes(8))) for _ in range(1_000))
    assert receiver.statistics.rx_lost == 1_000 - 639
    assert len(receiver.receive(0)) == 639


def test_arrival_is_when_the_frame_was_sent_and_not_when_it_is_read(pair: Pair) -> None:
    sender, receiver = pair
    pause = threading.Event()
    pause.wait(0.1)  # the kernel begins to stamp a moment after the first socket has asked for it
    begin_ns = monotonic_ns()
    sender.send(Frame(0x181))
    pause.wait(0.05)
    (received,) = receiver.receive(0)
    assert begin_ns <= received.arrival_ns <= monotonic_ns() - 40 * NS_PER_MS


def test_a_frame_that_waits_for_a_busy_gateway_is_as_old_as_the_wire_says(pair: Pair) -> None:
    sender, _ = pair
    gateway = BusLink(
        "socketcan", CHANNEL, vehicle=load_vehicle("tabby_evo"), planner_period_ns=20 * NS_PER_MS
    )
    others, pause = Rig(), threading.Event()
    gateway.open()
    try:
        pause.wait(0.1)
        with gateway._lock:  # its thread cannot go on, as under a planner that computes
            pause.wait(0.02)
            for _ in range(3):
                sender.send(others.frame("SUPERVISOR_STATE", others.content["SUPERVISOR_STATE"]))
            pause.wait(0.05)
        pause.wait(0.03)
        assert gateway.state().supervisor_state_age_s >= 0.075
    finally:
        gateway.close()


def test_a_link_that_goes_down_is_silence_and_comes_back(pair: Pair) -> None:
    sender, receiver = pair
    assert ip("link", "set", CHANNEL, "down")
    assert receiver.receive(NS_PER_MS) == [] and not sender.send(Frame(0x181))
    assert receiver.statistics == BusStatistics(rx_failures=1)
    assert ip("link", "set", CHANNEL, "up")
    sender.receive(0)
    assert sender.send(Frame(0x182))
    assert [item.frame for item in receiver.receive(1_000 * NS_PER_MS)] == [Frame(0x182)]


def test_a_device_that_is_removed_and_made_anew_is_opened_again(pair: Pair) -> None:
    sender, receiver = pair
    assert ip("link", "del", CHANNEL)
    for bus in pair:
        bus.receive(0)
        assert bus.receive(NS_PER_MS) == [] and not bus.send(Frame(0x181))
    assert make_device()
    for bus in pair:
        bus.receive(1_100 * NS_PER_MS)
        bus.receive(0)
    assert sender.send(Frame(0x183))
    assert [item.frame for item in receiver.receive(1_000 * NS_PER_MS)] == [Frame(0x183)]


KINDS = [
    (Frame(0x000), {}),
    (Frame(0x7FF, bytes(range(8))), {}),
    (Frame(0x123, b"", FrameKind.REMOTE), {"is_remote_frame": True, "dlc": 8}),
    (Frame(0x123, b"\x02", FrameKind.EXTENDED), {"is_extended_id": True}),
    (Frame(0x1FFFFFFF, b"\x02", FrameKind.EXTENDED), {"is_extended_id": True}),
    (Frame(0x040, bytes(8), FrameKind.ERROR), {"is_error_frame": True}),
]


@pytest.mark.parametrize(("frame", "options"), KINDS, ids=lambda item: str(item))
def test_python_can_and_we_mean_the_same(
    pair: Pair, frame: Frame, options: dict[str, bool | int]
) -> None:
    _, receiver = pair
    message = can.Message(
        arbitration_id=frame.can_id, data=frame.data or None,
        **{"is_extended_id": False, **options},  # type: ignore[arg-type]
    )
    with can.Bus(interface="socketcan", channel=CHANNEL) as other:
        other.send(message)
        assert [item.frame for item in receiver.receive(NS_PER_MS)] == [frame]
        if frame.kind is FrameKind.DATA:
            assert receiver.send(frame)
            answer = other.recv(1.0)
            assert answer is not None and not answer.is_extended_id
            assert (answer.arbitration_id, bytes(answer.data)) == (frame.can_id, frame.data)
