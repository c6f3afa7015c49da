"""A CAN bus between processes for tests: datagram sockets in a folder, named by the channel.

Also a small command line, `python -m tests.runtime.folder_bus ecu NAME --interface ...`, which runs
one node of a stack on it. Stands in for SocketCAN on kernels without it.
"""

from __future__ import annotations

import argparse
import errno
import os
import select
import socket
import struct
import sys
import uuid
from pathlib import Path
from typing import Any

import can
from can.interfaces import BACKENDS

from canbus.node import Event
from runtime.node_process import run_node_process
from runtime.nodes import PLANT
from runtime.plant_process import run_plant_process
from runtime.process_settings import ProcessSettings

NAME = "folder"
_HEADER = struct.Struct("<I")


class FolderBus(can.BusABC):
    """Sends each frame to every other socket in the folder; data frames alone."""

    def __init__(self, channel: str, can_filters: Any = None, **options: Any) -> None:
        self._folder = Path(channel)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._path = self._folder / uuid.uuid4().hex[:12]
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(str(self._path))
        super().__init__(channel=channel, can_filters=can_filters)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        packet = _HEADER.pack(msg.arbitration_id) + bytes(msg.data)
        for path in os.listdir(self._folder):
            if path != self._path.name:
                self._send_to(str(self._folder / path), packet)

    def _send_to(self, path: str, packet: bytes) -> None:
        try:
            self._socket.sendto(packet, path)
        except OSError as error:  # its owner is dead, or does not read
            if error.errno in (errno.ECONNREFUSED, errno.ENOENT):
                Path(path).unlink(missing_ok=True)
            elif error.errno != errno.EAGAIN:
                raise

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        readable, _, _ = select.select([self._socket], [], [], timeout)
        if not readable:
            return None, False
        packet = self._socket.recv(64)
        (can_id,) = _HEADER.unpack_from(packet)
        data = packet[_HEADER.size :]
        return can.Message(arbitration_id=can_id, data=data, is_extended_id=False), False

    def shutdown(self) -> None:
        super().shutdown()
        self._socket.close()
        self._path.unlink(missing_ok=True)


def register() -> None:
    """Makes the interface known to python-can in this process."""
    BACKENDS[NAME] = ("tests.runtime.folder_bus", "FolderBus")
    can.VALID_INTERFACES = frozenset({*can.VALID_INTERFACES, NAME})


def _say(event: Event) -> None:
    sys.stderr.write(f"{event.node}: {event.text}\n")


def main() -> int:
    """Runs one node until it is told to end."""
    parser = argparse.ArgumentParser()
    parser.add_argument("verb")
    parser.add_argument("name")
    for option in ("interface", "channel", "harness-channel", "vehicle"):
        parser.add_argument(f"--{option}", required=True)
    given, _ = parser.parse_known_args()  # the real-time options are for the real command line
    register()
    settings = ProcessSettings(
        name=given.name,
        vehicle=given.vehicle,
        interface=given.interface,
        channel=given.channel,
        harness_channel=given.harness_channel,
    )
    run = run_plant_process if given.name == PLANT else run_node_process
    return run(settings, _say).exit_code


if __name__ == "__main__":
    sys.exit(main())
