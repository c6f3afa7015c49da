"""The live channels of Foxglove, read by a client of its WebSocket protocol."""

from __future__ import annotations

import asyncio
import json
import struct
from typing import Any

import pytest
from tornado.httpclient import HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from dbc.messages import SPECS, Mode
from telemetry.dashboard.foxglove_server import FoxgloveServer
from telemetry.dashboard.server import DashboardError
from tests.telemetry.dashboard_rig import CarOnBus
from tests.telemetry.monitored import S

PROTOCOL = "foxglove.sdk.v1"
ANSWER_S_MAX = 30.0
MESSAGE_DATA = struct.Struct("<BIQ")
"""Op code 1, number of the subscription, time in ns; the payload follows."""


async def connect(server: FoxgloveServer) -> WebSocketClientConnection:
    request = HTTPRequest(f"ws://127.0.0.1:{server.port}/")
    return await websocket_connect(request, subprotocols=[PROTOCOL])


async def next_of(connection: WebSocketClientConnection, is_it: Any) -> Any:
    """The next message, text as an object and data as bytes, that is wanted."""
    while True:
        item = await asyncio.wait_for(connection.read_message(), ANSWER_S_MAX)
        assert item is not None
        message = json.loads(item) if isinstance(item, str) else item
        if is_it(message):
            return message


async def advertised(connection: WebSocketClientConnection) -> dict[str, dict[str, Any]]:
    """Channels by topic, until there is one for each message."""
    channels: dict[str, dict[str, Any]] = {}
    while len(channels) < len(SPECS):
        message = await next_of(
            connection, lambda m: isinstance(m, dict) and m["op"] == "advertise"
        )
        channels |= {channel["topic"]: channel for channel in message["channels"]}
    return channels


async def value_of(
    server: FoxgloveServer, connection: WebSocketClientConnection, number: int, car: CarOnBus
) -> tuple[int, dict[str, Any]]:
    """Drives until a subscription brings a value; its time and content."""

    def is_wanted(message: Any) -> bool:
        return isinstance(message, bytes) and MESSAGE_DATA.unpack_from(message)[:2] == (1, number)

    waiting = asyncio.ensure_future(next_of(connection, is_wanted))
    for cycle in range(10_000):
        server.feed(car.frames(S + cycle * 10_000_000))
        if (await asyncio.wait({waiting}, timeout=0.01))[0]:
            break
    _, _, time_ns = MESSAGE_DATA.unpack_from(waiting.result())
    return time_ns, json.loads(waiting.result()[MESSAGE_DATA.size :])


def test_a_client_sees_a_channel_for_each_message_and_gets_decoded_values() -> None:
    car = CarOnBus(mode=Mode.READY, wheel_rad=0.5)

    async def watch(server: FoxgloveServer) -> None:
        connection = await connect(server)
        channels = await advertised(connection)
        assert set(channels) == {f"/can0/{spec.name}" for spec in SPECS.values()}
        for number, name, signal, want in (
            (1, "STEER_STATUS", "steering_wheel_angle_rad", 0.5),
            (2, "SUPERVISOR_STATE", "mode", Mode.READY),
        ):
            channel = channels[f"/can0/{name}"]
            assert channel["encoding"] == "json"
            subscription = {"id": number, "channelId": channel["id"]}
            await connection.write_message(
                json.dumps({"op": "subscribe", "subscriptions": [subscription]})
            )
            time_ns, values = await value_of(server, connection, number, car)
            schema = json.loads(channel["schema"])["properties"]
            assert set(values) <= set(schema), "what the schema does not know nobody can plot"
            assert values[signal] == pytest.approx(want, abs=0.01) and time_ns >= S
            assert values["verdict"] in schema["verdict"]["enum"]
            await connection.write_message(
                json.dumps({"op": "unsubscribe", "subscriptionIds": [number]})
            )
        assert values["mode_name"] == "READY"
        connection.close()
        while await asyncio.wait_for(connection.read_message(), ANSWER_S_MAX) is not None:
            pass

    with FoxgloveServer("can0", "127.0.0.1", 0) as server:
        asyncio.run(watch(server))


def test_a_port_that_is_taken_is_told_in_one_line() -> None:
    with FoxgloveServer("can0", "127.0.0.1", 0) as server:
        said = f"--foxglove: cannot listen on 127.0.0.1 port {server.port}"
        with pytest.raises(DashboardError, match=said):
            FoxgloveServer("can0", "127.0.0.1", server.port).__enter__()
