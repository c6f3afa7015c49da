"""Frames through a raw CAN socket of Linux, and what it knows about them.

When a frame arrived, how many frames fit the socket's receive queue, and how many were lost in it.
python-can opens the sockets and sets their options. Frames go straight through here: a node's
answer took 1.9 times as long through python-can's messages (`python -m bench socketcan`).
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Sequence
from typing import Final

from canbus.frame import CAN_ID_MAX, Frame, FrameKind, ReceivedFrame
from canbus.heard import ERROR_FLAG, EXTENDED_FLAG, EXTENDED_ID_MAX, REMOTE_FLAG
from canbus.timing import (
    CRC_BITS,
    FIXED_TAIL_BITS,
    INTERFRAME_SPACE_BITS,
    STANDARD_HEADER_BITS,
)

FRAME_BYTES: Final = 768
"""What one classical frame costs in a socket's receive queue, the kernel's `skb->truesize`:
256 for `struct sk_buff`, 512 for the frame with head room and shared info (64 bit)."""

FRAME_BITS_MIN: Final = STANDARD_HEADER_BITS + CRC_BITS + FIXED_TAIL_BITS + INTERFRAME_SPACE_BITS
"""A frame without data and without a stuff bit: 47 bits."""

SO_RCVBUFFORCE: Final = 33
SO_MEMINFO: Final = 55
"""Linux `asm-generic/socket.h`; Python's socket module has neither."""

_MEMINFO: Final = struct.Struct("@9I")
_MEMINFO_DROPS: Final = 8
"""Place of SK_MEMINFO_DROPS (linux/sock_diag.h)."""

_FRAME: Final = struct.Struct("=IB3x8s")
"""linux/can.h, `struct can_frame`: identifier with flags, length, data."""

_STAMP: Final = struct.Struct("@ll")
"""`struct timespec` of SO_TIMESTAMPNS, the one option of python-can's that adds to a frame."""
_STAMP_BYTES: Final = socket.CMSG_SPACE(_STAMP.size)
_STRUCT_BYTES: Final = _FRAME.size
_AT_ONCE: Final = int(socket.MSG_DONTWAIT)
"""A plain number: Python's enumerations take their time."""

_NS_PER_S: Final = 1_000_000_000


def read_frames(sock: socket.socket, frames_max: int, into: list[tuple[Frame, int]]) -> bool:
    """Appends the classical frames that wait, each with the kernel's stamp in ns since 1970.

    Returns:
        Whether that was all: whether the queue was found empty.

    Raises:
        OSError: the interface is down or gone; what was read before that is in `into`.
    """
    receive, unpack, unpack_stamp = sock.recvmsg, _FRAME.unpack, _STAMP.unpack
    try:
        for _ in range(frames_max):
            raw, ancillary, _, _ = receive(_STRUCT_BYTES, _STAMP_BYTES, _AT_ONCE)
            word, length, data = unpack(raw)
            seconds, nanoseconds = unpack_stamp(ancillary[0][2])
            data = data[:length]
            frame = Frame(word, data) if word <= CAN_ID_MAX else _flagged(word, data)
            into.append((frame, seconds * _NS_PER_S + nanoseconds))
    except BlockingIOError:
        return True
    return False


def _flagged(word: int, data: bytes) -> Frame:
    """A frame that is not plain data. A remote one with a 29-bit identifier is called EXTENDED."""
    if word & ERROR_FLAG:
        kind = FrameKind.ERROR
    elif word & EXTENDED_FLAG:
        kind = FrameKind.EXTENDED
    else:
        kind = FrameKind.REMOTE
    can_id = word & (EXTENDED_ID_MAX if word & EXTENDED_FLAG else CAN_ID_MAX)
    return Frame(can_id, b"" if word & REMOTE_FLAG else data, kind)


def write_frame(sock: socket.socket, frame: Frame) -> None:
    """Hands a data frame with an 11-bit identifier to the driver without waiting.

    Raises:
        OSError: the driver refuses it: a queue is full, the interface down or gone.
    """
    raw = _FRAME.pack(frame.can_id, len(frame.data), frame.data)
    sock.send(raw, _AT_ONCE)


def backlog_frames_max(away_ns: int, bitrate_bps: int) -> int:
    """Most frames that a wire can bring while nobody reads it: the shortest, back to back.

    An upper bound for whatever the DBC allows, and for a stranger who floods the bus.
    """
    return -(-away_ns * bitrate_bps // (FRAME_BITS_MIN * _NS_PER_S))


def make_room(sock: socket.socket, frames: int) -> int:
    """Sizes a socket's receive queue for `frames`, or for as many as the system grants.

    The limit is `net.core.rmem_max`, unless the process has CAP_NET_ADMIN. Linux doubles what is
    asked for (socket(7)) and compares the doubled number with the frames' `truesize`. A queue that
    is larger already stays as it is.

    Returns:
        How many frames fit; `receive_drops` tells when that was not enough.
    """
    wanted_bytes = frames * FRAME_BYTES
    if sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) < wanted_bytes:
        try:
            sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, wanted_bytes // 2)
        except OSError:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted_bytes // 2)
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // FRAME_BYTES


def receive_drops(sock: socket.socket) -> int:
    """Frames the kernel has thrown away since the socket was made, for its queue was full.

    The counter is the one that SO_RXQ_OVFL sends along with frames. Read from SO_MEMINFO (Linux
    4.12) it is known without waiting for the next frame, and without that ancillary message, which
    python-can's receiver takes for an error.
    """
    info = sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, _MEMINFO.size)
    drops: int = _MEMINFO.unpack(info)[_MEMINFO_DROPS]
    return drops


class Arrivals:
    """When frames arrived, on a monotonic clock, from the kernel's stamps on the system's clock.

    The stamp says how old a frame is when it is read, as long as nobody sets the system's clock in
    between (NTP, a person). So the stamp is trusted only between two facts of the monotonic clock:
    a frame arrived after the queue was last known to be empty and after the frame before it, and
    it arrived before it was read. A step of the system's clock, however large, moves an arrival
    within that interval and no further, and for frames that are in the queue at that moment alone.
    A frame that the kernel has not stamped yet gets its stamp when it is read.

    Args:
        realtime: the system's clock in ns since 1970, on which the kernel stamps.
        start_ns: monotonic time of the socket's opening.
    """

    def __init__(self, realtime: Callable[[], int], start_ns: int) -> None:
        self._realtime = realtime
        self._earliest_ns = start_ns

    def received(self, stamped: Sequence[tuple[Frame, int]], now_ns: int) -> list[ReceivedFrame]:
        """Frames with their stamps, all read before `now_ns`, with their arrivals; none before the
        last."""
        # `now_ns` was read first: a pause between the two clocks makes a frame older, not younger.
        ahead_ns = self._realtime() - now_ns
        earliest_ns = self._earliest_ns
        frames: list[ReceivedFrame] = []
        for frame, stamp_ns in stamped:
            arrival_ns = stamp_ns - ahead_ns
            if arrival_ns > earliest_ns:
                earliest_ns = arrival_ns if arrival_ns < now_ns else now_ns
            frames.append(ReceivedFrame(earliest_ns, frame))
        self._earliest_ns = earliest_ns
        return frames

    def was_empty(self, asked_ns: int) -> None:
        """The queue turned out to be empty when it was asked for a frame, not before `asked_ns`."""
        self._earliest_ns = max(self._earliest_ns, asked_ns)
