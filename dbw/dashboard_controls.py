"""What the dashboard can do to a car: which bus, which frame, and who else sends it.

- Emergency brake: the FAILSAFE frame, which anybody may send, on any car.
- Button, pedals and hands: the driver's side of the harness, there on a desk alone. A car has a
  driver for that.
- Engage, disengage, reset and a speed to drive: a gateway of our own, where there is no planner.
  An identifier has one sender, so this is never beside another gateway.
"""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Final, Self

from canbus.bus import BusError
from canbus.frame import Frame
from canbus.python_can_bus import PythonCanBus
from dbc.endpoint import FAILSAFE_ID
from dbc.harness import DriverHandsWire
from gateway.api import Car
from gateway.errors import DisengageFailed, EngageRefused, LinkFailed, NotConnected, ResetRefused
from planner.speed_plan import LATERAL_ACCELERATION_MPS2, SPEED_MPS_MAX
from runtime.clock import NS_PER_S, monotonic_ns, realtime_ns
from runtime.harness import HANDS_OFF, harness_frame
from runtime.in_process import BUTTON_S
from telemetry.dashboard.control import DEAD_MAN_NS, NO_WISH, Action, Limits, Refused, Wish
from vehicles import Vehicle

HANDS_NM_MAX: Final = 10.0
"""Of the page's hands on the steering wheel: more than any vehicle takes for a driver's."""
JERK_SHARE: Final = 0.5
"""Of the monitor's limit of lateral jerk that steering by the page uses."""
ABANDONED_NS: Final = 2 * DEAD_MAN_NS
"""A wish that the dashboard has neither repeated nor let go for so long: its dead-man is dead."""
SPEED_MPS_MIN: Final = 1.0
"""Below, the curvature may change as fast as at this speed."""


class CarControls:
    """Implements `telemetry.dashboard.control.Controls`; opened by `with`.

    Args:
        interface: python-can's name.
        channel: The vehicle bus.
        vehicle: Its limits are those of the page.
        harness_channel: The driver's side of a simulated car; None: there is none.
        car: A gateway of our own, open; None: planning is somebody else's.
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        *,
        vehicle: Vehicle,
        harness_channel: str | None = None,
        car: Car | None = None,
    ) -> None:
        self._interface = interface
        self._channel = channel
        self._harness_channel = harness_channel
        self._car = car
        self._hands = HANDS_OFF
        self._hands_lock = threading.Lock()
        self._pause = threading.Event()  # set at the end: a button that is held is let go
        self._driver = None if car is None else PageDriver(car, vehicle)
        actions = {Action.EMERGENCY_BRAKE}
        limits = Limits()
        if harness_channel is not None:
            actions |= {Action.BUTTON, Action.HOLD}
            limits = replace(limits, pedal_ratio=1.0, steering_torque_nm=HANDS_NM_MAX)
        if car is not None:
            actions |= {Action.ENGAGE, Action.DISENGAGE, Action.RESET, Action.HOLD}
            limits = replace(
                limits,
                speed_mps=min(SPEED_MPS_MAX, vehicle.traction.speed_mps_max),
                curvature_per_m=vehicle.curvature_per_m_max,
            )
        self.actions = frozenset(actions)
        self.limits = limits

    def __enter__(self) -> Self:
        """Begins to drive, where there is a gateway."""
        if self._driver is not None:
            self._driver.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Lets go of everything."""
        self._pause.set()
        self.hold(NO_WISH)
        if self._driver is not None:
            self._driver.stop()

    def emergency_brake(self) -> None:
        """Sends FAILSAFE. Raises `Refused` if the bus did not take it."""
        self._send(self._channel, Frame(FAILSAFE_ID, b""))

    def act(self, action: Action) -> None:
        """Any other action, to its end. Raises `Refused` with the car's reason."""
        if action is Action.BUTTON:
            self._change_hands(button_pressed=True)
            self._pause.wait(BUTTON_S)
            self._change_hands(button_pressed=False)
            return
        assert self._car is not None
        procedure = {
            Action.ENGAGE: self._car.engage,
            Action.DISENGAGE: self._car.disengage,
            Action.RESET: self._car.reset,
        }[action]
        try:
            procedure()
        except (EngageRefused, DisengageFailed, ResetRefused, LinkFailed, NotConnected) as error:
            raise Refused(str(error)) from error

    def hold(self, wish: Wish) -> None:
        """The wish in force: pedals and hands at once, speed and curvature at the next decision."""
        if self._driver is not None:
            self._driver.hold(wish, monotonic_ns())
        if self._harness_channel is not None:
            self._change_hands(
                throttle_pedal_ratio=wish.throttle_pedal_ratio,
                brake_pedal_ratio=wish.brake_pedal_ratio,
                steering_torque_nm=wish.steering_torque_nm,
            )

    def _change_hands(self, **changes: float | bool) -> None:
        """Tells the plant what the driver does, if that is news."""
        assert self._harness_channel is not None
        with self._hands_lock:
            hands: DriverHandsWire = replace(self._hands, **changes)  # type: ignore[arg-type]
            if hands != self._hands:
                self._send(self._harness_channel, harness_frame("DRIVER_HANDS", hands))
                self._hands = hands

    def _send(self, channel: str, frame: Frame) -> None:
        """Opened for this frame alone: a bus that nobody reads would keep everything ever sent."""
        try:
            with PythonCanBus(
                self._interface,
                channel,
                clock=monotonic_ns,
                realtime=realtime_ns,
                acceptance=frozenset(),
            ) as bus:
                is_sent = bus.send(frame)
        except BusError as error:
            raise Refused(str(error)) from error
        if not is_sent:
            raise Refused(f"{channel} did not take the frame: is it up?")


