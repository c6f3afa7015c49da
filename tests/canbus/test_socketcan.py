"""What is asked of the kernel about a socket. UDP stands in for CAN: stamps, queue and drops are of
the socket layer, which both share."""

from __future__ import annotations

import errno
import socket
import struct
import sys
from collections.abc import Iterator

import can
import pytest

from canbus import python_can_bus
from canbus.bus import BusStatistics
from canbus.frame import Frame, FrameKind, ReceivedFrame
from canbus.python_can_bus import REOPEN_INTERVAL_NS, PythonCanBus
from canbus.socketcan import (
    FRAME_BITS_MIN,
    FRAME_BYTES,
    Arrivals,
    backlog_frames_max,
    make_room,
    receive_drops,
)
from canbus.timing import frame_bits

MS = 1_000_000
S = 1_000_000_000
EPOCH_NS = 1_800_000_000 * S
"""Realtime at monotonic 0; its stamps are as long as those of a real clock."""


class Clocks:
    """A monotonic clock and the system's, which a person or NTP may set."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.step_ns = 0

    def monotonic(self) -> int:
        return self.now_ns

    def realtime(self) -> int:
        return EPOCH_NS + self.now_ns + self.step_ns


def read(arrivals: Arrivals, stamps_ns: list[int], clocks: Clocks) -> list[int]:
    """When frames with these stamps arrived, that are read now."""
    stamped = [(Frame(0x123), stamp_ns) for stamp_ns in stamps_ns]
    return [item.arrival_ns for item in arrivals.received(stamped, clocks.now_ns)]


def arrival(age_ms: int, step_ms: int, empty_ms: int = 0) -> float:
    """Arrival in ms of a frame that is read at 100 ms; the clock was set while it waited."""
    clocks = Clocks()
    arrivals = Arrivals(clocks.realtime, 0)
    arrivals.was_empty(empty_ms * MS)
    clocks.now_ns = (100 - age_ms) * MS
    stamp_ns = clocks.realtime()
    clocks.now_ns, clocks.step_ns = 100 * MS, step_ms * MS
    return read(arrivals, [stamp_ns], clocks)[0] / MS


def test_arrival_is_the_kernels_stamp_and_not_the_time_of_reading() -> None:
    assert arrival(age_ms=7, step_ms=0) == 93


@pytest.mark.parametrize("step_ms", [1, 5, 3_600_000, -1, -5, -3_600_000])
def test_a_step_of_the_system_clock_keeps_arrival_between_empty_queue_and_reading(
    step_ms: int,
) -> None:
    assert 90 <= arrival(age_ms=7, step_ms=step_ms, empty_ms=90) <= 100


def test_a_clock_set_back_gives_the_time_of_reading_and_forward_the_empty_queue() -> None:
    assert arrival(age_ms=7, step_ms=-3_600_000, empty_ms=90) == 100
    assert arrival(age_ms=7, step_ms=3_600_000, empty_ms=90) == 90


def test_a_step_before_the_frame_arrived_changes_nothing() -> None:
    clocks = Clocks()
    arrivals = Arrivals(clocks.realtime, 0)
    clocks.now_ns, clocks.step_ns = 50 * MS, -86_400 * S
    stamp_ns = clocks.realtime()
    clocks.now_ns = 58 * MS
    assert read(arrivals, [stamp_ns], clocks) == [50 * MS]


def test_arrivals_never_go_back_even_when_the_clock_is_set_between_two_frames() -> None:
    clocks = Clocks()
    arrivals = Arrivals(clocks.realtime, 0)
    stamps = []
    for now_ms, step_ms in ((1, 0), (2, -5_000), (3, 5_000), (4, 0)):
        clocks.now_ns, clocks.step_ns = now_ms * MS, step_ms * MS
        stamps.append(clocks.realtime())
    clocks.now_ns = 5 * MS
    times = read(arrivals, stamps[:3], clocks) + read(arrivals, stamps[3:], clocks)
    assert times == sorted(times) and times[-1] <= clocks.now_ns


def test_the_shortest_frame_has_no_data_and_no_stuff_bit() -> None:
    lengths = [frame_bits(Frame(can_id)) for can_id in range(0x800)]
    assert min(lengths) >= FRAME_BITS_MIN
    assert backlog_frames_max(60 * MS, 500_000) == 639  # 60 ms / (47 bits * 2 us), rounded up


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Sender and receiver."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
    ):
        receiver.bind(("127.0.0.1", 0))
        sender.connect(receiver.getsockname())
        yield sender, receiver


def test_the_kernels_count_of_lost_datagrams_is_read(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    sender, receiver = pair
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
    assert receive_drops(receiver) == 0
    sent = 200
    for _ in range(sent):
        sender.send(b"16 bytes of frame")
    lost = receive_drops(receiver)
    receiver.setblocking(False)
    read = 0
    with pytest.raises(BlockingIOError):
        while receiver.recv(32):
            read += 1
    assert lost > 0 and read + lost == sent


def test_room_is_made_but_never_taken_away(pair: tuple[socket.socket, socket.socket]) -> None:
    _, receiver = pair
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
    assert make_room(receiver, 100) == 100
    assert make_room(receiver, 10) == 100
    assert receiver.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) == 100 * FRAME_BYTES


def test_without_the_privilege_the_system_grants_what_it_allows() -> None:
    class Unprivileged:
        def __init__(self) -> None:
            self.granted = 8_192

        def getsockopt(self, level: int, option: int) -> int:
            return self.granted

        def setsockopt(self, level: int, option: int, value: int) -> None:
            if option != socket.SO_RCVBUF:
                raise PermissionError(errno.EPERM, "not permitted")
            self.granted = 2 * min(value, 106_496)

    assert make_room(Unprivileged(), 1_000) == 2 * 106_496 // FRAME_BYTES  # type: ignore[arg-type]


RAW = {
    "000#": "00000000 00 000000 0000000000000000",
    "7FF#0102030405060708": "ff070000 08 000000 0102030405060708",
    "123#AA": "23010000 01 000000 aa00000000000000",
    "12345678#01": "78563492 01 000000 0100000000000000",
    "00000123#02": "23010080 01 000000 0200000000000000",
    "123#R": "23010040 08 000000 0000000000000000",
    "00000123#": "230100c0 02 000000 0000000000000000",
    "00000040#0000000000000000": "40000020 08 000000 0000000000000000",
}
"""Frames as `struct can_frame` of a little-endian machine; the last is a remote extended frame and
the controller's report that it is bus-off."""


