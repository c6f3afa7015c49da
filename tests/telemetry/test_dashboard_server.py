"""The dashboard's server over real sockets: who is answered what."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Coroutine, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest, HTTPResponse
from tornado.websocket import WebSocketClientConnection, websocket_connect

from telemetry.dashboard.control import Action
from telemetry.dashboard.hub import CLIENTS_MAX
from telemetry.dashboard.server import MESSAGE_BYTES_MAX, DashboardError, listen
from tests.telemetry.dashboard_rig import TOKEN
from tests.telemetry.dashboard_served import Served

ANSWER_S_MAX = 30.0


@pytest.fixture
def served() -> Iterator[Served]:
    with Served() as served:
        yield served


def run(coroutine: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(coroutine, 2 * ANSWER_S_MAX))


async def get(served: Served, path: str, **headers: str) -> HTTPResponse:
    return await AsyncHTTPClient().fetch(
        HTTPRequest(f"http://{served.host}{path}", headers=headers), raise_error=False
    )


async def opened(served: Served, **headers: str) -> WebSocketClientConnection:
    headers = {"Origin": f"http://{served.host}", **headers}
    return await websocket_connect(HTTPRequest(f"ws://{served.host}/bus", headers=headers))


@asynccontextmanager
async def connected(served: Served, **headers: str) -> AsyncIterator[WebSocketClientConnection]:
    connection = await opened(served, **headers)
    try:
        yield connection
    finally:
        connection.close()
        await ended(connection)


async def ended(connection: WebSocketClientConnection) -> None:
    """Reads until there is no more."""
    while await asyncio.wait_for(connection.read_message(), ANSWER_S_MAX) is not None:
        pass
    connection.close()


async def next_with(connection: WebSocketClientConnection, key: str) -> dict[str, Any]:
    """The next message that has a key."""
    while True:
        text = await asyncio.wait_for(connection.read_message(), ANSWER_S_MAX)
        assert text is not None, f"closed before {key}"
        message: dict[str, Any] = json.loads(text)
        if key in message:
            return message


def test_the_page_is_served_with_headers_that_keep_others_out(served: Served) -> None:
    async def ask() -> None:
        for path, kind in (
            ("/", "text/html"), ("/main.js", "javascript"), ("/style.css", "text/css"),
            ("/uplot.min.js", "javascript"), ("/icon.svg", "image/svg+xml"),
        ):  # fmt: skip
            answer = await get(served, path)
            assert answer.code == 200 and kind in answer.headers["Content-Type"], path
            assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
            assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
            assert answer.headers["X-Content-Type-Options"] == "nosniff"

    run(ask())


def test_nothing_else_is_served(served: Served) -> None:
    async def ask() -> None:
        for path in ("/server.py", "/../server.py", "/%2e%2e/server.py", "/..%2fserver.py", "/x"):
            answer = await get(served, path)
            assert answer.code in (403, 404), path

    run(ask())


def test_a_foreign_name_for_this_machine_is_refused(served: Served) -> None:
    async def ask() -> None:
        assert (await get(served, "/", Host="evil.example")).code == 403
        assert (await get(served, "/", Host=f"localhost:{served.port}")).code == 200
        with pytest.raises(HTTPClientError, match="403"):
            await opened(served, Host="evil.example", Origin="http://evil.example")

    run(ask())


def test_a_page_of_another_origin_or_of_none_gets_no_connection(served: Served) -> None:
    async def ask() -> None:
        for origin in ("http://evil.example", "null", "http://localhost:1", "http://127.0.0.1"):
            with pytest.raises(HTTPClientError, match="403"):
                await opened(served, Origin=origin)
        with pytest.raises(HTTPClientError, match="403"):
            await websocket_connect(f"ws://{served.host}/bus")

    run(ask())


def test_news_come_without_a_token_and_actions_with_it(served: Served) -> None:
    async def ask() -> None:
        async with connected(served) as connection:
            assert (await next_with(connection, "hello"))["hello"]["vehicle"] == "tabby_evo"
            first = await next_with(connection, "news")
            assert first["anew"]
            await connection.write_message('{"do": "emergency_brake"}')
            assert "token" in (await next_with(connection, "refused"))["refused"]
            await connection.write_message(json.dumps({"do": "show_token", "token": TOKEN}))
            assert (await next_with(connection, "control"))["control"]
            await connection.write_message('{"do": "reset"}')
            while Action.RESET not in served.controls.done:
                await next_with(connection, "news")
            served.controls.refusal = "not now"
            await connection.write_message('{"do": "reset"}')
            assert (await next_with(connection, "refused"))["refused"] == "not now"

    run(ask())


def test_what_was_held_is_let_go_when_the_connection_breaks(served: Served) -> None:
    async def ask() -> None:
        async with connected(served) as connection:
            await connection.write_message(json.dumps({"do": "show_token", "token": TOKEN}))
            await connection.write_message('{"do": "hold", "speed_mps": 2.0}')
            while not served.controls.wishes:
                await next_with(connection, "news")
        async with connected(served) as watcher:
            while len(served.controls.wishes) < 2:
                await next_with(watcher, "news")
            assert [wish.speed_mps for wish in served.controls.wishes] == [2.0, 0.0]

    run(ask())


def test_a_message_that_is_too_long_ends_the_connection(served: Served) -> None:
    async def ask() -> None:
        connection = await opened(served)
        await connection.write_message("x" * (MESSAGE_BYTES_MAX + 1))
        await ended(connection)

    run(ask())


def test_one_browser_too_many_is_told_so(served: Served) -> None:
    async def ask() -> None:
        async with AsyncExitStack() as stack:
            for _ in range(CLIENTS_MAX):
                connection = await stack.enter_async_context(connected(served))
                await next_with(connection, "hello")
            refused = await opened(served)
            await ended(refused)
            assert refused.close_code == 1013

    run(ask())


def test_a_port_that_is_taken_is_told_in_one_line(served: Served) -> None:
    with pytest.raises(DashboardError, match=rf"cannot listen on 127\.0\.0\.1 port {served.port}"):
        listen("127.0.0.1", served.port)
    with pytest.raises(DashboardError, match="cannot listen on no-such-name"):
        listen("no-such-name.invalid", 0)
