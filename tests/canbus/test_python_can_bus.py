"""The python-can bus: traffic on 'virtual', errors of everything else.

Timeouts are deadlines of the wall clock here; no test sleeps, and those that wait do so in the bus.
"""

from __future__ import annotations

import errno
import itertools
import time
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest

from canbus import python_can_bus
from canbus.bus import BusError, BusStatistics, error_classes_text, is_bus_off, is_receive_overflow
from canbus.frame import Frame, FrameKind
from canbus.python_can_bus import PythonCanBus

_channels = itertools.count()


@pytest.fixture
def channel(request: pytest.FixtureRequest) -> str:
    """A channel no other test shares."""
    return f"{request.node.nodeid}-{next(_channels)}"


def ticking() -> Callable[[], int]:
    """A clock that moves 1 us each time it is read."""
    ticks = itertools.count(5_000_000, 1_000)
    return lambda: next(ticks)


@pytest.fixture
def pair(channel: str) -> Iterator[tuple[PythonCanBus, PythonCanBus]]:
    with (
        PythonCanBus("virtual", channel, clock=ticking()) as one,
        PythonCanBus("virtual", channel, clock=ticking()) as other,
    ):
        yield one, other


KINDS = [
    Frame(0x000, b""),
    Frame(0x7FF, bytes(range(8))),
    Frame(0x123, b"", FrameKind.REMOTE),
    Frame(0x12345678, b"\x01", FrameKind.EXTENDED),
    Frame(0x123, b"\x02", FrameKind.EXTENDED),
    Frame(0x123, bytes(64), FrameKind.FD),
    Frame(0x040, bytes(8), FrameKind.ERROR),
]


@pytest.mark.parametrize("frame", KINDS, ids=lambda frame: f"{frame.kind.name}-{frame.can_id:x}")
def test_every_kind_of_frame_arrives_as_what_it_is(
    pair: tuple[PythonCanBus, PythonCanBus], frame: Frame
) -> None:
    one, other = pair
    assert one.send(frame)
    assert [received.frame for received in other.receive(0)] == [frame]


def test_receive_returns_everything_waiting_in_order(
    pair: tuple[PythonCanBus, PythonCanBus],
) -> None:
    one, other = pair
    frames = [Frame(0x100 + number, bytes([number])) for number in range(50)]
    for frame in frames:
        assert one.send(frame)
    assert [received.frame for received in other.receive(1_000_000_000)] == frames
    assert other.receive(0) == []


def test_arrival_is_read_from_the_callers_clock(pair: tuple[PythonCanBus, PythonCanBus]) -> None:
    one, other = pair
    one.send(Frame(0x1))
    one.send(Frame(0x2))
    arrivals = [received.arrival_ns for received in other.receive(0)]
    assert arrivals == [5_001_000, 5_002_000]


def test_own_frames_are_not_received(pair: tuple[PythonCanBus, PythonCanBus]) -> None:
    one, _ = pair
    one.send(Frame(0x1))
    assert one.receive(0) == []


def test_unaccepted_frames_do_not_hide_accepted_ones(channel: str) -> None:
    accepted = frozenset({0x002})
    with (
        PythonCanBus("virtual", channel, clock=ticking()) as one,
        PythonCanBus("virtual", channel, clock=ticking(), acceptance=accepted) as other,
    ):
        for can_id in (0x001, 0x002, 0x003, 0x003, 0x002):
            one.send(Frame(can_id))
        one.send(Frame(0x002, b"", FrameKind.REMOTE))
        one.send(Frame(0x002, b"", FrameKind.EXTENDED))
        one.send(Frame(0x040, bytes(8), FrameKind.ERROR))
        kinds = [(got.frame.can_id, got.frame.kind) for got in other.receive(0)]
        # With a timeout of 0 the first wanted frame must be found behind an unwanted one.
        assert kinds == [
            (0x002, FrameKind.DATA),
            (0x002, FrameKind.DATA),
            (0x002, FrameKind.REMOTE),
            (0x002, FrameKind.EXTENDED),
            (0x040, FrameKind.ERROR),
        ]
        assert other.statistics.received == 5


