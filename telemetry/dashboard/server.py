"""The web server of the dashboard: a page, a WebSocket, and the clock that drives both."""

from __future__ import annotations

import asyncio
import functools
import socket
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, Protocol

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from canbus.heard import Heard
from telemetry.dashboard.access import Access
from telemetry.dashboard.control import Controls, Refused
from telemetry.dashboard.hub import Client, Hub
from telemetry.dashboard.picture import Picture, Values

PAGE: Final = Path(__file__).parent / "page"
STEP_NS: Final = 50_000_000
"""Browsers are sent what has changed 20 times a second."""
NS_PER_S: Final = 1_000_000_000
MESSAGE_BYTES_MAX: Final = 4_096
PING_S: Final = 5
ACTIONS_AT_ONCE: Final = 4
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Server": "dbw",
}


class DashboardError(Exception):
    """The dashboard cannot be served; one line that says why."""


class Ears(Protocol):
    """What hears the bus, of `canbus.listener`."""

    def hear(self, timeout_ns: int) -> list[Heard]:
        """What waits."""
        ...

    def notes(self) -> list[str]:
        """What happened to the channel."""
        ...


class _Checked(RequestHandler):
    """Refuses requests under a name that is not ours; says little about itself."""

    def initialize(self, access: Access) -> None:
        """Called by tornado."""
        self._access = access

    def set_default_headers(self) -> None:
        """Called by tornado."""
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Called by tornado before any answer."""
        if not self._access.is_own_host(self.request.host):
            raise HTTPError(403, reason="unknown host name: see --name")


class _Page(_Checked, StaticFileHandler):
    """The files of the page."""

    def initialize(self, access: Access) -> None:  # type: ignore[override]
        """Called by tornado."""
        _Checked.initialize(self, access)
        StaticFileHandler.initialize(self, str(PAGE), "index.html")


class _Socket(_Checked, WebSocketHandler):
    """One browser's connection."""

    def initialize(self, access: Access, hub: Hub, clock: Callable[[], int]) -> None:  # type: ignore[override]
        """Called by tornado."""
        super().initialize(access)
        self._hub = hub
        self._clock = clock
        self._sending: asyncio.Future[None] | None = None
        self._client = Client(self._send, self._is_busy, self.close)

    def check_origin(self, origin: str) -> bool:
        """Whether the page that connects is ours."""
        return self._access.is_own_origin(origin, self.request.host)

    async def get(self, *args: Any, **kwargs: Any) -> None:
        """As tornado's, but a connection without an Origin is none of a page's."""
        if "Origin" not in self.request.headers:
            raise HTTPError(403, reason="no Origin")
        await super().get(*args, **kwargs)

    def open(self, *args: str, **kwargs: str) -> None:
        """Called by tornado."""
        self.set_nodelay(True)
        if not self._hub.open(self._client):
            self.close(1013, "too many browsers")

    def on_message(self, message: str | bytes) -> None:
        """Called by tornado."""
        self._hub.take(self._client, message, self._clock())

    def on_close(self) -> None:
        """Called by tornado."""
        self._hub.close(self._client)

    def _is_busy(self) -> bool:
        return self._sending is not None and not self._sending.done()

    def _send(self, text: str) -> None:
        try:
            sending = self.write_message(text)
        except WebSocketClosedError:
            return  # `on_close` follows
        self._sending = asyncio.ensure_future(sending)
        self._sending.add_done_callback(_forget_closed)


def _forget_closed(sending: asyncio.Future[None]) -> None:
    """A connection that broke while it was sent something is told by `on_close`."""
    if not sending.cancelled():
        error = sending.exception()
        assert error is None or isinstance(error, WebSocketClosedError | StreamClosedError)


class Server:
    """Serves one bus until it is told to end.

    Args:
        listener: Hears the bus, open.
        picture: Of the bus.
        controls: What can be done.
        access: Who may.
        about: What a page is told once.
        clock: Monotonic time in ns.
        realtime: The system's clock in ns since 1970, on which frames are stamped.
        also_feed: Gets every frame too.
    """

    def __init__(
        self,
        *,
        listener: Ears,
        picture: Picture,
        controls: Controls,
        access: Access,
        about: Values,
        clock: Callable[[], int],
        realtime: Callable[[], int],
        also_feed: Callable[[list[Heard]], None] = lambda heard: None,
    ) -> None:
        self._also_feed = also_feed
        self._listener = listener
        self._picture = picture
        self._access = access
        self._clock = clock
        self._realtime = realtime
        self._actions = ThreadPoolExecutor(ACTIONS_AT_ONCE, thread_name_prefix="dashboard-action")
        self.hub = Hub(picture, access, controls, self._start, about)

    async def serve(self, listening: socket.socket, is_over: Callable[[], bool]) -> None:
        """Answers on a listening socket, and closes it in the end."""
        page = {"access": self._access}
        application = Application(
            [
                (r"/bus", _Socket, {**page, "hub": self.hub, "clock": self._clock}),
                (r"/(.*)", _Page, page),
            ],
            websocket_ping_interval=PING_S,
            websocket_max_message_size=MESSAGE_BYTES_MAX,
            log_function=lambda handler: None,
        )
        server = HTTPServer(application)
        server.add_socket(listening)
        try:
            due_ns = self._clock()
            while not is_over():
                self.step()
                due_ns = max(due_ns + STEP_NS, self._clock())
                await _until(due_ns, self._clock)
        finally:
            server.stop()
            for client in list(self.hub.clients):
                client.close()
                self.hub.close(client)
            await server.close_all_connections()
            self._actions.shutdown(wait=False, cancel_futures=True)

    def step(self) -> None:
        """Reads what the bus has brought, and tells the browsers."""
        heard = self._listener.hear(0)
        now_ns = self._clock()
        self._picture.feed(heard, now_ns, now_ns - self._realtime())
        self._also_feed(heard)
        for note in self._listener.notes():
            self._picture.say(now_ns, "bus", note)
        self.hub.step(now_ns)

    def _start(self, run: Callable[[], None], done: Callable[[str], None]) -> None:
        """Runs an action in a thread, and answers in this one."""
        future = asyncio.get_running_loop().run_in_executor(self._actions, run)
        future.add_done_callback(functools.partial(_tell_outcome, done))


def _tell_outcome(done: Callable[[str], None], future: asyncio.Future[None]) -> None:
    if future.cancelled():
        return
    error = future.exception()
    if error is not None and not isinstance(error, Refused):
        raise error
    done("" if error is None else str(error))


async def _until(time_ns: int, clock: Callable[[], int]) -> None:
    """Waits on the event loop."""
    loop = asyncio.get_running_loop()
    waiting = loop.create_future()
    wait_s = max(0, time_ns - clock()) / NS_PER_S
    handle = loop.call_later(wait_s, waiting.set_result, None)
    try:
        await waiting
    finally:
        handle.cancel()


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens; port 0 takes a free one.

    Raises:
        DashboardError: It cannot.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        sock = socket.create_server(address[:2], family=family)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0]
        raise DashboardError(f"cannot listen on {host} port {port}: {reason}") from error
    sock.setblocking(False)
    return sock
