"""A `dbw` that serves its page, in a process of its own, and the WebSocket as a browser has it."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any, Protocol, Self

from tornado.httpclient import HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from runtime.clock import NS_PER_S, monotonic_ns

START = re.compile(r"with controls: (?P<url>http://(?P<host>localhost:\d+)/#token=(?P<token>\S+))")
READ_S_MAX = 20.0
END_S_MAX = 60.0
HOLD_NS = 100_000_000
"""How often a page repeats what is held."""


class Server(Protocol):
    """What is needed of a `subprocess.Popen`."""

    stdout: Any
    returncode: int | Any

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: Any) -> None: ...
    def wait(self, timeout: float | None = None) -> int: ...
    def send_signal(self, number: int, /) -> None: ...
    def kill(self) -> None: ...


def new_python(arguments: list[str], stderr: IO[bytes]) -> Server:
    """A `dbw` as a user starts it."""
    command = [sys.executable, "-m", "dbw", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)


Start = Callable[[list[str], IO[bytes]], Server]
"""Starts `dbw` with arguments, its standard output a pipe, its standard error kept."""


@contextmanager
def served(
    arguments: list[str], output: Path, start: Start = new_python
) -> Iterator[tuple[Server, re.Match[str]]]:
    """A `dbw` that serves its page, and START as it printed it; ended by Ctrl-C if it has not.

    Args:
        arguments: Of `dbw`; the port is best 0.
        output: What it says on standard error is kept there.
        start: How it is started.
    """
    with output.open("wb") as sink, start(arguments, sink) as process:
        try:
            found = None
            while found is None:
                line = process.stdout.readline()
                assert line, output.read_text()
                found = START.search(line)
            yield process, found
        finally:
            process.send_signal(signal.SIGINT)  # which one that has ended does not get
            try:
                process.wait(END_S_MAX)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
    assert process.returncode == 0, output.read_text()


class Page:
    """A page that watches; `with` starts what serves it, as `served`, and ends it.

    Attributes:
        shown: Every value of the page, by name.
        log: Its log's texts.
        refused: Why something was refused, last.
    """

    def __init__(self, arguments: list[str], output: Path, start: Start = new_python) -> None:
        self._served = served(arguments, output, start)
        self.shown: dict[str, Any] = {}
        self.log: list[str] = []
        self.refused = ""

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            self._loop = asyncio.new_event_loop()
            opened.callback(self._loop.close)
            self._process, found = opened.enter_context(self._served)
            self._socket = self._loop.run_until_complete(_open(found["host"]))
            opened.callback(lambda: self._loop.run_until_complete(_close(self._socket)))
            self.say("show_token", token=found["token"])
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._opened.__exit__(*exception)

    def wait(self) -> None:
        """Until it ends by itself; reads all it says meanwhile."""
        self._process.stdout.read()
        self._process.wait(END_S_MAX)

    def say(self, do: str, **more: Any) -> None:
        """What a page sends."""
        text = json.dumps({"do": do, **more})
        self._loop.run_until_complete(_send(self._socket, text))

    def until(
        self, is_so: Callable[[], bool], limit_s: float, held: dict[str, float] | None = None
    ) -> None:
        """Reads what the page is sent until something is so; meanwhile holds what is held."""
        deadline_ns = monotonic_ns() + round(limit_s * NS_PER_S)
        due_ns = 0
        while not is_so():
            now_ns = monotonic_ns()
            assert now_ns < deadline_ns, f"not within {limit_s:g} s\n{self.shown}\n{self.log}"
            if held is not None and now_ns >= due_ns:
                self.say("hold", **held)
                due_ns = now_ns + HOLD_NS
            self._take(self._loop.run_until_complete(_read(self._socket)))

    def _take(self, message: dict[str, Any]) -> None:
        self.refused = message.get("refused", self.refused)
        news = message.get("news", {})
        self.log += [line["text"] for line in news.get("log", [])]
        self.shown |= news


async def _open(host: str) -> WebSocketClientConnection:
    request = HTTPRequest(f"ws://{host}/bus", headers={"Origin": f"http://{host}"})
    return await websocket_connect(request)


async def _close(socket: WebSocketClientConnection) -> None:
    """In its loop: tornado's future for what is written would make another, that nobody closes."""
    socket.close()


async def _send(socket: WebSocketClientConnection, text: str) -> None:
    await socket.write_message(text)


async def _read(socket: WebSocketClientConnection) -> dict[str, Any]:
    text = await asyncio.wait_for(socket.read_message(), READ_S_MAX)
    assert isinstance(text, str), "the dashboard closed the connection"
    message: dict[str, Any] = json.loads(text)
    return message