def test_without_the_kernels_stamps_a_frame_ends_the_gathering(
    pair: tuple[PythonCanBus, PythonCanBus],
) -> None:
    one, other = pair
    one.send(Frame(0x1))
    assert [item.frame for item in other.gather(3_600_000_000_000)] == [Frame(0x1)]


@pytest.mark.wall_clock
def test_receive_waits_until_its_timeout_and_no_longer(channel: str) -> None:
    with PythonCanBus("virtual", channel, clock=time.monotonic_ns) as bus:
        start_ns = time.monotonic_ns()
        assert bus.receive(20_000_000) == []
        assert 19_000_000 <= time.monotonic_ns() - start_ns < 2_000_000_000


@pytest.mark.wall_clock
def test_unaccepted_frames_do_not_end_the_wait(channel: str) -> None:
    with (
        PythonCanBus("virtual", channel, clock=time.monotonic_ns) as one,
        PythonCanBus(
            "virtual", channel, clock=time.monotonic_ns, acceptance=frozenset({2})
        ) as other,
    ):
        one.send(Frame(0x001))
        start_ns = time.monotonic_ns()
        assert other.receive(20_000_000) == []
        assert time.monotonic_ns() - start_ns >= 19_000_000


def test_a_flood_does_not_keep_receive_from_returning(
    pair: tuple[PythonCanBus, PythonCanBus], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(python_can_bus, "RECEIVE_FRAMES_MAX", 10)
    one, other = pair
    for _ in range(25):
        one.send(Frame(0x1))
    assert [len(other.receive(0)) for _ in range(4)] == [10, 10, 5, 0]


def test_statistics_count_both_directions_and_error_frames(
    pair: tuple[PythonCanBus, PythonCanBus],
) -> None:
    one, other = pair
    overflow = Frame(0x004, bytes([0, 0x01, 0, 0, 0, 0, 0, 0]), FrameKind.ERROR)
    for frame in (Frame(0x1), overflow, Frame(0x040, bytes(8), FrameKind.ERROR)):
        one.send(frame)
    other.receive(0)
    assert one.statistics == BusStatistics(sent=3)
    assert other.statistics == BusStatistics(
        received=3, error_frames=2, error_classes=0x044, rx_dropped=1
    )
    assert error_classes_text(0x044) == "trouble in the controller, bus-off"


def test_bus_off_and_overflow_are_recognised_in_error_frames_only() -> None:
    assert is_bus_off(Frame(0x040, bytes(8), FrameKind.ERROR))
    assert not is_bus_off(Frame(0x040, bytes(8)))
    assert not is_bus_off(Frame(0x004, bytes(8), FrameKind.ERROR))
    assert is_receive_overflow(Frame(0x004, b"\0\1", FrameKind.ERROR))
    assert not is_receive_overflow(Frame(0x004, b"\0\2", FrameKind.ERROR))
    assert not is_receive_overflow(Frame(0x004, b"\0", FrameKind.ERROR))
    assert not is_receive_overflow(Frame(0x004, b"\0\1"))


class FailingBus:
    """A driver whose every operation fails, as an interface that went down."""

    def __init__(self, error: Exception) -> None:
        self.error = error

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        assert timeout == 0, "a send must not wait"
        raise self.error

    def recv(self, timeout: float | None = None) -> can.Message | None:
        raise self.error

    def shutdown(self) -> None:
        pass


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("Transmit buffer full"),
        can.CanOperationError("Failed to transmit: Network is down", errno.ENETDOWN),
        OSError(errno.ENOBUFS, "No buffer space available"),
    ],
)
def test_refused_sends_are_counted_and_never_raise(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    monkeypatch.setattr(can, "Bus", lambda **_: FailingBus(error))
    with PythonCanBus("socketcan", "can0", clock=ticking()) as bus:
        assert not bus.send(Frame(0x1))
        assert not bus.send(Frame(0x1))
        assert bus.statistics == BusStatistics(tx_failures=2)


def test_failed_reads_are_counted_and_wait_out_the_timeout(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    waits: list[float] = []
    monkeypatch.setattr(can, "Bus", lambda **_: FailingBus(can.CanOperationError("down")))
    monkeypatch.setattr(
        "canbus.python_can_bus.select.select", lambda *arguments: waits.append(arguments[3])
    )
    with PythonCanBus("socketcan", "can0", clock=lambda: 0) as bus:
        assert bus.receive(10_000_000) == []
        assert bus.statistics == BusStatistics(rx_failures=1)
    assert waits == [0.01]


def test_acceptance_is_filtered_in_the_kernel_on_socketcan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: dict[str, Any] = {}

    def open_bus(**options: Any) -> FailingBus:
        seen.update(options)
        return FailingBus(RuntimeError())

    monkeypatch.setattr(can, "Bus", open_bus)
    acceptance = frozenset({0x602, 0x000})
    with PythonCanBus("socketcan", "can0", clock=ticking(), bitrate=500_000, acceptance=acceptance):
        pass
    assert seen["can_filters"] == [
        {"can_id": 0x000, "can_mask": 0x7FF},
        {"can_id": 0x602, "can_mask": 0x7FF},
    ]
    assert seen["bitrate"] == 500_000
    assert seen["ignore_config"] is True


def open_error(interface: str, channel: str) -> str:
    """The message of the BusError that opening gives."""
    with pytest.raises(BusError) as caught, PythonCanBus(interface, channel, clock=ticking()):
        pass
    text = str(caught.value)
    assert "\n" not in text
    assert channel in text
    assert interface in text
    return text


def failing_open(error: Exception) -> Callable[..., can.BusABC]:
    def open_bus(**options: Any) -> can.BusABC:
        raise error

    return open_bus


def test_kernel_without_socketcan_is_named_with_the_ways_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    missing = OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")
    monkeypatch.setattr(can, "Bus", failing_open(missing))
    text = open_error("socketcan", "vcan0")
    assert "no SocketCAN" in text
    assert "modprobe" in text
    assert "virtual" in text


def test_socketcan_that_cannot_be_opened_here_says_what_to_do() -> None:
    # Without SocketCAN in the kernel the way out is another kernel; with it, the missing device.
    text = open_error("socketcan", "vcan77")
    assert "no SocketCAN" in text or "ip link add dev vcan77 type vcan" in text


@pytest.mark.parametrize(
    ("channel", "command"),
    [
        ("vcan0", "ip link add dev vcan0 type vcan && ip link set vcan0 up"),
        ("can0", "ip link set can0 up type can bitrate 500000"),
    ],
)
def test_missing_device_names_the_command_that_makes_it(
    monkeypatch: pytest.MonkeyPatch, channel: str, command: str
) -> None:
    monkeypatch.setattr(can, "Bus", failing_open(OSError(errno.ENODEV, "No such device")))
    assert command in open_error("socketcan", channel)


def test_missing_permission_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can, "Bus", failing_open(PermissionError(errno.EPERM, "not permitted")))
    assert "permission denied" in open_error("socketcan", "can0")


def test_unknown_interface_lists_the_known_ones() -> None:
    text = open_error("sockercan", "can0")
    assert "unknown interface" in text
    assert "socketcan" in text
    assert "virtual" in text


def test_other_drivers_errors_come_through_on_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can, "Bus", failing_open(NameError("first\n  second")))
    assert open_error("kvaser", "0").endswith("first second")
    monkeypatch.setattr(can, "Bus", failing_open(NameError()))
    assert open_error("kvaser", "0").endswith("NameError")


def test_failed_open_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    open_error("socketcan", "vcan77")
    assert capfd.readouterr() == ("", "")


def test_nothing_is_opened_before_the_block_or_left_open_after_it(channel: str) -> None:
    bus = PythonCanBus("virtual", channel, clock=ticking())
    with PythonCanBus("virtual", channel, clock=ticking()) as other:
        other.send(Frame(0x1))
        with bus:
            assert bus.receive(0) == []
        bus.close()
        other.send(Frame(0x2))
        with bus:
            assert bus.receive(0) == []


@pytest.mark.parametrize("can_id", [-1, 0x800])
def test_acceptance_beyond_11_bits_is_refused(can_id: int) -> None:
    with pytest.raises(ValueError, match="acceptance"):
        PythonCanBus("virtual", "x", clock=ticking(), acceptance=frozenset({can_id}))


@pytest.mark.parametrize("bitrate", [0, -1])
def test_bitrate_must_be_positive(bitrate: int) -> None:
    with pytest.raises(ValueError, match="bitrate"):
        PythonCanBus("virtual", "x", clock=ticking(), bitrate=bitrate)
