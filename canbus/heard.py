"""A frame of whatever kind as a listener hears it: the channel, the system's time, every flag.

Nodes want `canbus.frame.Frame`; who watches a bus or keeps a log wants what that leaves out. The
identifier carries its flags as in linux/can.h, so candump's filters and logs mean the same here.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from canbus.frame import CAN_ID_MAX, Frame, FrameKind

EXTENDED_FLAG: Final = 0x8000_0000
REMOTE_FLAG: Final = 0x4000_0000
ERROR_FLAG: Final = 0x2000_0000
EXTENDED_ID_MAX: Final = 0x1FFF_FFFF

ERROR_CLASSES_ALL: Final = 0x1FFF_FFFF
"""Mask of error frames of every class (linux/can/error.h)."""
ANY: Final = "any"
"""Channel that stands for all of SocketCAN's, as candump has it."""

FD_BIT_RATE_SWITCH: Final = 0x01
FD_ERROR_STATE: Final = 0x02

CLASSICAL: Final = -1
"""`fd_flags` of a frame that is none of CAN FD's."""


class Heard(NamedTuple):
    """One frame on one channel.

    Attributes:
        time_ns: System time in ns since 1970, the kernel's stamp where there is one.
        channel: Name of the interface.
        word: Identifier with the flags of linux/can.h; of an error frame, its classes.
        data: Content; empty for a remote frame.
        length: Data length; of a remote frame, the length that it asks for.
        fd_flags: FD_BIT_RATE_SWITCH and FD_ERROR_STATE of a CAN FD frame, else CLASSICAL.
        is_sent: Whether this computer has sent it.
    """

    time_ns: int
    channel: str
    word: int
    data: bytes
    length: int
    fd_flags: int = CLASSICAL
    is_sent: bool = False

    @property
    def can_id(self) -> int:
        """The identifier alone."""
        return self.word & EXTENDED_ID_MAX

    @property
    def is_extended(self) -> bool:
        """Whether the identifier has 29 bits."""
        return bool(self.word & EXTENDED_FLAG)

    @property
    def is_remote(self) -> bool:
        """Whether the frame asks for data."""
        return bool(self.word & REMOTE_FLAG)

    @property
    def is_error(self) -> bool:
        """Whether it is no frame but the controller's report of an error."""
        return bool(self.word & ERROR_FLAG)

    @property
    def is_fd(self) -> bool:
        """Whether it is a CAN FD frame."""
        return self.fd_flags != CLASSICAL

    def frame(self) -> Frame:
        """As nodes know it. A remote frame with a 29-bit identifier is called EXTENDED there."""
        if self.word <= CAN_ID_MAX and self.fd_flags == CLASSICAL:
            return Frame(self.word, self.data)
        if self.is_error:
            return Frame(self.can_id, self.data, FrameKind.ERROR)
        if self.is_fd:
            return Frame(self.can_id, self.data, FrameKind.FD)
        kind = FrameKind.EXTENDED if self.is_extended else FrameKind.REMOTE
        return Frame(self.can_id, self.data, kind)
