"""A `Bus` on any interface python-can knows. The only module that imports python-can."""

from __future__ import annotations

import errno
import logging
import select
import socket
from collections.abc import Callable
from typing import Any, Self

import can

from canbus.bus import BusError, BusStatistics, is_receive_overflow
from canbus.frame import CAN_ID_MAX, Frame, FrameKind, ReceivedFrame

RECEIVE_FRAMES_MAX = 4096
"""Most frames one `receive` returns, so that a flood cannot keep the caller from its deadline."""

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
        bitrate: int | None = None,
        acceptance: frozenset[int] | None = None,
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
        self._acceptance = acceptance
        self._bus: can.BusABC | None = None
        self._sent = 0
        self._received = 0
        self._tx_failures = 0
        self._rx_dropped = 0
        self._rx_failures = 0
        self._error_frames = 0

    def __enter__(self) -> Self:
        """Open the interface.

        Raises:
            BusError: it cannot be opened; the message is one line with the way out.
        """
        assert self._bus is None, "the bus is already open"
        options: dict[str, Any] = {}
        if self._bitrate is not None:
            options["bitrate"] = self._bitrate
        if self._acceptance is not None and self._interface == "socketcan":
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
            raise BusError(_reason(self._interface, self._channel, error)) from error
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the interface."""
        self.close()

    def close(self) -> None:
        """Close the interface; closing twice is harmless."""
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def send(self, frame: Frame) -> bool:
        """Hand `frame` to the driver without waiting.

        Returns:
            False when the driver refused it (transmit queue full, network down, bus-off); the
            frame is then gone, on purpose: a command that leaves late is an old decision.
        """
        assert self._bus is not None, "the bus is not open"
        try:
            self._bus.send(_to_message(frame), timeout=0)
        except (can.CanError, OSError):
            self._tx_failures += 1
            return False
        self._sent += 1
        return True

    def receive(self, timeout_ns: int) -> list[ReceivedFrame]:
        """Wait at most `timeout_ns` for an accepted frame, then return everything waiting.

        Returns:
            Frames in order of reception, each with its arrival time; empty after the timeout or
            when the interface failed (counted as `rx_failures`; the rest of the time is waited
            out, so that a caller in a loop does not spin).
        """
        assert self._bus is not None, "the bus is not open"
        frames: list[ReceivedFrame] = []
        deadline_ns = self._clock() + timeout_ns
        wait_ns = max(0, timeout_ns)
        for _ in range(RECEIVE_FRAMES_MAX):
            try:
                message = self._bus.recv(wait_ns / 1e9)
            except (can.CanError, OSError):
                self._rx_failures += 1
                self._wait_until(deadline_ns)
                break
            if message is None:
                break
            now_ns = self._clock()
            self._take(message, now_ns, frames)
            # Nothing accepted yet: wait on; otherwise only collect what is already there.
            wait_ns = 0 if frames else max(0, deadline_ns - now_ns)
        return frames

    @property
    def statistics(self) -> BusStatistics:
        """The counters so far."""
        return BusStatistics(
            sent=self._sent,
            received=self._received,
            tx_failures=self._tx_failures,
            rx_dropped=self._rx_dropped,
            rx_failures=self._rx_failures,
            error_frames=self._error_frames,
        )

    def _take(self, message: can.Message, now_ns: int, frames: list[ReceivedFrame]) -> None:
        """Append `message` to `frames` if it is accepted, and count it."""
        frame = _to_frame(message)
        if frame.kind is FrameKind.ERROR:
            self._error_frames += 1
            self._rx_dropped += is_receive_overflow(frame)
        elif self._acceptance is not None and frame.can_id not in self._acceptance:
            return
        self._received += 1
        frames.append(ReceivedFrame(now_ns, frame))

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


def _reason(interface: str, channel: str, error: Exception) -> str:
    """One line for the user: what could not be opened, why, what to do."""
    where = f"cannot open CAN channel '{channel}' on interface '{interface}'"
    if interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        return f"{where}: unknown interface name; known: {known}"
    number = getattr(error, "errno", None)
    if interface == "socketcan":
        no_family = number in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT)
        if no_family or not hasattr(socket, "AF_CAN"):
            return (
                f"{where}: this kernel has no SocketCAN (AF_CAN); run 'modprobe can_raw', "
                "use a kernel built with CONFIG_CAN, or use the interface 'virtual'"
            )
        if number == errno.ENODEV:
            how = (
                f"ip link add dev {channel} type vcan && ip link set {channel} up"
                if channel.startswith("vcan")
                else f"ip link set {channel} up type can bitrate 500000"
            )
            return f"{where}: no such device; create it with '{how}'"
        if number in (errno.EPERM, errno.EACCES):
            return f"{where}: permission denied; it needs the right to open raw CAN sockets"
    text = " ".join(str(error).split()) or type(error).__name__
    return f"{where}: {text}"
