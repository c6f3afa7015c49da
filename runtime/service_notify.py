"""Signs of life for a service manager, and for a launcher that is one to its nodes.

The protocol is systemd's (sd_notify(3)): datagrams of `KEY=value` lines to the socket named by
$NOTIFY_SOCKET. These few lines are ours because the library for it (sdnotify) has had no release
since 2017. What they say is never a thread's or a timer's word: `alive` is called by the loop
whose life is at stake, at the end of a cycle that was done.
"""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Mapping
from contextlib import suppress
from typing import Self

READY = b"READY=1"
WATCHDOG = b"WATCHDOG=1"
STOPPING = b"STOPPING=1"

PINGS_PER_TIMEOUT = 2
"""sd_watchdog_enabled(3) asks for a ping at half the time-out."""

_NS_PER_US = 1_000
_MESSAGE_BYTES_MAX = 4_096
_CREDENTIALS = struct.Struct("@3i")
"""`struct ucred` (unix(7)): process, user, group; filled in by the kernel."""


class ServiceNotify:
    """A process's word to its service manager; says nothing when there is none.

    Args:
        environment: where $NOTIFY_SOCKET, $WATCHDOG_USEC and $WATCHDOG_PID are looked up.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        timeout_us = environment.get("WATCHDOG_USEC", "")
        is_for_us = environment.get("WATCHDOG_PID", "") in ("", str(os.getpid()))
        self._interval_ns: int | None = None
        if is_for_us and timeout_us.isdecimal():
            self._interval_ns = int(timeout_us) * _NS_PER_US // PINGS_PER_TIMEOUT
        self._pinged_ns: int | None = None

    def alive(self, now_ns: int) -> None:
        """A cycle was done: the first means ready; the watchdog is told as often as it asks."""
        if self._pinged_ns is None:
            self._send(READY + b"\n" + WATCHDOG)
        elif self._interval_ns is None or now_ns - self._pinged_ns < self._interval_ns:
            return
        else:
            self._send(WATCHDOG)
        self._pinged_ns = now_ns

    def status(self, text: str) -> None:
        """One line for a person, shown by `systemctl status`."""
        self._send(b"STATUS=" + text.replace("\n", " ").encode())

    def stopping(self) -> None:
        """The process has begun to end."""
        self._send(STOPPING)

    def _send(self, message: bytes) -> None:
        if not self._address:
            return
        # Whoever does not listen must not stop a control loop: no waiting, no error.
        with (
            suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sock,
        ):
            sock.sendto(message, self._address)


class SignsOfLife:
    """The other end: hears each child's pings and knows from the kernel whose they are.

    Args:
        timeout_ns: silence after which a child that was heard counts as hanging.
    """

    def __init__(self, timeout_ns: int) -> None:
        self._timeout_ns = timeout_ns
        self._socket: socket.socket | None = None
        self._heard_ns: dict[int, int] = {}

    def __enter__(self) -> Self:
        """Opens the socket, under a name that the kernel chooses."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._socket.bind("")
        return self

    def __exit__(self, *exception: object) -> None:
        """Closes it."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    @property
    def environment(self) -> dict[str, str]:
        """Variables by which a child finds us. They replace those of our own service manager."""
        assert self._socket is not None, "not open"
        name: bytes = self._socket.getsockname()
        return {
            "NOTIFY_SOCKET": name.replace(b"\0", b"@", 1).decode(),
            "WATCHDOG_USEC": str(self._timeout_ns // _NS_PER_US),
            "WATCHDOG_PID": "",
        }

    def listen(self, now_ns: int) -> None:
        """Takes in what the children have sent."""
        assert self._socket is not None, "not open"
        with suppress(BlockingIOError):
            while True:
                space = socket.CMSG_SPACE(_CREDENTIALS.size)
                message, ancillary, _, _ = self._socket.recvmsg(_MESSAGE_BYTES_MAX, space)
                if WATCHDOG in message.splitlines():
                    for _level, _kind, data in ancillary:
                        self._heard_ns[_CREDENTIALS.unpack(data)[0]] = now_ns

    def was_heard(self, pid: int) -> bool:
        """Whether a child has done its first cycle."""
        return pid in self._heard_ns

    def hangs(self, pid: int, now_ns: int) -> bool:
        """Whether a child that was heard has been silent for too long."""
        heard_ns = self._heard_ns.get(pid)
        return heard_ns is not None and now_ns - heard_ns > self._timeout_ns
