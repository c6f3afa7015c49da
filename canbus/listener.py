"""Ears on one or several channels: every frame of every kind; nothing is sent.

SocketCAN is listened to without python-can, which alone takes longer to import than a monitor may
take to start; and python-can's sockets neither tell the loss of frames apart nor the flags of FD.
"""

from __future__ import annotations

import select
import socket
import struct
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Final, Protocol, Self

from canbus.bus import BusError
from canbus.heard import ANY, CLASSICAL, ERROR_CLASSES_ALL, REMOTE_FLAG, Heard
from canbus.interface_errors import GONE, SOCKETCAN, reason_not_opened
from canbus.socketcan import make_room, receive_drops

BACKLOG_FRAMES: Final = 4096
"""Room in a socket's queue, if the system grants it: half a second of a full 1 Mbit/s bus."""
HEAR_FRAMES_MAX: Final = 4096
"""Most frames of one channel that are answered at once, so that a flood leaves time to draw."""
REOPEN_INTERVAL_NS: Final = 1_000_000_000

_HEAD: Final = struct.Struct("=IBB2x")
"""linux/can.h, `struct can_frame` and `struct canfd_frame`: identifier, length, FD flags."""
_FRAME_BYTES: Final = 16
_FD_FRAME_BYTES: Final = 72
_STAMP: Final = struct.Struct("@ll")
_STAMP_BYTES: Final = socket.CMSG_SPACE(_STAMP.size)
_SO_TIMESTAMPNS: Final = 35
"""Linux `asm-generic/socket.h`; Python's socket module has it not."""
_CAN_RAW_ERR_FILTER: Final = 2
"""linux/can/raw.h."""
_NS_PER_S: Final = 1_000_000_000
_NS_PER_MS: Final = 1_000_000
_POLL_MS: Final = 10
"""How often interfaces without a socket of their own are asked."""


class Listener(Protocol):
    """Opened and closed by `with`."""

    def __enter__(self) -> Self:
        """Open all channels. Raises `BusError` with one clear line when that fails."""
        ...

    def __exit__(self, *exception: object) -> None:
        """Close them."""
        ...

    def hear(self, timeout_ns: int) -> list[Heard]:
        """Wait at most `timeout_ns` for a frame, then return what waits, in order of time."""
        ...

    @property
    def lost(self) -> int:
        """Frames that the kernel has thrown away, since nobody read them in time."""
        ...

    def notes(self) -> list[str]:
        """What happened to the channels since the last call: gone, down, back."""
        ...


