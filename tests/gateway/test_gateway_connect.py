"""The gateway on a real bus: arguments, and the thread on python-can's virtual bus."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from canbus.bus import BusError
from canbus.canopen_protocol import NmtCommand, nmt_frame
from canbus.frame import Frame, ReceivedFrame
from canbus.node import EventKind
from canbus.python_can_bus import PythonCanBus
from dbc.codec import Decoded, decode
from dbc.messages import Mode, Request
from gateway.api import AsyncCar, Car
from gateway.commands import CommandError
from gateway.connect import BusLink, connect, connect_async
from gateway.core import PlannerInputs
from gateway.errors import LinkFailed, NotConnected
from tests.gateway.scripted import MS, SENDER, TABBY, Rig
from vehicles.vehicle import VehicleError

CHANNEL = "gateway-tests"


@pytest.mark.parametrize("make", [connect, connect_async])
@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"interface": 3}, TypeError, "^interface = 3: a text is wanted$"),
        ({"channel": None}, TypeError, "^channel = None: a text is wanted$"),
        ({"channel": ""}, CommandError, "^channel = '': a non-empty text is wanted$"),
        ({"vehicle": "batmobile"}, VehicleError, "^vehicle 'batmobile' is not known: allowed "),
        ({"vehicle": 7}, TypeError, "^vehicle = 7: a vehicle's name or a Vehicle is wanted$"),
        ({"planner_period_s": 0.001}, CommandError, "^planner_period_s = 0.001: allowed 0.01 to"),
        ({"planner_period_s": "20ms"}, TypeError, "^planner_period_s = '20ms': a number"),
        ({"bitrate_bps": 1}, CommandError, "^bitrate_bps = 1.0: allowed 10000 to 1e\\+06 bit/s$"),
        ({"bitrate_bps": True}, TypeError, "^bitrate_bps = True: a number is wanted"),
    ],
)
def test_wrong_argument_is_refused_in_one_line(
    make: Any, arguments: dict[str, Any], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text) as raised:
        make(**arguments)
    assert "\n" not in str(raised.value)


def test_unknown_interface_is_refused_in_one_line_when_opened() -> None:
    with pytest.raises(BusError, match="unknown interface name") as raised, connect("telepathy"):
        pytest.fail("never entered")
    assert "\n" not in str(raised.value)


def test_defaults_make_a_car_and_open_nothing() -> None:
    threads = threading.active_count()
    assert isinstance(connect(), Car)
    assert isinstance(connect_async(vehicle=TABBY, bitrate_bps=250_000), AsyncCar)
    assert threading.active_count() == threads


class Partner:
    """The other end of the virtual bus: everybody else, as scripted."""

    def __init__(self) -> None:
        self.bus = PythonCanBus("virtual", CHANNEL, clock=time.monotonic_ns)
        self.rig = Rig()

    def speak(self) -> None:
        """One frame of every kind from every other node."""
        for name, content in self.rig.content.items():
            self.bus.send(self.rig.endpoints[SENDER[name]].frame(name, content))

    def start_gateway(self) -> None:
        self.bus.send(nmt_frame(NmtCommand.START, 6))
        self.speak()
        self.speak()

    def is_heard_ready(self, car: Car) -> bool:
        """Speaks, and asks: what was said is believed for 60 ms alone."""
        self.speak()
        return car.state.mode is Mode.READY

    def hear(self, name: str, timeout_s: float = 2.0) -> tuple[int, Any]:
        """The next frame of a message, with its arrival."""
        deadline_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        while time.monotonic_ns() < deadline_ns:
            for item in self.bus.receive(20 * MS):
                decoded = decode(item.frame)
                if isinstance(decoded, Decoded) and decoded.spec.name == name:
                    return item.arrival_ns, decoded.message
        raise AssertionError(f"no {name} within {timeout_s} s")


@pytest.fixture
def partner() -> Iterator[Partner]:
    partner = Partner()
    with partner.bus:
        yield partner


def link() -> BusLink:
    return BusLink("virtual", CHANNEL, vehicle=TABBY, planner_period_ns=20 * MS)


def wait_for(condition: Any, timeout_s: float = 2.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "condition not met in time"
        time.sleep(0.002)


@pytest.mark.wall_clock
def test_gateway_runs_without_a_planner(partner: Partner) -> None:
    gateway = link()
    gateway.open()
    try:
        partner.hear("GATEWAY_HEARTBEAT")
        partner.start_gateway()
        _, steer = partner.hear("STEER_COMMAND")
        assert math.isnan(steer.decision_age_ms)
        assert gateway.statistics.sent > 0
        assert any(event.kind is EventKind.NMT for event in gateway.poll_events())
        assert gateway.poll_events() == []
    finally:
        gateway.close()


@pytest.mark.wall_clock
def test_decision_leaves_from_the_call_itself(partner: Partner) -> None:
    with connect("virtual", CHANNEL) as car:
        partner.start_gateway()
        partner.hear("STEER_COMMAND")
        wait_for(lambda: partner.is_heard_ready(car))
        for _ in range(10):
            # A command right after a repetition is held back by the DBC's minimum interval.
            time.sleep(0.023)
            partner.bus.receive(0)
            car.command(speed_mps=2.0, curvature_per_m=0.05)
            decoded = [decode(item.frame) for item in partner.bus.receive(0)]
            if any(
                isinstance(d, Decoded)
                and d.spec.name == "STEER_COMMAND"
                and d.message.decision_age_ms <= 5
                for d in decoded
            ):
                return  # it was on the bus when the call returned
        pytest.fail("no command was on the bus when the call returned")


@pytest.mark.wall_clock
def test_state_follows_the_bus_and_forgets_a_silent_one(partner: Partner) -> None:
    with connect("virtual", CHANNEL) as car:
        assert car.state.mode is None
        partner.start_gateway()
        wait_for(lambda: partner.is_heard_ready(car))
        wait_for(lambda: car.state.mode is None)  # silent for 60 ms
        assert car.state.why_not_engaged.startswith("no supervisor on the bus (silent for")


@pytest.mark.wall_clock
def test_ticks_come_at_the_planners_period(partner: Partner) -> None:
    with connect("virtual", CHANNEL, planner_period_s=0.01) as car:
        start = time.monotonic()
        for tick, _ in enumerate(car.ticks()):
            if tick == 20:
                break
        assert time.monotonic() - start >= 0.199


@pytest.mark.wall_clock
def test_async_car_leaves_the_event_loop_free(partner: Partner) -> None:
    async def drive() -> int:
        beats = 0
        async with connect_async("virtual", CHANNEL) as car:

            async def beat() -> None:
                nonlocal beats
                while True:
                    await asyncio.sleep(0.005)
                    beats += 1

            beating = asyncio.create_task(beat())
            ticks = 0
            async for _ in car.ticks():
                ticks += 1
                if ticks == 10:
                    break
            beating.cancel()
        return beats

    assert asyncio.run(drive()) >= 5


@pytest.mark.wall_clock
def test_closing_joins_the_thread_and_wakes_who_waits(partner: Partner) -> None:
    gateway = link()
    gateway.open()
    far_ns = gateway.now_ns() + 60_000_000_000
    waiter = threading.Thread(target=gateway.wait_until, args=(far_ns,))
    waiter.start()
    gateway.close()
    gateway.close()
    waiter.join(timeout=2.0)
    assert not waiter.is_alive()
    assert not [thread for thread in threading.enumerate() if thread.name == "gateway"]
    with pytest.raises(NotConnected):
        gateway.state()
    with pytest.raises(NotConnected):
        gateway.submit(PlannerInputs(request=Request.ENGAGE))
    with pytest.raises(NotConnected, match="opened once"):
        gateway.open()


def test_link_that_was_never_opened_says_so_and_closes_quietly() -> None:
    gateway = link()
    with pytest.raises(NotConnected, match="not open"):
        gateway.state()
    gateway.close()


@pytest.mark.wall_clock
@pytest.mark.parametrize(
    ("error", "text"),
    [(RuntimeError("cable\ncut"), "cable cut"), (MemoryError(), "MemoryError")],
)
def test_error_in_the_thread_surfaces_on_the_next_call(
    partner: Partner, monkeypatch: pytest.MonkeyPatch, error: Exception, text: str
) -> None:
    def fail(self: PythonCanBus, timeout_ns: int) -> list[ReceivedFrame]:
        raise error

    gateway = link()
    monkeypatch.setattr(PythonCanBus, "receive", fail)
    gateway.open()
    gateway.wait_until(gateway.now_ns() + 10_000_000_000)  # ended by the failure
    asyncio.run(gateway.wait_async(gateway.now_ns() + 10_000_000_000))
    with pytest.raises(LinkFailed, match=f"^the gateway has ended: {text}$") as raised:
        gateway.state()
    assert raised.value.__cause__ is error
    with pytest.raises(LinkFailed):
        gateway.submit(PlannerInputs())
    gateway.close()


@pytest.mark.wall_clock
def test_late_cycle_is_an_overrun_that_is_counted_and_reported(
    partner: Partner, monkeypatch: pytest.MonkeyPatch
) -> None:
    receive = PythonCanBus.receive
    stalls = iter([0.0, 0.0, 0.04])

    def stall(self: PythonCanBus, timeout_ns: int) -> list[ReceivedFrame]:
        frames = receive(self, timeout_ns)
        time.sleep(next(stalls, 0.0))
        return frames

    monkeypatch.setattr(PythonCanBus, "receive", stall)
    gateway = link()
    gateway.open()
    try:
        wait_for(lambda: gateway.overruns > 0)
        overruns = [e for e in gateway.poll_events() if e.kind is EventKind.OVERRUN]
        assert overruns and overruns[0].text.startswith("a cycle began ")
    finally:
        gateway.close()


@pytest.mark.wall_clock
def test_frames_that_arrive_between_cycles_are_all_taken(partner: Partner) -> None:
    gateway = link()
    gateway.open()
    try:

        def are_all_heard() -> bool:  # for 60 ms
            partner.speak()
            time.sleep(0.003)
            return all(h.is_heard for h in gateway.state().node_health.values())

        wait_for(are_all_heard)
        partner.bus.send(Frame(0x181, b"\x00"))
        wait_for(lambda: any("ER0" in event.text for event in gateway.poll_events()))
    finally:
        gateway.close()
