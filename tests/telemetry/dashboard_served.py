"""A dashboard that is served, on a bus and a car made for tests, in a thread of its own."""

from __future__ import annotations

import asyncio
import threading
from typing import Self

from canbus.heard import Heard
from runtime.clock import monotonic_ns, realtime_ns
from telemetry.dashboard.access import Access
from telemetry.dashboard.picture import HumanClock, Picture
from telemetry.dashboard.server import Server, listen
from tests.telemetry.dashboard_rig import BITRATE_BPS, TOKEN, CarOnBus, FakeControls
from vehicles import load_vehicle

JOIN_S_MAX = 30.0


class Ears:
    """Hears the car on its bus."""

    def __init__(self, car: CarOnBus) -> None:
        self._car = car

    def hear(self, timeout_ns: int) -> list[Heard]:
        """Everything since the last call."""
        return self._car.frames(realtime_ns())

    def notes(self) -> list[str]:
        """Nothing happens to it."""
        return []


class Served:
    """Answers on a port of this machine while in `with`; may be entered again, on the same port.

    Attributes:
        car: What the bus is to tell.
        controls: What has been asked for.
    """

    def __init__(self) -> None:
        self.car = CarOnBus()
        self.controls = FakeControls()
        self.port = 0
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def host(self) -> str:
        """As browsers name it."""
        return f"localhost:{self.port}"

    def url(self, token: str = TOKEN) -> str:
        """The page's address, with a token."""
        return f"http://{self.host}/#token={token}"

    def __enter__(self) -> Self:
        listening = listen("127.0.0.1", self.port)
        self.port = int(listening.getsockname()[1])
        clock = HumanClock(
            unix_s=lambda ns: (realtime_ns() - monotonic_ns() + ns) / 1e9,
            text=lambda ns: f"{ns / 1e9:.3f}",
        )
        server = Server(
            listener=Ears(self.car),
            picture=Picture(load_vehicle("tabby_evo"), "can0", BITRATE_BPS, clock),
            controls=self.controls,
            access=Access(TOKEN),
            about={
                "vehicle": "tabby_evo", "bus": "test can0", "wheel_rad_max": 9.25,
                "speed_mps_max": 10.0,
            },
            clock=monotonic_ns,
            realtime=realtime_ns,
        )  # fmt: skip
        self._ended.clear()
        self._thread = threading.Thread(
            target=lambda: asyncio.run(server.serve(listening, self._ended.is_set))
        )
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        assert self._thread is not None
        self._ended.set()
        self._thread.join(JOIN_S_MAX)
        assert not self._thread.is_alive()