def raw(text: str) -> bytes:
    assert sys.byteorder == "little", "the table above is of such a machine"
    return bytes.fromhex(RAW[text])


class Device:
    """The kernel's side of one interface: up, down or gone, as its raw socket shows it."""

    def __init__(self, clocks: Clocks) -> None:
        self.clocks = clocks
        self.is_present = True
        self.errors: list[int] = []
        self.opened = 0
        self.closed = 0
        self.waiting: list[tuple[int, bytes]] = []
        self.sent: list[bytes] = []
        self.real = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.getsockopt, self.setsockopt = self.real.getsockopt, self.real.setsockopt

    def open(self, **options: object) -> Device:
        assert self.is_present
        self.opened += 1
        return self

    @property
    def socket(self) -> Device:
        """This is python-can's bus and its socket in one."""
        return self

    def if_nametoindex(self, name: str) -> int:
        if not self.is_present:
            raise OSError(errno.ENODEV, "No such device")
        return 3

    def remove(self) -> None:
        self.is_present = False
        self.errors = [errno.ENODEV]

    def arrives(self, text: str = "123#AA") -> None:
        self.waiting.append((self.clocks.realtime(), raw(text)))

    def _fail(self) -> None:
        if self.errors:
            raise OSError(self.errors.pop(), "as told")

    def send(self, data: bytes, flags: int) -> int:
        assert flags == socket.MSG_DONTWAIT
        self._fail()
        if not self.is_present:
            raise OSError(errno.ENXIO, "No such device or address")
        self.sent.append(data)
        return len(data)

    def recvmsg(
        self, size: int, ancillary_size: int, flags: int
    ) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
        assert size == 16 and flags == socket.MSG_DONTWAIT
        self._fail()
        if not self.waiting:
            raise BlockingIOError(errno.EAGAIN, "nothing there")
        stamp_ns, data = self.waiting.pop(0)
        stamp = struct.pack("@ll", *divmod(stamp_ns, S))
        assert socket.CMSG_LEN(len(stamp)) <= ancillary_size
        return data, [(socket.SOL_SOCKET, 35, stamp)], 0, None

    def recv(self, timeout: float | None = None) -> can.Message | None:
        raise AssertionError("waits by the system's clock, which may be set back")

    def shutdown(self) -> None:
        self.closed += 1


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Iterator[Device]:
    clocks = Clocks()
    device = Device(clocks)

    def wait(
        read: list[object], write: object, errors: object, timeout_s: float
    ) -> tuple[list[object], list[object], list[object]]:
        if read and (device.errors or device.waiting):
            return read, [], []
        clocks.now_ns += round(timeout_s * S)
        return [], [], []

    monkeypatch.setattr(can, "Bus", device.open)
    monkeypatch.setattr(socket, "if_nametoindex", device.if_nametoindex)
    monkeypatch.setattr("canbus.python_can_bus.select.select", wait)
    with device.real:
        yield device


