"""A `Bus` on any interface python-can knows. The only module that imports python-can."""

from __future__ import annotations

import logging
import select
import socket
from collections.abc import Callable
from typing import Any, Self

from canbus.bus import ERROR_CLASS_TEXT, BusError, BusStatistics, is_receive_overflow
from canbus.frame import CAN_ID_MAX, Frame, FrameKind, ReceivedFrame
from canbus.heard import (
    CLASSICAL,
    ERROR_FLAG,
    EXTENDED_FLAG,
    FD_BIT_RATE_SWITCH,
    FD_ERROR_STATE,
    REMOTE_FLAG,
    Heard,
)
from canbus.hidden import ASAMMDF, hidden
from canbus.interface_errors import GONE, SOCKETCAN, reason_not_opened
from canbus.socketcan import Arrivals, make_room, read_frames, receive_drops, write_frame

with hidden(ASAMMDF):
    import can

RECEIVE_FRAMES_MAX = 4096
"""Most frames one `receive` returns, so that a flood cannot keep the caller from its deadline."""

ERROR_CLASSES = sum(ERROR_CLASS_TEXT)
"""Of an error frame's identifier, the bits that say what it is about."""

REOPEN_INTERVAL_NS = 1_000_000_000
"""How often a device that was removed is looked for."""

# python-can logs what it also raises; without a handler Python prints that to stderr, beside our
# own line. An application that wants the log installs its handler as usual.
logging.getLogger("can").addHandler(logging.NullHandler())