class PageDriver:
    """A planner that decides what the page wishes: every period, in a thread of its own.

    The dashboard lets a wish go when its browser falls silent. If it does not, it is dead itself,
    and this planner must not drive on for it: it decides no more, and the nodes stop the car (ER5).

    Args:
        car: Open.
        vehicle: Its envelope bounds how fast the curvature may change.
    """

    def __init__(self, car: Car, vehicle: Vehicle) -> None:
        self._held: tuple[Wish, int] = (NO_WISH, 0)
        self._car = car
        self._jerk_mps3 = JERK_SHARE * vehicle.envelope.lateral_jerk_mps3_max
        self._curvature_per_m = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page-driver", daemon=True)

    def hold(self, wish: Wish, now_ns: int) -> None:
        """The wish in force from now on, monotonic time."""
        self._held = (wish, now_ns)

    def start(self) -> None:
        """Begins to decide."""
        self._thread.start()

    def stop(self) -> None:
        """Ends and joins the thread."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            before_ns = monotonic_ns()
            for state in self._car.ticks():
                if self._ended.is_set():
                    return
                passed_s = (state.time_ns - before_ns) / NS_PER_S
                before_ns = state.time_ns
                self.decide(state.speed_mps, max(0.0, passed_s), monotonic_ns())
        except (LinkFailed, NotConnected):
            return  # whoever asks for something next is told

    def decide(self, speed_mps: float, passed_s: float, now_ns: int) -> None:
        """One decision, or none for a wish that nobody has repeated or let go for too long.

        Args:
            speed_mps: The car's; NaN if it is not known.
            passed_s: Since the last decision.
            now_ns: Monotonic time.
        """
        wish, told_ns = self._held
        if wish != NO_WISH and now_ns - told_ns > ABANDONED_NS:
            return
        speed_mps = SPEED_MPS_MAX if math.isnan(speed_mps) else max(SPEED_MPS_MIN, speed_mps)
        self._curvature_per_m = steered(
            self._curvature_per_m, wish.curvature_per_m, self._jerk_mps3 / speed_mps**2 * passed_s
        )
        self._car.command(
            speed_mps=in_bend(wish.speed_mps, self._curvature_per_m),
            curvature_per_m=self._curvature_per_m,
        )


def steered(now_per_m: float, wanted_per_m: float, step_per_m: float) -> float:
    """The curvature after a step towards the one that is wanted."""
    return now_per_m + min(max(wanted_per_m - now_per_m, -step_per_m), step_per_m)


def in_bend(speed_mps: float, curvature_per_m: float) -> float:
    """The speed that is wanted, or the one at which a bend is comfortable."""
    if curvature_per_m == 0.0:
        return speed_mps
    return min(speed_mps, math.sqrt(LATERAL_ACCELERATION_MPS2 / abs(curvature_per_m)))
