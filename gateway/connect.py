"""The gateway on a real bus, in wall time: the only clock, thread and I/O of this package."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque

from canbus.bus import BusStatistics
from canbus.frame import ReceivedFrame
from canbus.node import PERIOD_NS, Event, EventKind
from canbus.python_can_bus import PythonCanBus
from gateway.api import AsyncCar, Car
from gateway.commands import NS_PER_S, CommandError, checked, checked_period_ns
from gateway.core import NO_INPUTS, GatewayCore, PlannerInputs
from gateway.errors import LinkFailed, NotConnected
from gateway.state import CarState
from vehicles import Vehicle, load_vehicle

OVERRUN_NS = PERIOD_NS // 2
"""A cycle that begins later than this after its deadline is an overrun."""

EVENTS_MAX = 1000
"""Events kept for a reader; of more, the oldest go."""

BITRATE_BPS_MIN, BITRATE_BPS_MAX = 10_000, 1_000_000

SELF_TIMED_INTERFACES = frozenset({"virtual", "socketcan"})
"""Interfaces without a bit rate of their own: none at all, or set by `ip link`."""


class BusLink:
    """A gateway node on a bus, in a thread of its own. A planner is not needed.

    The thread receives without polling and steps the gateway at absolute 10 ms deadlines; a
    decision is sent at once, from the thread that gives it.

    Args:
        interface: python-can's name: "socketcan", "virtual", "pcan", ...
        channel: "vcan0", "can0", ...
        vehicle: What the gateway believes about the car.
        planner_period_ns: The period the planner promises.
        bitrate_bps: For interfaces that set it themselves; the vehicle file's by default.

    Attributes:
        overruns: Cycles that began more than 5 ms late.
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        *,
        vehicle: Vehicle,
        planner_period_ns: int,
        bitrate_bps: int | None = None,
    ) -> None:
        self._core = GatewayCore(vehicle, planner_period_ns)
        if bitrate_bps is None and interface not in SELF_TIMED_INTERFACES:
            bitrate_bps = round(vehicle.bus.bitrate_bps)
        self._bus = PythonCanBus(
            interface,
            channel,
            clock=time.monotonic_ns,
            realtime=time.time_ns,
            bitrate=bitrate_bps,
            acceptance=self._core.acceptance,
        )
        self.overruns = 0
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None
        self._events: deque[Event] = deque(maxlen=EVENTS_MAX)

    @property
    def vehicle(self) -> Vehicle:
        """What the gateway believes about the car."""
        return self._core.vehicle

    @property
    def planner_period_ns(self) -> int:
        """The period the planner has promised."""
        return self._core.planner_period_ns

    @property
    def statistics(self) -> BusStatistics:
        """The bus's counters."""
        return self._bus.statistics

    def open(self) -> None:
        """Opens the bus and starts the thread. Raises BusError when the bus cannot be opened."""
        if self._thread is not None:
            raise NotConnected("a link is opened once: make a new one")
        self._bus.__enter__()
        self._thread = threading.Thread(target=self._run, name="gateway", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops the thread and closes the bus; what waits returns. Closing twice is harmless."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
        with self._lock:
            self._bus.close()

    def now_ns(self) -> int:
        """The wall clock, monotonic."""
        return time.monotonic_ns()

    def submit(self, inputs: PlannerInputs) -> None:
        """Steps the gateway with the planner's inputs: what follows from them leaves at once."""
        with self._lock:
            self._check()
            self._step([], inputs)

    def state(self) -> CarState:
        """The car as known now."""
        with self._lock:
            self._check()
            return self._core.state(time.monotonic_ns())

    def poll_events(self) -> list[Event]:
        """What the gateway has reported since the last call, oldest first."""
        with self._lock:
            events = list(self._events)
            self._events.clear()
            return events

    def wait_until(self, time_ns: int) -> None:
        """Blocks until `time_ns`, or until the link has ended."""
        while (rest_ns := time_ns - time.monotonic_ns()) > 0 and not self._ended.is_set():
            self._ended.wait(rest_ns / NS_PER_S)

    async def wait_async(self, time_ns: int) -> None:
        """The same on the event loop."""
        while (rest_ns := time_ns - time.monotonic_ns()) > 0 and not self._ended.is_set():
            await asyncio.sleep(rest_ns / NS_PER_S)

    def _check(self) -> None:
        """Called with the lock held."""
        if self._failure is not None:
            text = " ".join(str(self._failure).split()) or type(self._failure).__name__
            raise LinkFailed(f"the gateway has ended: {text}") from self._failure
        if self._thread is None or self._ended.is_set():
            raise NotConnected("the link is not open")

    def _step(self, received: list[ReceivedFrame], inputs: PlannerInputs) -> None:
        """Called with the lock held: frames leave in the order of their counters."""
        output = self._core.step(time.monotonic_ns(), received, inputs)
        for frame in output.frames:
            self._bus.send(frame)
        self._events.extend(output.events)

    def _run(self) -> None:
        try:
            deadline_ns = time.monotonic_ns()
            while not self._ended.is_set():
                received = self._receive_until(deadline_ns)
                lateness_ns = time.monotonic_ns() - deadline_ns
                with self._lock:
                    if lateness_ns > OVERRUN_NS:
                        self._count_overrun(lateness_ns)
                    self._step(received, NO_INPUTS)
                # Absolute deadlines; those that have passed are left out, not made up for.
                deadline_ns += PERIOD_NS * (1 + max(0, lateness_ns) // PERIOD_NS)
        except BaseException as error:  # handed to the planner's thread by the next call
            self._failure = error
            self._ended.set()

    def _receive_until(self, deadline_ns: int) -> list[ReceivedFrame]:
        """Every frame up to the deadline; what waits already even when that has passed."""
        received: list[ReceivedFrame] = []
        while True:
            received += self._bus.gather(max(0, deadline_ns - time.monotonic_ns()))
            if time.monotonic_ns() >= deadline_ns or self._ended.is_set():
                return received

    def _count_overrun(self, lateness_ns: int) -> None:
        self.overruns += 1
        text = f"a cycle began {lateness_ns / 1e6:.1f} ms late"
        event = Event(
            time_ns=time.monotonic_ns(), node=self._core.name, kind=EventKind.OVERRUN, text=text
        )
        self._events.append(event)


def connect(
    interface: str = "virtual",
    channel: str = "vehicle",
    *,
    vehicle: str | Vehicle = "tabby_evo",
    planner_period_s: float = 0.02,
    bitrate_bps: int | None = None,
) -> Car:
    """A car on a CAN bus. Nothing is opened before its `with` block.

    The gateway is a thread of the planner's process: a planner that holds the interpreter, or a
    full garbage collection of its heap (0.3 s for two million objects), silences it, and the car
    brakes after 0.1 s. `gc.freeze()`, once everything is loaded, keeps collections short.

    Args:
        interface: python-can's name: "socketcan", "virtual", "pcan", ...
        channel: "vcan0", "can0"; for "virtual" the name the nodes of this process share.
        vehicle: A shipped vehicle's name, a path ending in `.toml`, or a loaded vehicle.
        planner_period_s: How often the planner promises to decide, 10 ms at least. The age at
            which its decisions no longer count follows from it.
        bitrate_bps: For interfaces that set it themselves; the vehicle file's by default.

    Raises:
        TypeError: An argument of the wrong type.
        CommandError: A value out of its range.
        VehicleError: A vehicle that is not known or cannot be used.
    """
    return Car(_bus_link(interface, channel, vehicle, planner_period_s, bitrate_bps))


def connect_async(
    interface: str = "virtual",
    channel: str = "vehicle",
    *,
    vehicle: str | Vehicle = "tabby_evo",
    planner_period_s: float = 0.02,
    bitrate_bps: int | None = None,
) -> AsyncCar:
    """As `connect`, for asyncio: opened by `async with`."""
    return AsyncCar(_bus_link(interface, channel, vehicle, planner_period_s, bitrate_bps))


def _bus_link(
    interface: object,
    channel: object,
    vehicle: object,
    planner_period_s: object,
    bitrate_bps: object,
) -> BusLink:
    for field, value in (("interface", interface), ("channel", channel)):
        if not isinstance(value, str):
            raise TypeError(f"{field} = {value!r}: a text is wanted")
        if not value:
            raise CommandError(f"{field} = '': a non-empty text is wanted")
    if isinstance(vehicle, str):
        vehicle = load_vehicle(vehicle)
    if not isinstance(vehicle, Vehicle):
        raise TypeError(f"vehicle = {vehicle!r}: a vehicle's name or a Vehicle is wanted")
    if bitrate_bps is not None:
        low, high = BITRATE_BPS_MIN, BITRATE_BPS_MAX
        bitrate_bps = round(checked("bitrate_bps", bitrate_bps, low, high, "bit/s"))
    return BusLink(
        str(interface),
        str(channel),
        vehicle=vehicle,
        planner_period_ns=checked_period_ns(vehicle, planner_period_s),
        bitrate_bps=bitrate_bps,
    )