class SocketcanListener:
    """Raw CAN sockets of Linux.

    Args:
        channels: Names of interfaces; ANY for all.
        error_classes: Classes of error frames to hear, by channel in this order; the default is
            all of them.
        realtime: The system's clock in ns since 1970, on which the kernel stamps.
        open_socket: What opens a channel; for tests.
    """

    def __init__(
        self,
        channels: Sequence[str],
        *,
        realtime: Callable[[], int],
        error_classes: Sequence[int] = (),
        open_socket: Callable[[str, int], socket.socket] | None = None,
    ) -> None:
        self._channels = list(channels)
        self._error_classes = list(error_classes) or [ERROR_CLASSES_ALL] * len(self._channels)
        self._realtime = realtime
        self._open_socket = open_socket or open_can_socket
        self._sockets: dict[int, tuple[socket.socket, int]] = {}
        self._gone: set[int] = set()
        self._look_ns = 0
        self._lost_before = 0
        self._notes: list[str] = []
        self._poll = select.poll()

    def __enter__(self) -> Self:
        """Opens all channels.

        Raises:
            BusError: One cannot be opened; none is then open.
        """
        try:
            for place, channel in enumerate(self._channels):
                try:
                    self._open(place)
                except OSError as error:
                    raise BusError(reason_not_opened(SOCKETCAN, channel, error)) from error
        except BusError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        """Closes them."""
        for number in list(self._sockets):
            self._close(number)

    def hear(self, timeout_ns: int) -> list[Heard]:
        """Waits at most `timeout_ns` for a frame; answers what waits, by time.

        A channel that is down or gone is told in `notes`, and looked for until it is back.
        """
        if self._gone:
            self._look_for_lost_channels()
        heard: list[Heard] = []
        for number, _ in self._poll.poll(max(0, timeout_ns) / _NS_PER_MS):
            self._read(number, heard)
        if len(self._channels) > 1 or self._channels[0] == ANY:
            heard.sort(key=_time_ns)
        return heard

    @property
    def lost(self) -> int:
        """Frames lost in the queues of all sockets."""
        return self._lost_before + sum(receive_drops(sock) for sock, _ in self._sockets.values())

    def notes(self) -> list[str]:
        """What happened to the channels since the last call."""
        notes, self._notes = self._notes, []
        return notes

    def _open(self, place: int) -> None:
        sock = self._open_socket(self._channels[place], self._error_classes[place])
        make_room(sock, BACKLOG_FRAMES)
        self._sockets[sock.fileno()] = sock, place
        self._poll.register(sock.fileno(), select.POLLIN)

    def _close(self, number: int) -> None:
        sock, _ = self._sockets.pop(number)
        self._lost_before += receive_drops(sock)
        self._poll.unregister(number)
        sock.close()

    def _read(self, number: int, heard: list[Heard]) -> None:
        """Takes what waits in one socket."""
        sock, place = self._sockets[number]
        channel = self._channels[place]
        is_any = channel == ANY
        unpack, unpack_stamp, append = _HEAD.unpack_from, _STAMP.unpack, heard.append
        receive, waits = sock.recvmsg, socket.MSG_DONTWAIT
        local = socket.MSG_DONTROUTE  # how SocketCAN marks frames of this computer
        try:
            for _ in range(HEAR_FRAMES_MAX):
                raw, ancillary, marks, address = receive(_FD_FRAME_BYTES, _STAMP_BYTES, waits)
                word, length, flags = unpack(raw)
                if ancillary:
                    seconds, nanoseconds = unpack_stamp(ancillary[0][2])
                    time_ns = seconds * _NS_PER_S + nanoseconds
                else:
                    time_ns = self._realtime()
                if is_any:
                    channel = address[0]
                data = b"" if word & REMOTE_FLAG else raw[8 : 8 + length]
                fd_flags = flags if len(raw) == _FD_FRAME_BYTES else CLASSICAL
                is_sent = marks & local != 0
                append(Heard(time_ns, channel, word, data, length, fd_flags, is_sent))
        except BlockingIOError:
            return
        except OSError as error:
            if error.errno in GONE:
                self._close(number)
                self._gone.add(place)
                self._notes.append(f"{channel}: gone; waiting for it to come back")
            else:
                self._notes.append(f"{channel}: {error.strerror or error}")

    def _look_for_lost_channels(self) -> None:
        now_ns = self._realtime()
        if abs(now_ns - self._look_ns) < REOPEN_INTERVAL_NS:
            return
        self._look_ns = now_ns
        for place in sorted(self._gone):
            try:
                self._open(place)
            except OSError:
                continue
            self._gone.remove(place)
            self._notes.append(f"{self._channels[place]}: back")


def open_can_socket(channel: str, error_classes: int) -> socket.socket:
    """A raw socket that hears everything on a channel, with the kernel's stamps.

    Raises:
        OSError: The kernel has no SocketCAN, or no such interface.
    """
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    try:
        sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        sock.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, error_classes)
        sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        sock.bind(("" if channel == ANY else channel,))
    except OSError:
        sock.close()
        raise
    return sock


class PythonCanListener:
    """The same through python-can, for its other interfaces. It tells no lost frames.

    Args:
        interface: python-can's name.
        channels: Names of channels.
        clock: Monotonic time in ns.
        realtime: The system's clock in ns since 1970.
        bitrate: bit/s, for interfaces that set it themselves.
    """

    lost = 0

    def __init__(
        self,
        interface: str,
        channels: Sequence[str],
        *,
        clock: Callable[[], int],
        realtime: Callable[[], int],
        bitrate: int | None = None,
    ) -> None:
        from canbus.python_can_bus import PythonCanBus

        self._clock = clock
        self._buses = [
            PythonCanBus(interface, channel, clock=clock, realtime=realtime, bitrate=bitrate)
            for channel in channels
        ]
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Opens all channels. Raises `BusError` when one cannot be opened."""
        with ExitStack() as stack:
            for bus in self._buses:
                stack.enter_context(bus)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        """Closes them."""
        self._stack.close()

    def hear(self, timeout_ns: int) -> list[Heard]:
        """Waits at most `timeout_ns` for a frame; answers what waits, by time of reading."""
        deadline_ns = self._clock() + timeout_ns
        while True:
            heard = [item for bus in self._buses for item in bus.hear()]
            if heard or self._clock() >= deadline_ns:
                return sorted(heard, key=_time_ns)
            left_ms = (deadline_ns - self._clock()) / _NS_PER_MS
            select.select([], [], [], max(0.0, min(left_ms, _POLL_MS)) / 1_000)

    def notes(self) -> list[str]:
        """Nothing: python-can tells nothing."""
        return []


def _time_ns(heard: Heard) -> int:
    return heard.time_ns
