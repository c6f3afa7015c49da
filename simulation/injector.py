"""Puts faults into a running world at their times, and takes them away again.

What a fault strikes is in three files: messages on their way (`frame_faults.py`), readings and
commands (`wiring_faults.py`), and here nodes, bus, planner, driver and road.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from numpy.random import Generator

from canbus.frame import Frame
from simulation.disturbance import Disturbance
from simulation.fault_kinds import KINDS, FaultKind, Strikes
from simulation.faults import Fault
from simulation.frame_faults import FrameFaults
from simulation.overlay import Overlays, Undo
from simulation.wiring_faults import WiringFaults
from simulation.world import Station, World

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
FAULT_PRIORITY = -1
"""A fault of this instant is there before anything else happens in it."""
STRANGER = "stranger"
FLOODER = "flooder"
LINGERS_NS = {
    FaultKind.RESTART: NS_PER_S, FaultKind.BROWN_OUT: NS_PER_S,  # until there is power again
    FaultKind.REPLAY: NS_PER_S, FaultKind.DELAY: NS_PER_MS,  # until the last frame has gone
}
"""How long a fault stays after its end, for each unit of its value."""
STAYS_NS = {FaultKind.BUS_OFF: 200 * NS_PER_MS}  # the controller waits 100 ms, counts, is back
"""How long it stays, whatever its value."""
FLAG_OF_DRIVE = {
    FaultKind.DRIVE_FAULT: ("is_tripped", True), FaultKind.DRIVE_DEAD: ("is_alive", False),
    FaultKind.DRIVE_MUTE: ("is_mute", True), FaultKind.DRIVE_DEAF: ("is_deaf", True),
}
"""What a fault of a motor drive sets in its `DriveUnit`."""
FULL_TORQUE_NM = 10.0
"""What a driver who means it puts on the wheel."""


def nothing(true_ns: int) -> None:
    """For a fault that is over as it begins."""


@dataclass(slots=True)
class Injection:
    """One fault as it happened; `end_ns` is None while it lasts."""

    fault: Fault
    begin_ns: int
    end_ns: int | None = None


Listener = Callable[[int, Fault, bool], None]
"""`(true_ns, fault, is_begin)`"""


class Injector:
    """All faults of one run.

    Args:
        world: what they strike.
        rng: chance of the faults: `world.fault_rng`, apart from that of the world's own.

    Attributes:
        injections: what has begun so far, in order.
        listeners: told of every beginning and end.
        corruption_listeners: told `(sender, sent, heard)` of every frame changed in its sender.
        planner: the planner's fault in force; the pilot acts on it.
    """

    def __init__(self, world: World, rng: Generator) -> None:
        self.injections: list[Injection] = []
        self.listeners: list[Listener] = []
        self.planner: Fault | None = None
        self._world = world
        self._rng = rng
        self._frames = FrameFaults(world, rng)
        self.corruption_listeners = self._frames.corruption_listeners
        self._overlays = Overlays()
        self._wiring = WiringFaults(world, rng, self._overlays)
        self._undo: dict[int, tuple[Injection, Undo]] = {}
        self._noise: list[Fault] = []

    def plan(self, faults: list[Fault]) -> None:
        """Faults whose times are still to come."""
        for fault in faults:
            at_ns = max(round(fault.at_s * NS_PER_S), self._world.now_ns)
            self._world.kernel.at(at_ns, FAULT_PRIORITY, partial(self._begin, fault))

    def begin(self, fault: Fault) -> None:
        """A fault begins now, whatever its time."""
        self._begin(fault, self._world.now_ns)

    def heal(self) -> None:
        """All that lasts ends now; what a fault has led to stays."""
        for number in list(self._undo):
            self._end(number, self._world.now_ns)

    @property
    def active(self) -> list[Fault]:
        """Faults in force."""
        return [injection.fault for injection, _ in self._undo.values()]

    def _begin(self, fault: Fault, true_ns: int) -> None:
        injection = Injection(fault=fault, begin_ns=true_ns)
        self.injections.append(injection)
        for listener in self.listeners:
            listener(true_ns, fault, True)
        undo = self._apply(fault, true_ns)
        self._attend()
        number = len(self.injections)
        if KINDS[fault.kind].is_instant:
            undo(true_ns)
            self._end_later(injection, true_ns)
            return
        self._undo[number] = (injection, undo)
        if not math.isinf(fault.for_s):
            end_ns = true_ns + round(fault.for_s * NS_PER_S)
            self._world.kernel.at(end_ns, FAULT_PRIORITY, partial(self._end, number))

    def _end_later(self, injection: Injection, true_ns: int) -> None:
        """A fault is over when all that it has set off is, which is what listeners are told."""
        fault = injection.fault

        def end(now_ns: int) -> None:
            injection.end_ns = now_ns
            for listener in self.listeners:
                listener(now_ns, fault, False)

        kind = fault.kind
        span_ns = round(fault.value * LINGERS_NS.get(kind, 0)) + STAYS_NS.get(kind, 0)
        if span_ns:
            self._world.kernel.at(true_ns + span_ns, FAULT_PRIORITY, end)
        else:
            end(true_ns)

    def _end(self, number: int, true_ns: int) -> None:
        if number not in self._undo:
            return  # healed before
        injection, undo = self._undo.pop(number)
        undo(true_ns)
        self._attend()
        self._end_later(injection, true_ns)

    def _attend(self) -> None:
        """Looks at every frame on the wire only while some are to be disturbed: that is dear."""
        disturbers, is_needed = self._world.wire.disturbers, self._noise or self._frames.is_on_wire
        if is_needed and self._disturb not in disturbers:
            disturbers.append(self._disturb)
        elif not is_needed and self._disturb in disturbers:
            disturbers.remove(self._disturb)

    def _apply(self, fault: Fault, true_ns: int) -> Undo:
        strikes = KINDS[fault.kind].strikes
        if strikes is Strikes.MESSAGE:
            return self._frames.begin(fault)
        if strikes in (Strikes.SENSOR, Strikes.ENCODER, Strikes.ACTUATOR):
            return self._wiring.begin(fault, true_ns)
        if strikes is Strikes.CONTROL:
            return self._grab(fault)
        if strikes is Strikes.DRIVE:
            return self._strike_drive(fault)
        if strikes is Strikes.NODE:
            return self._strike_node(fault, self._world.stations[fault.target], true_ns)
        return self._strike_all(fault, true_ns)

    # Nodes -----------------------------------------------------------------------------------

    def _strike_node(self, fault: Fault, station: Station, true_ns: int) -> Undo:
        put = self._overlays.put
        match fault.kind:
            case FaultKind.CRASH:
                station.is_alive = False
                return partial(_revive, station)
            case FaultKind.FREEZE:
                return put(station, "is_frozen", True)
            case FaultKind.MUTE:
                return put(station, "is_mute", True)
            case FaultKind.DEAF:
                return put(station, "is_deaf", True)
            case FaultKind.SLOW_STEP:
                return put(station, "step_ns", round(fault.value * NS_PER_MS))
            case FaultKind.JITTER:
                lateness_ns_max = fault.value * NS_PER_MS
                return put(station, "lateness_ns",
                           lambda: round(self._rng.uniform(0.0, lateness_ns_max)))
            case FaultKind.RESTART:
                self._cut_power([station], true_ns, fault.value)
            case FaultKind.CLOCK_JUMP:
                station.clock.jump(round(fault.value * NS_PER_MS))
            case FaultKind.CLOCK_DRIFT:
                before_ppm = station.clock.drift_ppm
                station.clock.drift(true_ns, round(fault.value))
                return lambda now_ns: station.clock.drift(now_ns, before_ppm)
            case FaultKind.BUS_OFF:
                self._world.wire.drive_off(true_ns, station.name)
            case FaultKind.BABBLE:
                return self._babble(station, fault.value)
            case _:
                raise AssertionError(fault.kind)
        return nothing

    def _cut_power(self, stations: list[Station], true_ns: int, span_s: float) -> None:
        for station in stations:
            station.is_alive = False
            self._world.wire.switch_off(station.name)

        def restore(now_ns: int) -> None:
            for station in stations:
                self._world.wire.switch_on(station.name)
                station.restart()

        end_ns = true_ns + round(span_s * NS_PER_S)
        self._world.kernel.at(end_ns, FAULT_PRIORITY, restore)

    def _babble(self, station: Station, per_s: float) -> Undo:
        """The node's last frame again and again, from its own controller."""
        last: list[Frame] = []

        def remember(true_ns: int, frames: Sequence[Frame]) -> Sequence[Frame]:
            last[:] = frames[-1:] or last
            return frames

        station.tampers.append(remember)
        stop = self._repeat(station.name, per_s, lambda: last)

        def undo(true_ns: int) -> None:
            stop(true_ns)
            station.tampers.remove(remember)

        return undo

    # Motor drives ----------------------------------------------------------------------------

    def _strike_drive(self, fault: Fault) -> Undo:
        train = self._world.car.train
        assert train is not None, f"{fault.kind}: this car has no motor drives on its bus"
        unit = next(unit for unit in train.units if unit.name == fault.target)
        flag, value = FLAG_OF_DRIVE[fault.kind]
        return self._overlays.put(unit, flag, value)

    # The bus, and all nodes ------------------------------------------------------------------

    def _strike_all(self, fault: Fault, true_ns: int) -> Undo:
        world, put = self._world, self._overlays.put
        match fault.kind:
            case FaultKind.FLOOD:
                return self._repeat(FLOODER, fault.value, lambda: [Frame(0)])
            case FaultKind.NOISE:
                self._noise.append(fault)
                return lambda _: self._noise.remove(fault)
            case FaultKind.BROWN_OUT:
                self._cut_power(list(world.stations.values()), true_ns, fault.value)
                return nothing
            case FaultKind.FRICTION:
                return put(world.car.faults, "friction_mu", fault.value)
            case FaultKind.SLOPE:
                return put(world.car.faults, "slope_rad", fault.value)
            case FaultKind.LOAD:
                return put(world.car.faults, "load_kg", fault.value)
        return put(self, "planner", fault)

    def _repeat(self, sender: str, per_s: float, frames: Callable[[], list[Frame]]) -> Undo:
        """Sends something at a rate until told to stop."""
        period_ns = max(round(NS_PER_S / per_s), 1)
        is_on = [True]

        def again(now_ns: int) -> None:
            if is_on[0]:
                self._world.wire.send(now_ns, sender, frames())
                self._world.kernel.at(now_ns + period_ns, FAULT_PRIORITY, again)

        def stop(true_ns: int) -> None:
            is_on[0] = False

        again(self._world.now_ns)
        return stop

    def _disturb(self, true_ns: int, sender: str, frame: Frame) -> Disturbance | None:
        for fault in self._noise:
            if self._rng.random() < fault.share:
                return Disturbance(bit=int(self._rng.integers(1, 100)))
        return self._frames.disturb(frame)

    # The driver ------------------------------------------------------------------------------

    def _grab(self, fault: Fault) -> Undo:
        driver, put = self._world.car.driver, self._overlays.put
        match fault.target:
            case "steering":
                side = 1.0 if self._rng.random() < 0.5 else -1.0
                return put(driver, "steering_torque_nm", side * fault.value * FULL_TORQUE_NM)
            case "throttle":
                return put(driver, "throttle_pedal_ratio", fault.value)
            case "brake":
                return put(driver, "brake_pedal_ratio", fault.value)
            case "button":
                return put(driver, "button_pressed", fault.value > 0.0)
        return put(driver, "emergency_stop_pressed", fault.value > 0.0)


def _revive(station: Station, true_ns: int) -> None:
    if not station.is_alive:
        station.restart()
