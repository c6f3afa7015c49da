"""The bus live in Foxglove: a channel and a JSON schema for each message of the DBC.

Read-only. What nobody has subscribed to is not decoded.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any, Final, Self

from foxglove import Channel, Context, start_server
from foxglove.websocket import WebSocketServer

from canbus.heard import Heard
from telemetry.dashboard.server import DashboardError
from telemetry.databases import load_databases
from telemetry.decode.export import NAME_SUFFIX
from telemetry.monitor.known import Catalogue, Known
from telemetry.monitor.protection import Protection
from telemetry.schemas import VERDICT, schema_of

JSON: Final = "json"


class FoxgloveServer:
    """A WebSocket of Foxglove's protocol; open within `with`.

    Args:
        bus: Name of the bus, the beginning of every topic: `/can0/STEER_STATUS`.
        host: Address to listen on.
        port: 0 takes a free one.
    """

    def __init__(self, bus: str, host: str, port: int) -> None:
        self._host = host
        self._port = port
        self._context = Context()
        self._known: dict[int, Known] = Catalogue().messages
        self._channels: dict[int, Channel] = {}
        self._checks: dict[int, Protection] = {}
        for message in load_databases().messages:
            known = self._known[message.frame_id]
            if known.data_id is not None:
                self._checks[message.frame_id] = Protection(known.data_id)
            self._channels[message.frame_id] = Channel(
                f"/{bus}/{message.name}",
                schema=schema_of(message, has_verdict=known.data_id is not None),
                message_encoding=JSON,
                context=self._context,
                metadata={"id": f"0x{message.frame_id:X}", "sender": known.sender or ""},
            )
        self._server: WebSocketServer | None = None

    def __enter__(self) -> Self:
        """Begins to listen.

        Raises:
            DashboardError: It cannot.
        """
        try:
            self._server = start_server(
                name="can-by-wire", host=self._host, port=self._port, context=self._context
            )
        except Exception as error:  # the library has its own, and runtime errors
            where = f"{self._host} port {self._port}"
            raise DashboardError(f"--foxglove: cannot listen on {where}: {error}") from error
        return self

    def __exit__(self, *exception: object) -> None:
        """Ends it."""
        if self._server is not None:
            self._server.stop()

    @property
    def port(self) -> int:
        """Where it listens."""
        assert self._server is not None
        return int(self._server.port)

    def feed(self, heard: Sequence[Heard]) -> None:
        """Frames in order of time, stamped with the system's time."""
        channels, checks = self._channels, self._checks
        for item in heard:
            channel = channels.get(item.word)
            if channel is None:
                continue
            check = checks.get(item.word)
            if check is not None:
                check.take(item.data)
            if channel.has_sinks():
                channel.log(json.dumps(self._values(item, check)), log_time=item.time_ns)

    def _values(self, item: Heard, check: Protection | None) -> dict[str, Any]:
        """What a frame says; of one that cannot be believed, why not."""
        values: dict[str, Any] = {} if check is None else {VERDICT: check.state.name.lower()}
        for signal in self._known[item.word].read(item.data).values:
            if isinstance(signal.value, str):
                values[f"{signal.name}{NAME_SUFFIX}"] = signal.value
            number = signal.number
            if math.isfinite(number):
                values[signal.name] = int(number) if number.is_integer() else number
        return values
