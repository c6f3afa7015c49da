"""Bringing the car to a stand before its nodes are ended."""

from __future__ import annotations

import math
from collections.abc import Callable

from canbus.bus import Bus, BusError
from canbus.frame import Frame
from canbus.python_can_bus import PythonCanBus
from dbc.endpoint import FAILSAFE_ID, Endpoint
from dbc.messages import Mode, SupervisorState, ThrottleStatus
from runtime.clock import Clock, realtime_ns

LOOK_NS = 20_000_000
HEAR_NS_MAX = 200_000_000
"""After this long without a believable frame nobody drives: three times the DBC's time-out."""

FAILSAFE_INTERVAL_NS = 100_000_000

WHEEL_SPEED_RADPS_STANDING = 0.2
"""Standing, by the driven wheels: 0.06 m/s on a wheel of 0.287 m."""

WANTED = ("SUPERVISOR_STATE", "THROTTLE_STATUS")

SYSTEM_DRIVES = frozenset({Mode.AUTOMATIC, Mode.STOPPING})
SYSTEM_MOVES = SYSTEM_DRIVES | {Mode.EMERGENCY}
"""In all others a human drives, or nobody: there is nothing to wait for."""


class StandstillWait:
    """Waits until the car stands, or a human drives it, or the time is over.

    While the system drives, FAILSAFE is sent: the emergency stop that any node or an outside box
    may send (EN 50325-5), so that the planner, whoever it is, cannot drive on.

    Args:
        interface: of the vehicle bus.
        channel: the vehicle bus.
        clock: time.
        limit_ns: longest wait.
    """

    def __init__(self, *, interface: str, channel: str, clock: Clock, limit_ns: int) -> None:
        self._interface = interface
        self._channel = channel
        self._clock = clock
        self._limit_ns = limit_ns

    def __call__(self, hurry: Callable[[], bool]) -> bool:
        """Waits; answers whether the car stands or is not the system's. `hurry` cuts it short."""
        endpoint = Endpoint("Launcher", WANTED)
        bus = PythonCanBus(
            self._interface,
            self._channel,
            clock=self._clock,
            realtime=realtime_ns,
            acceptance=endpoint.acceptance,
        )
        try:
            with bus:
                return wait_for_standstill(bus, endpoint, self._clock, self._limit_ns, hurry)
        except BusError:
            return False  # nothing can be known; the watchdogs brake


def wait_for_standstill(
    bus: Bus, endpoint: Endpoint, clock: Clock, limit_ns: int, hurry: Callable[[], bool]
) -> bool:
    """See `StandstillWait`; `bus` is open."""
    begin_ns = clock()
    failsafe_ns = begin_ns - FAILSAFE_INTERVAL_NS
    while clock() - begin_ns < limit_ns and not hurry():
        endpoint.take(bus.receive(LOOK_NS))
        now_ns = clock()
        state = endpoint.get("SUPERVISOR_STATE", SupervisorState)
        if state is not None and _is_heard(endpoint, "SUPERVISOR_STATE", now_ns):
            if state.mode not in SYSTEM_MOVES:
                return True
            if state.mode not in SYSTEM_DRIVES and is_standing(endpoint, now_ns):
                return True
            if state.mode in SYSTEM_DRIVES and now_ns - failsafe_ns >= FAILSAFE_INTERVAL_NS:
                bus.send(Frame(FAILSAFE_ID))
                failsafe_ns = now_ns
        elif now_ns - begin_ns > HEAR_NS_MAX:  # no supervisor: the ECUs brake by themselves
            if is_standing(endpoint, now_ns):
                return True
            if not _is_heard(endpoint, "THROTTLE_STATUS", now_ns):
                return False
    return is_standing(endpoint, clock())


def _is_heard(endpoint: Endpoint, name: str, now_ns: int) -> bool:
    age_ns = endpoint.age_ns(name, now_ns)
    return age_ns is not None and age_ns <= HEAR_NS_MAX


def is_standing(endpoint: Endpoint, now_ns: int) -> bool:
    """Whether the driven wheels are known to stand; an old or missing reading does not tell."""
    status = endpoint.get("THROTTLE_STATUS", ThrottleStatus)
    if status is None or not _is_heard(endpoint, "THROTTLE_STATUS", now_ns):
        return False
    speed = status.wheel_speed_radps
    return not math.isnan(speed) and abs(speed) < WHEEL_SPEED_RADPS_STANDING