class PythonCanBus:
    """A bus on one interface and channel, opened by `with`.

    Args:
        interface: python-can's name: "socketcan", "virtual", "pcan", ...
        channel: "vcan0", "can0"; for "virtual" any text, shared inside one process.
        bitrate: bit/s, for interfaces that set it themselves; SocketCAN takes it from `ip link`.
        clock: monotonic time in ns. Arrival is the time at which the frame is read through this
            clock, so it is later than the wire by the reader's latency, never earlier.
        realtime: the system's clock in ns since 1970. With it, arrival on SocketCAN is taken from
            the kernel's stamp (`canbus.socketcan.Arrivals`): the reader's latency is gone.
        backlog_frames: how many frames the kernel is to keep on SocketCAN while nobody reads; None
            leaves it the system's choice.
        fd: whether frames of CAN FD may be sent and heard.
        acceptance: identifiers to hand on, None for all. Filtered in the kernel on SocketCAN, and
            here in any case. It looks at the identifier alone: remote, extended and FD frames with
            an accepted identifier pass, to be counted by their receiver. Error frames always pass.

    Raises:
        ValueError: an accepted identifier is not an 11-bit one, or the bitrate is not positive.
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        *,
        clock: Callable[[], int],
        realtime: Callable[[], int] | None = None,
        bitrate: int | None = None,
        acceptance: frozenset[int] | None = None,
        backlog_frames: int | None = None,
        fd: bool = False,
    ) -> None:
        if bitrate is not None and bitrate <= 0:
            raise ValueError(f"bitrate: {bitrate} bit/s; must be above 0")
        for can_id in acceptance or ():
            if not 0 <= can_id <= CAN_ID_MAX:
                raise ValueError(f"acceptance: identifier {can_id:#x}; allowed 0x000 to 0x7ff")
        self._interface = interface
        self._channel = channel
        self._bitrate = bitrate
        self._clock = clock
        self._realtime = realtime
        self._acceptance = acceptance
        self._backlog_frames = backlog_frames
        self._fd = fd
        self._bus: can.BusABC | None = None
        self._socket: socket.socket | None = None
        self._arrivals: Arrivals | None = None
        self._is_gone = False
        self._reopen_ns = 0
        self._sent = 0
        self._received = 0
        self._tx_failures = 0
        self._rx_dropped = 0
        self._rx_lost = 0
        self._rx_failures = 0
        self._error_frames = 0
        self._error_classes = 0

    def __enter__(self) -> Self:
        """Open the interface.

        Raises:
            BusError: it cannot be opened; the message is one line with the way out.
        """
        assert self._bus is None, "the bus is already open"
        self._open()
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the interface."""
        self.close()

    def _open(self) -> None:
        options: dict[str, Any] = {"fd": True} if self._fd else {}
        if self._bitrate is not None:
            options["bitrate"] = self._bitrate
        if self._acceptance is not None and self._interface == SOCKETCAN:
            # Elsewhere python-can filters in software, and then `recv(0)` returns None at the
            # first unwanted frame although wanted ones wait behind it.
            options["can_filters"] = [
                {"can_id": can_id, "can_mask": CAN_ID_MAX} for can_id in sorted(self._acceptance)
            ]
        try:
            self._bus = can.Bus(
                interface=self._interface, channel=self._channel, ignore_config=True, **options
            )
        except Exception as error:  # drivers raise whatever they like, NameError included
            reason = reason_not_opened(self._interface, self._channel, error, can.VALID_INTERFACES)
            raise BusError(reason) from error
        if self._interface == SOCKETCAN:
            self._socket = getattr(self._bus, "socket", None)
        if self._socket is not None and self._backlog_frames is not None:
            make_room(self._socket, self._backlog_frames)
        if self._socket is not None and self._realtime is not None:
            self._arrivals = Arrivals(self._realtime, self._clock())

    def close(self) -> None:
        """Close the interface; closing twice is harmless."""
        self._is_gone = False
        if self._bus is not None:
            self._rx_lost += self._lost_in_queue()
            self._bus.shutdown()
            self._bus = self._socket = self._arrivals = None

    def repeat(self, heard: Heard) -> bool:
        """Hand on a frame that was heard elsewhere, with every flag but the channel; as `send`."""
        assert self._bus is not None, "the bus is not open"
        try:
            self._bus.send(_from_heard(heard), timeout=0)
        except (can.CanError, OSError):
            self._tx_failures += 1
            return False
        self._sent += 1
        return True

    def send(self, frame: Frame) -> bool:
        """Hand `frame` to the driver without waiting.

        Returns:
            False when the driver refused it (transmit queue full, network down, bus-off); the
            frame is then gone, on purpose: a command that leaves late is an old decision.
        """
        if self._is_gone:
            self._tx_failures += 1
            return False
        assert self._bus is not None, "the bus is not open"
        try:
            is_plain = frame.kind is FrameKind.DATA and frame.can_id <= CAN_ID_MAX
            if self._socket is not None and is_plain:
                write_frame(self._socket, frame)
            else:
                self._bus.send(_to_message(frame), timeout=0)
        except (can.CanError, OSError) as error:
            self._tx_failures += 1
            self._check_gone(error)
            return False
        self._sent += 1
        return True

    def receive(self, timeout_ns: int) -> list[ReceivedFrame]:
        """Wait at most `timeout_ns` for an accepted frame, then return everything waiting.

        Returns:
            Frames in order of reception, each with its arrival time; empty after the timeout or
            when the interface failed (counted as `rx_failures`; the rest of the time is waited
            out, so that a caller in a loop does not spin). An interface that is down or gone is
            silent, until it is back.
        """
        frames: list[ReceivedFrame] = []
        now_ns = self._clock()
        deadline_ns = now_ns + timeout_ns
        if self._is_gone and not self._reopen(now_ns):
            self._wait_until(deadline_ns)
            return frames
        assert self._bus is not None, "the bus is not open"
        read = self._read_message if self._socket is None else self._read_socket
        wait_ns = max(0, timeout_ns)
        for _ in range(RECEIVE_FRAMES_MAX):
            try:
                read_ns = read(wait_ns / 1e9, now_ns, frames)
            except (can.CanError, OSError) as error:
                self._rx_failures += 1
                self._check_gone(error)
                self._wait_until(deadline_ns)
                break
            if read_ns is None:
                break
            now_ns = read_ns
            # Nothing accepted yet: wait on; otherwise only collect what is already there.
            wait_ns = 0 if frames else max(0, deadline_ns - now_ns)
        return frames

    def gather(self, span_ns: int) -> list[ReceivedFrame]:
        """Wait `span_ns` and return what has come, in one piece where the kernel stamps frames.

        A caller that needs the frames at a deadline sleeps until then, instead of waking up for
        each. Elsewhere a frame arrives when it is read, so the first one ends the wait, as in
        `receive`: call again.
        """
        if self._arrivals is None or span_ns <= 0:
            return self.receive(span_ns)
        self._wait_until(self._clock() + span_ns)
        return self.receive(0)

    def hear(self) -> list[Heard]:
        """All that waits, of whatever kind and with every flag; nothing is filtered or counted.

        Stamped with the system's time of reading.
        """
        assert self._bus is not None and self._realtime is not None
        heard: list[Heard] = []
        try:
            while len(heard) < RECEIVE_FRAMES_MAX:
                message = self._bus.recv(0)
                if message is None:
                    break
                heard.append(_to_heard(message, self._channel, self._realtime()))
        except (can.CanError, OSError):
            self._rx_failures += 1
        return heard

    @property
    def statistics(self) -> BusStatistics:
        """The counters so far."""
        return BusStatistics(
            sent=self._sent,
            received=self._received,
            tx_failures=self._tx_failures,
            rx_dropped=self._rx_dropped,
            rx_lost=self._rx_lost + self._lost_in_queue(),
            rx_failures=self._rx_failures,
            error_frames=self._error_frames,
            error_classes=self._error_classes,
        )

    def _read_message(
        self, wait_s: float, now_ns: int, frames: list[ReceivedFrame]
    ) -> int | None:
        """Appends the next frame, if it is accepted; the time of reading, or None if there is none.
        """
        assert self._bus is not None
        message = self._bus.recv(wait_s)
        if message is None:
            return None
        frame = _to_frame(message)
        now_ns = self._clock()
        if self._is_accepted(frame):
            frames.append(ReceivedFrame(now_ns, frame))
        return now_ns

    def _read_socket(self, wait_s: float, now_ns: int, frames: list[ReceivedFrame]) -> int | None:
        """Appends the accepted frames that wait, or the first to come.

        Returns:
            The time of reading, or None if there is nothing left to wait for.

        python-can's `recv` waits by the system's clock: when that is set back, all nodes at once
        would wait for as long. A socket is therefore waited for here, by the monotonic clock.
        """
        assert self._socket is not None
        is_timeout = wait_s > 0 and not select.select([self._socket], [], [], wait_s)[0]
        stamped: list[tuple[Frame, int]] = []
        is_empty = is_timeout
        try:
            is_empty = is_timeout or read_frames(self._socket, RECEIVE_FRAMES_MAX, stamped)
        finally:  # what came before the interface failed has come
            read_ns = self._clock()
            accepted = [item for item in stamped if self._is_accepted(item[0])]
            if self._arrivals is None:
                frames += [ReceivedFrame(read_ns, frame) for frame, _ in accepted]
            else:
                frames += self._arrivals.received(accepted, read_ns)
                if is_empty:
                    self._arrivals.was_empty(now_ns)
        return None if is_timeout or wait_s <= 0 or frames else read_ns

    def _is_accepted(self, frame: Frame) -> bool:
        """Whether a frame is handed on; counted, if it is."""
        if frame.kind is FrameKind.ERROR:
            self._error_frames += 1
            self._error_classes |= frame.can_id & ERROR_CLASSES
            self._rx_dropped += is_receive_overflow(frame)
        elif self._acceptance is not None and frame.can_id not in self._acceptance:
            return False
        self._received += 1
        return True

    def _lost_in_queue(self) -> int:
        """Frames lost in this socket's queue; 0 for interfaces that are no socket of ours."""
        return 0 if self._socket is None else receive_drops(self._socket)

    def _check_gone(self, error: Exception) -> None:
        """Closes the socket of a device that was removed, with whatever waits in its queues."""
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if self._interface == SOCKETCAN and number in GONE:
            self.close()
            self._is_gone = True

    def _reopen(self, now_ns: int) -> bool:
        """Looks for a device that was removed; whether it is open again."""
        if now_ns < self._reopen_ns:
            return False
        self._reopen_ns = now_ns + REOPEN_INTERVAL_NS
        try:
            socket.if_nametoindex(self._channel)
            self._open()
        except (OSError, BusError):
            return False
        self._is_gone = False
        return True

    def _wait_until(self, deadline_ns: int) -> None:
        """Wait out a failed read: a dead interface fails again at once, without waiting."""
        select.select([], [], [], max(0, deadline_ns - self._clock()) / 1e9)