@pytest.fixture
def bus(device: Device) -> Iterator[PythonCanBus]:
    clocks = device.clocks
    with PythonCanBus(
        "socketcan", "can0", clock=clocks.monotonic, realtime=clocks.realtime, backlog_frames=100
    ) as bus:
        yield bus


def test_frames_carry_the_kernels_time_of_arrival(device: Device, bus: PythonCanBus) -> None:
    device.clocks.now_ns = 3 * MS
    device.arrives()
    device.clocks.now_ns = 9 * MS
    (received,) = bus.receive(0)
    assert received == ReceivedFrame(3 * MS, Frame(0x123, b"\xaa"))


def test_a_wait_without_frames_bounds_the_arrival_of_the_next(
    device: Device, bus: PythonCanBus
) -> None:
    bus.receive(0)
    device.clocks.now_ns = 40 * MS
    bus.receive(0)
    device.arrives()
    device.clocks.step_ns = 3_600 * S
    device.clocks.now_ns = 45 * MS
    assert bus.receive(0)[0].arrival_ns == 40 * MS


def test_a_wait_is_measured_by_the_monotonic_clock_and_never_by_python_cans(
    device: Device, bus: PythonCanBus
) -> None:
    device.clocks.step_ns = -3_600 * S
    assert bus.receive(8 * MS) == []
    assert device.clocks.now_ns == 8 * MS


def test_frames_are_gathered_in_one_wait_each_with_its_own_time_of_arrival(
    device: Device, bus: PythonCanBus
) -> None:
    for _ in range(2):
        device.arrives()
        device.clocks.now_ns += 2 * MS
    received = bus.gather(6 * MS)
    assert device.clocks.now_ns == 10 * MS
    assert [item.arrival_ns for item in received] == [0, 2 * MS]


def test_what_waits_is_gathered_when_there_is_no_time_left(
    device: Device, bus: PythonCanBus
) -> None:
    device.arrives()
    assert len(bus.gather(0)) == 1
    assert device.clocks.now_ns == 0


def test_a_device_that_is_gone_is_waited_out_while_gathering(
    device: Device, bus: PythonCanBus
) -> None:
    device.remove()
    assert bus.gather(10 * MS) == bus.gather(10 * MS) == []
    assert device.clocks.now_ns == 20 * MS
    assert bus.statistics.rx_failures == 1


