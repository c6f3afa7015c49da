"""The planner's API: `Car` for blocking code, `AsyncCar` for asyncio, on any `Link`.

    with connect("socketcan", "vcan0") as car:
        car.engage()
        for state in car.ticks():
            car.command(speed_mps=3.0, curvature_per_m=0.0)
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Generator, Iterator
from contextlib import closing
from types import TracebackType
from typing import Final, Self

from dbc.messages import Request
from gateway.commands import NS_PER_S, Decision, checked, decide
from gateway.core import PlannerInputs
from gateway.errors import DisengageFailed, LinkFailed, NotConnected
from gateway.link import Link
from gateway.motion_commands import decide_car_command, decide_cmd_vel
from gateway.poses import given_pose
from gateway.procedures import disengage, engage, reset
from gateway.requests import DRIVING_MODES
from gateway.state import CarState
from vehicles.vehicle import Vehicle

TIMEOUT_S_MAX: Final = 3600.0
AGE_S_MAX: Final = 10.0
TICK_PERIOD_S_MIN, TICK_PERIOD_S_MAX = 0.001, 10.0

LEAVE_MARGIN_S: Final = 2.0
"""Added to the time of a controlled stop when a `with` block is left while the car drives."""


class _Session:
    """What both kinds of car share: everything that takes no time."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._was_opened = False
        self._is_open = False
        self.missed_ticks = 0
        """Ticks of `ticks()` that were skipped because the loop's body took too long."""

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle, with its limits."""
        return self._link.vehicle

    @property
    def state(self) -> CarState:
        """The car as known now. Raises NotConnected, LinkFailed."""
        self._require_open()
        return self._link.state()

    def command(
        self, *, speed_mps: float, curvature_per_m: float, age_s: float = 0.0
    ) -> None:
        """Gives a decision, which leaves at once. It counts only while the car is AUTOMATIC.

        Args:
            speed_mps: Of the rear axle's centre, up to the vehicle's `traction.speed_mps_max`, or
                backwards, negative, to its `traction.reverse_speed_mps_max`. Told to turn round,
                the car stops first.
            curvature_per_m: Of the path, positive with the steering wheel to the left, within plus
                or minus `vehicle.curvature_per_m_max`.
            age_s: How old the decision is already, 0 to 10: of one that came over a link.

        Raises:
            TypeError: No number. Nothing was sent, here and below.
            CommandError: NaN, infinite or out of range.
            NotConnected: Outside the `with` block.
            LinkFailed: The connection broke.
        """
        self._require_open()
        age_s = checked("age_s", age_s, 0.0, AGE_S_MAX, "s")
        decision = decide(self.vehicle, speed_mps=speed_mps, curvature_per_m=curvature_per_m)
        self._submit(decision, round(age_s * NS_PER_S))

    def cmd_vel(self, *, speed_mps: float, yaw_rate_radps: float) -> None:
        """A decision as UNICAMP's CmdVel; `decide_cmd_vel` has the ranges. Raises as `command`."""
        self._require_open()
        vehicle = self.vehicle
        self._submit(decide_cmd_vel(vehicle, speed_mps=speed_mps, yaw_rate_radps=yaw_rate_radps))

    def car_command(self, *, left_mps: float, right_mps: float, ackermann_rad: float) -> None:
        """A decision as UNICAMP's CarCommand: speed of each rear wheel, and the steering's angle.

        The wheels must differ as the electronic differential turns them: `decide_car_command`.
        Raises as `command`.
        """
        self._require_open()
        self._submit(
            decide_car_command(
                self.vehicle, left_mps=left_mps, right_mps=right_mps, ackermann_rad=ackermann_rad
            )
        )

    def give_pose(
        self,
        *,
        x_m: float,
        y_m: float,
        heading_rad: float,
        position_sigma_m: float = 0.0,
        heading_sigma_rad: float = 0.0,
    ) -> None:
        """Says where the car is now: `state.odometry` goes on from here, its error as well.

        Args:
            x_m: Rear axle's centre, within 1e7 m as `y_m`, in a frame of the planner's own.
            y_m: As x_m.
            heading_rad: From x towards y; any number of turns up to 1000.
            position_sigma_m: Standard deviation of x and of y, 0 to 1000.
            heading_sigma_rad: Standard deviation, 0 to pi.

        Raises:
            As `command`.
        """
        self._require_open()
        self._link.submit(PlannerInputs(pose=given_pose(
            x_m, y_m, heading_rad, position_sigma_m, heading_sigma_rad
        )))

    def emergency_brake(self) -> None:
        """Brakes as hard as the car can, at once; returns without waiting.

        Nothing happens while a human drives. Ends by `reset()` at standstill.
        """
        self._require_open()
        self._link.submit(PlannerInputs(request=Request.EMERGENCY_STOP))

    def _submit(self, decision: Decision, age_ns: int = 0) -> None:
        decided_ns = self._link.now_ns() - age_ns
        self._link.submit(PlannerInputs(decision=decision, decided_ns=decided_ns))

    def _require_open(self) -> None:
        if not self._is_open:
            raise NotConnected("not connected: use the car inside its with block")

    def _open(self) -> None:
        if self._was_opened:
            raise NotConnected("a car is entered once: call connect() again")
        self._link.open()
        self._was_opened = self._is_open = True

    def _close(self) -> None:
        self._is_open = False
        self._link.close()

    def _engage(self, timeout_s: float) -> Generator[int, None, None]:
        return engage(self._link, self._timeout_ns(timeout_s))

    def _disengage(self, timeout_s: float) -> Generator[int, None, None]:
        return disengage(self._link, self._timeout_ns(timeout_s))

    def _reset(self, timeout_s: float) -> Generator[int, None, None]:
        return reset(self._link, self._timeout_ns(timeout_s))

    def _timeout_ns(self, timeout_s: float) -> int:
        self._require_open()
        return round(checked("timeout_s", timeout_s, 0.0, TIMEOUT_S_MAX, "s") * NS_PER_S)

    def _leave(self) -> Generator[int, None, None]:
        """The end of a `with` block: a controlled stop if the car drives by our word."""
        if not self._is_open or self._link.state().mode not in DRIVING_MODES:
            return
        vehicle = self.vehicle
        stop_mps2 = vehicle.brake.controlled_stop_ratio * vehicle.brake.deceleration_mps2_full
        stop_s = vehicle.traction.speed_mps_max / stop_mps2 + LEAVE_MARGIN_S
        try:
            yield from disengage(self._link, round(stop_s * NS_PER_S))
        except DisengageFailed:
            return  # it brakes already, or will when the decisions no longer come

    def _tick_period_ns(self, period_s: float | None) -> int:
        self._require_open()
        if period_s is None:
            return self._link.planner_period_ns
        low, high = TICK_PERIOD_S_MIN, TICK_PERIOD_S_MAX
        return round(checked("period_s", period_s, low, high, "s") * NS_PER_S)

    def _next_tick_ns(self, tick_ns: int, period_ns: int) -> int:
        """The next tick. When it has passed already, the newest one passed; the rest are missed."""
        next_ns = tick_ns + period_ns
        missed = max(0, (self._link.now_ns() - next_ns) // period_ns)
        self.missed_ticks += missed
        return next_ns + missed * period_ns


class Car(_Session):
    """A car for blocking code. Made by `gateway.connect.connect`; opens with `with`."""

    def __enter__(self) -> Self:
        """Connects. Raises BusError when the bus cannot be opened."""
        self._open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Disengages if the car drives (a controlled stop, bounded in time), then closes."""
        try:
            self._run(self._leave())
        except LinkFailed:
            if error is None:
                raise  # nobody has heard of it yet
        finally:
            self._close()

    def close(self) -> None:
        """Closes at once, without a stop: without decisions the car brakes by itself."""
        self._close()

    def engage(self, timeout_s: float = 5.0) -> None:
        """Asks for AUTOMATIC and waits for it. The planner must decide right after.

        Raises:
            EngageRefused: Not within `timeout_s`; the text says what to do.
        """
        self._run(self._engage(timeout_s))

    def disengage(self, timeout_s: float = 30.0) -> None:
        """Gives the car back: a controlled stop first when it moves; waits for READY or MANUAL.

        Another thread may go on calling `command` meanwhile, for its curvature.

        Raises:
            DisengageFailed: An emergency brake came first, or the time is over.
        """
        self._run(self._disengage(timeout_s))

    def reset(self, timeout_s: float = 2.0) -> None:
        """Ends an emergency at standstill, with every cause gone; the mode is MANUAL then.

        Raises:
            ResetRefused: Not within `timeout_s`; the text says why.
        """
        self._run(self._reset(timeout_s))

    def ticks(self, period_s: float | None = None) -> Iterator[CarState]:
        """The state once per period (default: the planner's), until the car is closed.

        The first comes at once. Deadlines are absolute; ticks that were missed are skipped and
        counted in `missed_ticks`.
        """
        return self._ticks(self._tick_period_ns(period_s))

    def _ticks(self, period_ns: int) -> Iterator[CarState]:
        tick_ns = self._link.now_ns()
        while self._is_open:
            yield self._link.state()
            tick_ns = self._next_tick_ns(tick_ns, period_ns)
            self._link.wait_until(tick_ns)

    def _run(self, steps: Generator[int, None, None]) -> None:
        with closing(steps):
            for wake_ns in steps:
                self._link.wait_until(wake_ns)


class AsyncCar(_Session):
    """A car for asyncio. Made by `gateway.connect.connect_async`; opens with `async with`."""

    async def __aenter__(self) -> Self:
        """Connects. Raises BusError when the bus cannot be opened."""
        self._open()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Disengages if the car drives (a controlled stop, bounded in time), then closes."""
        try:
            await self._run(self._leave())
        except LinkFailed:
            if error is None:
                raise  # nobody has heard of it yet
        finally:
            self._close()

    async def close(self) -> None:
        """Closes at once, without a stop: without decisions the car brakes by itself."""
        self._close()

    async def engage(self, timeout_s: float = 5.0) -> None:
        """As `Car.engage`."""
        await self._run(self._engage(timeout_s))

    async def disengage(self, timeout_s: float = 30.0) -> None:
        """As `Car.disengage`; other tasks may go on commanding meanwhile."""
        await self._run(self._disengage(timeout_s))

    async def reset(self, timeout_s: float = 2.0) -> None:
        """As `Car.reset`."""
        await self._run(self._reset(timeout_s))

    def ticks(self, period_s: float | None = None) -> AsyncIterator[CarState]:
        """As `Car.ticks`, for `async for`."""
        return self._ticks(self._tick_period_ns(period_s))

    async def _ticks(self, period_ns: int) -> AsyncIterator[CarState]:
        tick_ns = self._link.now_ns()
        while self._is_open:
            yield self._link.state()
            tick_ns = self._next_tick_ns(tick_ns, period_ns)
            await self._link.wait_async(tick_ns)

    async def _run(self, steps: Generator[int, None, None]) -> None:
        with closing(steps):
            for wake_ns in steps:
                await self._link.wait_async(wake_ns)
