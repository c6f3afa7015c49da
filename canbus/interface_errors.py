"""What goes wrong with an interface: removed, or not opened and what to do about it."""

from __future__ import annotations

import errno
import socket
from collections.abc import Collection
from typing import Final

SOCKETCAN: Final = "socketcan"
"""python-can's name for Linux's own interface."""

GONE: Final = (errno.ENODEV, errno.ENXIO)
"""Errors of a socket whose device was removed (a USB adapter): it never comes back to life, not
even when the device does. One whose link is merely down does (ENETDOWN, told once)."""


def reason_not_opened(
    interface: str, channel: str, error: Exception, known: Collection[str] = (SOCKETCAN,)
) -> str:
    """One line for the user: what could not be opened, why, what to do.

    Args:
        interface: as python-can calls it.
        channel: as the user gave it.
        error: what its driver, or the kernel, has raised.
        known: the interfaces that there are.
    """
    where = f"cannot open CAN channel '{channel}' on interface '{interface}'"
    if interface not in known:
        return f"{where}: unknown interface name; known: {', '.join(sorted(known))}"
    number = getattr(error, "errno", None)
    if interface == SOCKETCAN:
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
