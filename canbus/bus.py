"""The bus as a node's runtime sees it: non-blocking sends, one bounded wait for frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self

from canbus.frame import Frame, FrameKind, ReceivedFrame

# Classes of a SocketCAN error frame (linux/can/error.h), which python-can hands on unchanged.
ERROR_CLASS_CONTROLLER = 0x004
ERROR_CLASS_BUS_OFF = 0x040
CONTROLLER_RX_OVERFLOW = 0x01

ERROR_CLASS_TEXT = {
    0x001: "transmission timed out",
    0x002: "arbitration lost",
    ERROR_CLASS_CONTROLLER: "trouble in the controller",
    0x008: "protocol violated",
    0x010: "trouble in the transceiver",
    0x020: "nobody acknowledged",
    ERROR_CLASS_BUS_OFF: "bus-off",
    0x080: "bus error",
    0x100: "restarted",
    0x200: "errors were counted",
}
"""Every class of linux/can/error.h."""


class BusError(RuntimeError):
    """The bus cannot be opened. One line: what is wrong and what to do about it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BusStatistics:
    """Counters since the bus was opened.

    Attributes:
        sent: frames handed to the driver.
        received: frames handed to the caller (error frames included).
        tx_failures: sends refused: transmit queue full, network down, bus-off.
        rx_dropped: overflows of the receive buffer that the controller or the driver reported;
            each stands for at least one lost frame.
        rx_lost: frames lost in the kernel's receive queue, because nobody read it in time.
        rx_failures: reads that failed because the interface went down or away.
        error_frames: error frames among the received ones.
        error_classes: bits of all classes they belonged to; `error_classes_text` tells them.
    """

    sent: int = 0
    received: int = 0
    tx_failures: int = 0
    rx_dropped: int = 0
    rx_lost: int = 0
    rx_failures: int = 0
    error_frames: int = 0
    error_classes: int = 0


class Bus(Protocol):
    """What crosses the boundary between a node and its bus. Opened and closed by `with`."""

    def __enter__(self) -> Self:
        """Open the interface. Raises `BusError` with one clear line when that fails."""
        ...

    def __exit__(self, *exception: object) -> None:
        """Close the interface."""
        ...

    def send(self, frame: Frame) -> bool:
        """Hand one frame to the driver without waiting; False (and counted) if it refused."""
        ...

    def receive(self, timeout_ns: int) -> list[ReceivedFrame]:
        """Wait at most `timeout_ns` for a frame, then return everything that is waiting."""
        ...

    def gather(self, span_ns: int) -> list[ReceivedFrame]:
        """Wait `span_ns` and return what has come, in one piece where the kernel stamps frames.

        Elsewhere a frame arrives when it is read, so the first one ends the wait: call again.
        """
        ...

    @property
    def statistics(self) -> BusStatistics:
        """The counters so far."""
        ...

    def close(self) -> None:
        """Close the interface; closing twice is harmless."""
        ...


def error_classes_text(classes: int) -> str:
    """The classes of error frames in words."""
    return ", ".join(text for bit, text in ERROR_CLASS_TEXT.items() if classes & bit)


def is_bus_off(frame: Frame) -> bool:
    """Whether `frame` is the controller's report that it left the bus (bus-off)."""
    return frame.kind is FrameKind.ERROR and bool(frame.can_id & ERROR_CLASS_BUS_OFF)


def is_receive_overflow(frame: Frame) -> bool:
    """Whether `frame` is the controller's report that it lost received frames."""
    return (
        frame.kind is FrameKind.ERROR
        and bool(frame.can_id & ERROR_CLASS_CONTROLLER)
        and len(frame.data) > 1
        and bool(frame.data[1] & CONTROLLER_RX_OVERFLOW)
    )