def test_what_came_before_the_interface_failed_is_handed_on(
    device: Device, bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = device.recvmsg

    def read_once(*arguments: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
        device.errors = [] if device.waiting else [errno.ENETDOWN]
        return read(*arguments)

    monkeypatch.setattr(device, "recvmsg", read_once)
    device.arrives("123#AA")
    device.arrives("000#")
    assert [str(item.frame) for item in bus.receive(0)] == ["123#AA", "000#"]
    assert bus.statistics == BusStatistics(received=2, rx_failures=1)


def test_frames_that_are_not_accepted_do_not_end_the_wait(device: Device) -> None:
    clocks = device.clocks
    accepted = frozenset({0x123})
    with PythonCanBus(
        "socketcan", "can0", clock=clocks.monotonic, realtime=clocks.realtime, acceptance=accepted
    ) as bus:
        device.arrives("12345678#01")
        assert bus.receive(5 * MS) == [] and clocks.now_ns == 5 * MS
        device.arrives("12345678#01")
        device.arrives("123#AA")
        (received,) = bus.receive(5 * MS)
        assert str(received.frame) == "123#AA" and clocks.now_ns == 5 * MS


def test_a_flood_is_read_in_pieces(
    device: Device, bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(python_can_bus, "RECEIVE_FRAMES_MAX", 3)
    for _ in range(4):
        device.arrives()
    assert [len(bus.receive(0)) for _ in range(3)] == [3, 1, 0]


def test_the_receive_queue_gets_its_room(device: Device, bus: PythonCanBus) -> None:
    size = device.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    assert size >= 100 * FRAME_BYTES


def test_frames_lost_in_the_queue_are_counted_also_after_closing(
    device: Device, bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(python_can_bus, "receive_drops", lambda sock: 17)
    assert bus.statistics == BusStatistics(rx_lost=17)
    bus.close()
    assert bus.statistics == BusStatistics(rx_lost=17)


def test_a_link_that_is_down_is_silence_and_carries_on_when_it_is_back(
    device: Device, bus: PythonCanBus
) -> None:
    device.errors = [errno.ENETDOWN]
    assert bus.receive(10 * MS) == []
    assert device.clocks.now_ns == 10 * MS  # waited out, no spinning
    device.arrives()
    assert len(bus.receive(10 * MS)) == 1
    assert bus.statistics.rx_failures == 1 and device.opened == 1


def test_a_device_that_is_removed_is_silence_refused_sends_and_opened_again_when_back(
    device: Device, bus: PythonCanBus
) -> None:
    device.remove()
    for cycle in range(1, 6):
        assert bus.receive(10 * MS) == []
        assert device.clocks.now_ns == cycle * 10 * MS
        assert not bus.send(Frame(0x182))
    assert bus.statistics == BusStatistics(rx_failures=1, tx_failures=5)
    device.is_present = True
    device.clocks.now_ns += REOPEN_INTERVAL_NS
    bus.receive(0)
    assert bus.send(Frame(0x182))
    assert (device.opened, device.closed, len(device.sent)) == (2, 1, 1)


def test_a_removal_that_a_send_learns_first_closes_the_socket_with_its_queues(
    device: Device, bus: PythonCanBus
) -> None:
    device.is_present = False
    assert not bus.send(Frame(0x182))
    assert device.closed == 1
    bus.close()
    assert device.closed == 1


def test_a_removed_device_is_looked_for_once_a_second(
    device: Device, bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[int] = []

    def look(name: str) -> int:
        looks.append(device.clocks.now_ns)
        raise OSError(errno.ENODEV, "No such device")

    monkeypatch.setattr(socket, "if_nametoindex", look)
    device.remove()
    for _ in range(251):
        bus.receive(10 * MS)
    assert looks == [10 * MS, 1_010 * MS, 2_010 * MS]


@pytest.mark.parametrize("text", RAW)
def test_a_frame_is_read_as_what_it_is(text: str, device: Device, bus: PythonCanBus) -> None:
    device.arrives(text)
    (received,) = bus.receive(0)
    assert str(received.frame) == text
    assert (received.frame.kind is FrameKind.ERROR) == (text == "00000040#0000000000000000")


@pytest.mark.parametrize("text", ["000#", "7FF#0102030405060708", "123#AA"])
def test_a_data_frame_is_written_as_the_kernel_wants_it(
    text: str, device: Device, bus: PythonCanBus
) -> None:
    can_id, _, data = text.partition("#")
    assert bus.send(Frame(int(can_id, 16), bytes.fromhex(data)))
    assert device.sent == [raw(text)]


def test_a_full_queue_refuses_a_frame_and_it_is_counted(device: Device, bus: PythonCanBus) -> None:
    device.errors = [errno.ENOBUFS, errno.EAGAIN]
    assert not bus.send(Frame(0x182)) and not bus.send(Frame(0x182))
    assert bus.statistics == BusStatistics(tx_failures=2)
    assert bus.send(Frame(0x182))


def test_everything_that_waits_is_read_at_once_in_order(device: Device, bus: PythonCanBus) -> None:
    for text in RAW:
        device.clocks.now_ns += MS
        device.arrives(text)
    received = bus.receive(0)
    assert [str(item.frame) for item in received] == list(RAW)
    assert [item.arrival_ns for item in received] == [n * MS for n in range(1, len(RAW) + 1)]
    assert bus.receive(0) == []