def _to_message(frame: Frame) -> can.Message:
    """`frame` as python-can wants it; identifiers above 11 bits are extended ones."""
    kind = frame.kind
    return can.Message(
        arbitration_id=frame.can_id,
        data=frame.data,
        is_extended_id=kind is FrameKind.EXTENDED or frame.can_id > CAN_ID_MAX,
        is_remote_frame=kind is FrameKind.REMOTE,
        is_fd=kind is FrameKind.FD,
        is_error_frame=kind is FrameKind.ERROR,
    )


def _to_frame(message: can.Message) -> Frame:
    """`message` as plain data. A remote frame with a 29-bit identifier is called EXTENDED."""
    if message.is_error_frame:
        kind = FrameKind.ERROR
    elif message.is_fd:
        kind = FrameKind.FD
    elif message.is_extended_id:
        kind = FrameKind.EXTENDED
    elif message.is_remote_frame:
        kind = FrameKind.REMOTE
    else:
        kind = FrameKind.DATA
    return Frame(message.arbitration_id, bytes(message.data), kind)


def _to_heard(message: can.Message, channel: str, time_ns: int) -> Heard:
    """`message` with every flag that it has."""
    word = message.arbitration_id
    word |= EXTENDED_FLAG * (message.is_extended_id and not message.is_error_frame)
    word |= REMOTE_FLAG * message.is_remote_frame | ERROR_FLAG * message.is_error_frame
    fd_flags = message.bitrate_switch | message.error_state_indicator << 1
    data = bytes(message.data)
    return Heard(
        time_ns,
        channel,
        word,
        data,
        message.dlc if message.is_remote_frame else len(data),
        fd_flags if message.is_fd else CLASSICAL,
        not message.is_rx,
    )


def _from_heard(heard: Heard) -> can.Message:
    """The reverse of `_to_heard`."""
    return can.Message(
        arbitration_id=heard.can_id,
        data=heard.data,
        dlc=heard.length,
        is_extended_id=heard.is_extended,
        is_remote_frame=heard.is_remote,
        is_error_frame=heard.is_error,
        is_fd=heard.is_fd,
        bitrate_switch=heard.is_fd and bool(heard.fd_flags & FD_BIT_RATE_SWITCH),
        error_state_indicator=heard.is_fd and bool(heard.fd_flags & FD_ERROR_STATE),
    )
