"""The bus in virtual time: arbitration, exact frame lengths, errors, retransmission (ISO 11898-1).

Frames win by their identifier and are never pre-empted. A frame that is disturbed, or that nobody
acknowledges, ends in an error frame and is sent again; the controllers count (`controller.py`).
A frame is heard at its end, and the next begins after the interframe space at the earliest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from heapq import heappop
from typing import Final

from canbus.frame import Frame, FrameKind
from canbus.timing import (
    DATA_BYTES_MAX,
    INTERFRAME_SPACE_BITS,
    bits_time_ns,
    frame_bits,
    frame_bits_max,
)
from dbc.endpoint import ERROR_BUS_OFF
from simulation.arbitration import Arbitration, Pending
from simulation.controller import (
    DEFAULT_SETTINGS,
    SUSPEND_BITS,
    Controller,
    ControllerSettings,
    Count,
    ErrorState,
)
from simulation.disturbance import (
    Disturbance,
    FrameError,
    collided,
    disturbed,
    foreign_format,
    found_by,
    not_acknowledged,
)
from simulation.kernel import Action, Kernel
from simulation.recovery import Recovery

WIRE_PRIORITY: Final = 0
"""Frames end before nodes step at the same instant."""

LOAD_WINDOW_NS: Final = 100_000_000
"""Span over which the largest bus load is told."""

BUS_OFF_FRAME = Frame(ERROR_BUS_OFF, bytes(8), FrameKind.ERROR)
"""What a driver tells its program (Linux can/error.h)."""

WireFrame = tuple[int, Frame]
"""True time at which the frame ended, and the frame."""


class Receiver:
    """What the wire knows of a station.

    Attributes:
        name: Of its node.
        inbox: Frames that have ended on the wire since the station last looked.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.inbox: list[WireFrame] = []

    @property
    def acceptance(self) -> frozenset[int] | None:
        """Identifiers that its acceptance filter lets through; None for all."""
        return None


Filter = Callable[[int, str, Frame, str], bool]
"""`(true_ns, sender, frame, receiver)`: False loses the frame for this receiver."""
Witness = Callable[[int, str, Frame], None]
"""`(true_ns, sender, frame)`: sees every frame that was on the wire."""
Disturber = Callable[[int, str, Frame], Disturbance | None]
"""`(true_ns, sender, frame)`: what happens to a frame that begins now."""


