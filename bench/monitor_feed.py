"""Feeds the screen of `bench.monitor`: frames of the vehicle bus as a CAN socket gives them.

    python -m bench.monitor_feed PORT|MULTICAST_GROUP FRAMES_PER_S
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator
from itertools import count

from dbc.messages import SPECS
from dbc.protection import COUNTER_MODULO, COUNTER_SHIFT, with_crc
from dbc.spec import MessageSpec

FRAME = struct.Struct("=IB3x8s")
BURST_S = 0.001


def traffic() -> Iterator[bytes]:
    """Protected messages with rising counters and a content that changes with every frame."""
    specs = [spec for spec in SPECS.values() if spec.data_id is not None and spec.cycle_ns]
    for number in count():
        for spec in specs:
            yield FRAME.pack(spec.can_id, spec.length, _content(spec, number))


def _content(spec: MessageSpec, number: int) -> bytes:
    assert spec.data_id is not None
    bits = number % COUNTER_MODULO << COUNTER_SHIFT | number % 1_000 << 32
    return with_crc(bits, spec.data_id)


def udp_sender(port: int) -> Callable[[bytes], None]:
    """Sends to a port of this machine what a CAN socket would give."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect(("127.0.0.1", port))

    def send(raw: bytes) -> None:
        with contextlib.suppress(ConnectionRefusedError):  # the screen is not there yet, or gone
            sock.send(raw)

    return send


def multicast_sender(group: str) -> Callable[[bytes], None]:
    """Sends onto a bus of python-can's."""
    import can

    bus = can.Bus(interface="udp_multicast", channel=group, ignore_config=True)

    def send(raw: bytes) -> None:
        can_id, length, data = FRAME.unpack(raw)
        bus.send(can.Message(arbitration_id=can_id, data=data[:length], is_extended_id=False))

    return send


def main() -> None:
    """Sends until it is killed."""
    where, frames_per_s = sys.argv[1], int(sys.argv[2])
    send = udp_sender(int(where)) if where.isdecimal() else multicast_sender(where)
    frames = traffic()
    start_s, sent = time.monotonic(), 0
    while True:
        due = int((time.monotonic() - start_s) * frames_per_s)
        while sent < due:
            sent += 1
            send(next(frames))
        select.select([], [], [], BURST_S)


if __name__ == "__main__":
    main()