class Wire:
    """One CAN bus. Every frame that goes through is heard by every other station.

    Attributes:
        controllers: by the name of their station, or of the stranger who sends.
        filters: lose frames for single receivers, as a full receive buffer does.
        disturbers: cut frames short.
        frames, error_frames: so far.
        busy_ns: time in which the wire was busy, interframe spaces in.
        load_max: largest load within `LOAD_WINDOW_NS`.
    """

    def __init__(self, kernel: Kernel, bitrate_bps: int) -> None:
        self._kernel = kernel
        self._on_begin: Action = self._begin  # found once, not at every frame
        self._on_end: Action = self._end
        self._bitrate_bps = bitrate_bps
        bits_max = frame_bits_max(DATA_BYTES_MAX, extended=True)
        self._span_ns_of_bits = [bits_time_ns(n, bitrate_bps) for n in range(bits_max + 1)]
        self._space_ns = bits_time_ns(INTERFRAME_SPACE_BITS, bitrate_bps)
        self._suspend_ns = bits_time_ns(SUSPEND_BITS, bitrate_bps)
        self._stations: dict[str, Receiver] = {}
        self._routes: dict[int, tuple[Controller, list[Receiver]]] = {}
        self._arbitration = Arbitration()
        self._pending = self._arbitration.pending
        self._is_begun = False  # a frame is under way, or its begin is planned
        self._free_ns = 0
        self._current: list[Pending] = []
        self._error: FrameError | None = None
        self._lost_for = ""
        self._on_bus = 0
        self._is_troubled = False  # some controller's counters are not zero
        self._recoveries: list[Recovery] = []
        self._window_end_ns = LOAD_WINDOW_NS
        self._window_busy_ns = 0
        self.controllers: dict[str, Controller] = {}
        self.filters: list[Filter] = []
        self.disturbers: list[Disturber] = []
        self.witnesses: list[Witness] = []
        self.frames = 0
        self.error_frames = 0
        self.busy_ns = 0
        self.load_max = 0.0

    def attach(self, station: Receiver, settings: ControllerSettings = DEFAULT_SETTINGS) -> None:
        """Adds a station; order of attachment is order of delivery."""
        self._stations[station.name] = station
        self._routes.clear()
        self._add(station.name, settings)

    def _add(self, name: str, settings: ControllerSettings = DEFAULT_SETTINGS) -> Controller:
        assert name not in self.controllers, f"{name} is on the wire already"
        self._on_bus += 1
        controller = self.controllers[name] = Controller(name, settings)
        return controller

    def send(self, true_ns: int, sender: str, frames: Sequence[Frame]) -> None:
        """Puts frames into the sender's mailboxes; one that nobody attached is a stranger."""
        if not frames:
            return
        controller = self.controllers.get(sender) or self._add(sender)
        offer = self._arbitration.offer
        for frame in frames:
            if controller.accept(frame):
                offer(controller, frame)
        if self._pending and not self._is_begun:
            self._plan(true_ns)

    def _plan(self, true_ns: int) -> None:
        """The next frame begins now, or when the interframe space is over."""
        self._is_begun = True
        if true_ns >= self._free_ns:
            self._begin(true_ns)
        else:
            self._kernel.at(self._free_ns, WIRE_PRIORITY, self._on_begin)

    # A frame ---------------------------------------------------------------------------------

    def _begin(self, true_ns: int) -> None:
        pending = self._pending
        if not pending:  # whoever wanted to send has dropped out meanwhile
            self._is_begun = False
            return
        first = heappop(pending)
        self._current = [first]
        frame = first[3]
        if (
            (pending and pending[0][0] == first[0])
            or self.disturbers
            or self._on_bus < 2
            or frame.kind is FrameKind.FD
        ):
            self._error = self._find_error(true_ns, first)
            if self._error is not None:
                bits = self._error.bits + INTERFRAME_SPACE_BITS
                self._occupy(true_ns, bits_time_ns(bits, self._bitrate_bps), self._end_in_error)
                return
        self._occupy(true_ns, self._span_ns_of_bits[frame_bits(frame)], self._on_end)

    def _occupy(self, true_ns: int, span_ns: int, end: Action) -> None:
        if self._recoveries:
            for recovery in self._recoveries:
                recovery.begins(true_ns)
        self._free_ns = true_ns + span_ns
        self._kernel.at(self._free_ns - self._space_ns, WIRE_PRIORITY, end)
        self.busy_ns += span_ns
        if self._free_ns > self._window_end_ns:
            self.load_max = max(self.load_max, self._window_busy_ns / LOAD_WINDOW_NS)
            self._window_busy_ns = 0
            self._window_end_ns = self._free_ns - self._free_ns % LOAD_WINDOW_NS + LOAD_WINDOW_NS
        self._window_busy_ns += span_ns

    def _end(self, true_ns: int) -> None:
        if not self._current:  # its sender dropped out on the way
            self._error = FrameError(bits=0)
            self._end_in_error(true_ns)
            return
        first = self._current[0]
        controller, frame = first[2], first[3]
        self.frames += 1
        for witness in self.witnesses:
            witness(true_ns, controller.name, frame)
        route = self._routes.get(frame.can_id)
        if route is None or route[0] is not controller:
            route = self._route(controller, frame.can_id)
        receivers = route[1]
        item = (true_ns, frame)
        if not self.filters and not self._lost_for and len(self._current) == 1:
            for station in receivers:
                station.inbox.append(item)
        else:
            self._deliver_with_care(item, receivers)
        for entry in self._current:
            sender = entry[2]
            sender.waiting -= 1
            if sender.behind:
                self._arbitration.offer(sender, sender.behind.popleft())
        if self._is_troubled:
            self._count_success()
        self._go_on()

    def _deliver_with_care(self, item: WireFrame, receivers: list[Receiver]) -> None:
        """Some may not get it: who sent the same, whose controller saw it disturbed, a filter."""
        true_ns, frame = item
        sender = self._current[0][2].name
        without = {entry[2].name for entry in self._current} | {self._lost_for}
        self._lost_for = ""
        for station in receivers:
            name = station.name
            if name not in without and all(
                keep(true_ns, sender, frame, name) for keep in self.filters
            ):
                station.inbox.append(item)

    def _route(self, sender: Controller, can_id: int) -> tuple[Controller, list[Receiver]]:
        """The sender, and the stations that want these frames of his by their filters."""
        receivers = [
            station
            for name, station in self._stations.items()
            if name != sender.name
            and self.controllers[name].is_on_bus
            and (station.acceptance is None or can_id in station.acceptance)
        ]
        route = self._routes[can_id] = (sender, receivers)
        return route

    def _go_on(self) -> None:
        self._is_begun = False
        self._current = []
        for recovery in self._recoveries:
            recovery.ends(self._free_ns)
        if self._pending:
            self._is_begun = True
            self._kernel.at(self._free_ns, WIRE_PRIORITY, self._on_begin)

    # Errors ----------------------------------------------------------------------------------

    def _find_error(self, true_ns: int, first: Pending) -> FrameError | None:
        """What will cut this frame short; takes in whoever sends with the same identifier."""
        _, _, controller, frame = first
        if frame.kind is FrameKind.FD:
            return foreign_format()
        self._current += self._arbitration.take_twins(first)
        error = None
        if len(self._current) > 1:
            error = collided([entry[3] for entry in self._current])
        if error is None and self._on_bus <= len(self._current):
            error = not_acknowledged(frame)
        for disturb in self.disturbers:
            disturbance = disturb(true_ns, controller.name, frame)
            if disturbance is not None and error is None:
                error = self._disturbed(frame, controller, disturbance)
        return error

    def _disturbed(
        self, frame: Frame, sender: Controller, disturbance: Disturbance
    ) -> FrameError | None:
        name = disturbance.receiver
        if name is None:
            is_passive = sender.state is ErrorState.PASSIVE
            return disturbed(frame, disturbance.bit, is_passive=is_passive)
        finder = self.controllers[name]
        if finder is sender or not finder.is_on_bus:
            return None
        if finder.state is ErrorState.ACTIVE:
            return found_by(name, frame, disturbance.bit)
        self._lost_for = name  # an error-passive one's flag disturbs nobody but itself
        self._count(finder, Count.HEARD_ERROR)
        return None

    def _end_in_error(self, true_ns: int) -> None:
        error, self._error = self._error, None
        assert error is not None
        self.error_frames += 1
        senders = [entry[2] for entry in self._current]
        self._arbitration.put_back(self._current)
        for controller in self.controllers.values():
            if not controller.is_on_bus:
                continue
            if controller in senders:
                self._count(controller, error.count)
            elif controller.name == error.finder:
                self._count(controller, Count.FOUND_ERROR)
            else:
                self._count(controller, Count.HEARD_ERROR)
            if controller.state is ErrorState.BUS_OFF:
                self._leave(true_ns, controller)
        for controller in senders:
            self._suspend(controller)
        self._go_on()

    def _count_success(self) -> None:
        senders = [entry[2] for entry in self._current]
        for controller in self.controllers.values():
            if controller.is_on_bus and not controller.is_clean:
                self._count(controller, Count.SENT if controller in senders else Count.RECEIVED)
        for controller in senders:
            self._suspend(controller)

    def _count(self, controller: Controller, what: Count) -> None:
        controller.count(what)
        self._is_troubled = any(not other.is_clean for other in self.controllers.values())

    def _suspend(self, controller: Controller) -> None:
        """An error-passive sender lets others go first."""
        if controller.state is ErrorState.PASSIVE:
            self._arbitration.hold(controller)
            self._kernel.at(
                self._free_ns + self._suspend_ns,
                WIRE_PRIORITY,
                lambda now_ns: self._resume(now_ns, controller),
            )

    def _resume(self, true_ns: int, controller: Controller) -> None:
        self._arbitration.release(controller)
        if self._pending and not self._is_begun:
            self._is_begun = True  # after whoever else resumes at this instant
            self._kernel.at(max(true_ns, self._free_ns), WIRE_PRIORITY, self._begin)

    # Bus-off ---------------------------------------------------------------------------------

    def drive_off(self, true_ns: int, name: str) -> None:
        """A controller goes bus-off, as after many errors; one that is off already stays so."""
        controller = self.controllers[name]
        if controller.is_on_bus:
            controller.state = ErrorState.BUS_OFF
            self._leave(true_ns, controller)

    def switch_off(self, name: str) -> None:
        """A controller loses its power: what it was sending is nobody's any more."""
        self._drop_out(self.controllers[name])

    def switch_on(self, name: str) -> None:
        """A controller has power again, and begins with nothing."""
        controller = self.controllers[name]
        self._drop_out(controller)
        controller.reset()
        self._on_bus += 1

    def _leave(self, true_ns: int, controller: Controller) -> None:
        """Nothing that waited leaves late; the program is told, and the way back begins."""
        self._drop_out(controller)
        station = self._stations.get(controller.name)
        if station is not None:
            station.inbox.append((true_ns, BUS_OFF_FRAME))
        restart_ns = controller.settings.restart_ns
        if restart_ns is not None:
            absence = controller.absence
            self._kernel.at(
                true_ns + restart_ns,
                WIRE_PRIORITY,
                lambda now_ns: self._begin_recovery(now_ns, controller, absence),
            )

    def _drop_out(self, controller: Controller) -> None:
        self._arbitration.withdraw(controller)
        self._current = [entry for entry in self._current if entry[2] is not controller]
        self._recoveries = [r for r in self._recoveries if r.controller is not controller]
        controller.drop_out()
        self._routes.clear()
        self._on_bus = sum(other.is_on_bus for other in self.controllers.values())

    def _begin_recovery(self, true_ns: int, controller: Controller, absence: int) -> None:
        if controller.absence != absence:
            return  # it was switched off, or on, meanwhile
        recovery = Recovery(self._kernel, self._bitrate_bps, controller, self._come_back)
        self._recoveries.append(recovery)
        recovery.idle_from(max(true_ns, self._free_ns))

    def _come_back(self, true_ns: int, recovery: Recovery) -> None:
        self._recoveries.remove(recovery)
        recovery.controller.reset()
        self._on_bus += 1
        self._routes.clear()

    def load_mean(self, true_ns: int) -> float:
        """Share of the time since the start in which the wire was busy."""
        return self.busy_ns / true_ns if true_ns else 0.0
