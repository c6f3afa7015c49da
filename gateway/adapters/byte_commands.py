"""UWA's byte commands on CAN, Brake, Accelerate and Steer with their echo (UWA 7.1, Table 1).

A planner of that kind sends three bytes (`dbc/byte_commands.dbc`) and gets each one back. This is
the adapter beside the gateway: it turns them into decisions for `gateway.api.Car`, so that every
limit, check and time-out of the gateway and of the nodes holds for them as for any other planner.

- A decision is made of a whole set, each command once, none older than a silent planner is allowed
  to be. Nothing is repeated: a planner that stops sending one of the three falls silent (ER5).
- Steer is a share of the steering wheel's range.
- Accelerate and Brake move a speed setpoint: by a share of `traction.acceleration_mps2_max`, or of
  `brake.deceleration_mps2_full`; by neither, the car rolls out. Brake wins over Accelerate. The
  servo follows the setpoint as for any planner; its last part belongs to emergencies.
- READY and a set without Accelerate ask for AUTOMATIC, if READY came from MANUAL: by the button. A
  drive that ended in READY is not begun anew without it. A reset is the button's.
- A decision is as old as the oldest of its commands.
- A command of wrong length or kind is ignored, not echoed, and told as ER0.

The frames are unprotected, as the paper's serial line was: who runs this adapter trusts whoever can
send its three identifiers to drive. Sans-I/O; times are those of the gateway's clock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from canbus.frame import Frame, FrameKind, ReceivedFrame
from dbc.byte_commands import SPECS, ByteErrors
from dbc.codec import frame_data
from dbc.messages import ErrorCode, Mode
from dbc.spec import MessageSpec
from gateway.api import Car
from gateway.commands import NS_PER_S, CommandError, Decision, decide, decision_age_ns_max
from gateway.errors import EngageRefused
from gateway.kinematics import Kinematics
from gateway.state import CarState
from vehicles.vehicle import Vehicle

BYTE_MAX: Final = 255
STEER_SPAN: Final = 128
"""Table 1: -128 to 127."""

_SPEC: Final = {spec.name: spec for spec in SPECS.values()}
COMMANDS: Final = ("BYTE_BRAKE", "BYTE_ACCELERATE", "BYTE_STEER")
COMMAND_IDS: Final = {_SPEC[name].can_id: name for name in COMMANDS}
ECHO_SPEC: Final = {name: _SPEC[f"{name}_ECHO"] for name in COMMANDS}
ERRORS_SPEC: Final = _SPEC["BYTE_ERRORS"]

ER0_SHOWN_NS: Final = 1_000_000_000
"""As long as the nodes report a code that is not latched."""
SETPOINT_LEAD_MPS: Final = 1.0
"""The setpoint runs no further ahead of the car: it must not wind up when the car cannot follow."""
ENGAGE_S: Final = 0.2
"""A request for AUTOMATIC is answered within a few cycles; the next set asks again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ByteOutput:
    """What follows from the commands of one cycle."""

    frames: tuple[Frame, ...]
    """Echoes, and BYTE_ERRORS when it is due."""
    decision: Decision | None
    age_s: float
    """Of the oldest command of the decision."""
    wants_engage: bool


class ByteCommands:
    """Takes the planner's frames and answers decisions; `step` alone changes it.

    Args:
        vehicle: Whose limits hold.
        planner_period_ns: How often the planner has promised a whole set.

    Raises:
        CommandError: The vehicle's range for foreign nodes has no room for these identifiers.
    """

    def __init__(self, vehicle: Vehicle, planner_period_ns: int) -> None:
        low, high = round(vehicle.bus.foreign_id_min), round(vehicle.bus.foreign_id_max)
        if not all(low <= can_id <= high for can_id in SPECS):
            raise CommandError(
                f"vehicle {vehicle.name}: byte commands need the identifiers 0x{min(SPECS):03X} to"
                f" 0x{max(SPECS):03X} within bus.foreign_id_min 0x{low:03X} to foreign_id_max"
                f" 0x{high:03X}"
            )
        self.acceptance = frozenset(COMMAND_IDS)
        self._vehicle = vehicle
        self._kinematics = Kinematics.of(vehicle.geometry, vehicle.steering)
        self._age_ns_max = decision_age_ns_max(planner_period_ns)
        self._set: dict[str, tuple[int, int]] = {}
        self._decided_ns: int | None = None
        self._was_manual = False
        self._setpoint_mps = 0.0
        self._er0_ns: int | None = None
        self._told: ByteErrors | None = None
        self._errors_due_ns = 0

    def step(self, now_ns: int, received: Sequence[ReceivedFrame], car: CarState) -> ByteOutput:
        """One cycle.

        Args:
            now_ns: Never goes back.
            received: Frames since the last step, in order of arrival; others than the three
                commands are left alone.
            car: As the gateway knows it now.
        """
        frames = [echo for item in received if (echo := self._take(item)) is not None]
        fresh = {
            name: value
            for name, (value, arrival_ns) in self._set.items()
            if now_ns - arrival_ns <= self._age_ns_max
        }
        if car.mode is not Mode.READY:
            self._was_manual = car.mode is Mode.MANUAL
        decision, age_ns, wants_engage = None, 0, False
        if len(fresh) == len(COMMANDS):
            age_ns = now_ns - min(arrival_ns for _, arrival_ns in self._set.values())
            self._set.clear()
            decision = self._decide(now_ns, fresh, car)
            may_engage = car.mode is Mode.READY and self._was_manual
            wants_engage = may_engage and fresh["BYTE_ACCELERATE"] == 0
        frames += self._errors(now_ns, car)
        return ByteOutput(
            frames=tuple(frames),
            decision=decision,
            age_s=age_ns / NS_PER_S,
            wants_engage=wants_engage,
        )

    def _take(self, item: ReceivedFrame) -> Frame | None:
        """Notes a command; the echo, or None for what is no command."""
        frame = item.frame
        name = COMMAND_IDS.get(frame.can_id)
        if name is None or frame.kind in (FrameKind.ERROR, FrameKind.EXTENDED):
            return None  # an extended identifier is another one
        spec = _SPEC[name]
        if frame.kind is not FrameKind.DATA or len(frame.data) != spec.length:
            self._er0_ns = item.arrival_ns
            return None
        bits = int.from_bytes(frame.data, "little")
        (field,) = spec.units
        self._set[name] = getattr(spec.unpack(bits), field), item.arrival_ns
        return _frame(ECHO_SPEC[name], bits)

    def _decide(self, now_ns: int, fresh: dict[str, int], car: CarState) -> Decision:
        before_ns, self._decided_ns = self._decided_ns, now_ns
        since_ns = 0 if before_ns is None else min(now_ns - before_ns, self._age_ns_max)
        self._setpoint_mps = self._speed_mps(since_ns / NS_PER_S, fresh, car)
        angle_rad = fresh["BYTE_STEER"] / STEER_SPAN * self._vehicle.steering.wheel_angle_rad_max
        curvature_max = self._vehicle.curvature_per_m_max
        curvature = self._kinematics.curvature_per_m(angle_rad)
        return decide(
            self._vehicle,
            speed_mps=self._setpoint_mps,
            curvature_per_m=min(max(curvature, -curvature_max), curvature_max),
        )

    def _speed_mps(self, span_s: float, fresh: dict[str, int], car: CarState) -> float:
        """The setpoint after this set; that of a car that does not drive by it is its own speed."""
        traction, brake = self._vehicle.traction, self._vehicle.brake
        measured_mps = max(car.speed_mps, 0.0)
        if not measured_mps <= traction.speed_mps_max + SETPOINT_LEAD_MPS:
            measured_mps = 0.0  # not known, or beyond what can be asked for: nothing but slower
        if not car.is_engaged:
            return min(measured_mps, traction.speed_mps_max)
        if fresh["BYTE_BRAKE"]:
            change_mps2 = -fresh["BYTE_BRAKE"] / BYTE_MAX * brake.deceleration_mps2_full
        elif fresh["BYTE_ACCELERATE"]:
            change_mps2 = fresh["BYTE_ACCELERATE"] / BYTE_MAX * traction.acceleration_mps2_max
        else:
            change_mps2 = -traction.rolling_resistance_mps2
        wanted_mps = self._setpoint_mps + change_mps2 * span_s
        high_mps = min(traction.speed_mps_max, measured_mps + SETPOINT_LEAD_MPS)
        return min(max(wanted_mps, 0.0), high_mps)

    def _errors(self, now_ns: int, car: CarState) -> list[Frame]:
        """BYTE_ERRORS, in its cycle and at once on a change."""
        is_bad = self._er0_ns is not None and now_ns - self._er0_ns <= ER0_SHOWN_NS
        codes: set[Any] = {ErrorCode.ER2} if car.codes is None else set(car.codes)
        if is_bad:
            codes.add(ErrorCode.ER0)
        er0, er1, er2, er3, er4, er5, er6 = (ErrorCode(number) in codes for number in range(7))
        told = ByteErrors(
            er0=er0, er1=er1, er2=er2, er3=er3, er4=er4, er5=er5, er6=er6,
            is_engaged=car.is_engaged,
        )  # fmt: skip
        if told == self._told and now_ns < self._errors_due_ns:
            return []
        self._told = told
        self._errors_due_ns = now_ns + ERRORS_SPEC.cycle_ns
        return [_frame(ERRORS_SPEC, ERRORS_SPEC.pack(told))]


def _frame(spec: MessageSpec, bits: int) -> Frame:
    return Frame(spec.can_id, frame_data(spec, bits))


def serve(
    commands: ByteCommands,
    car: Car,
    now_ns: int,
    received: Sequence[ReceivedFrame],
    send: Callable[[Frame], Any],
) -> str:
    """One cycle between a bus and a car.

    Args:
        commands: Of this planner.
        car: Open.
        now_ns: On the clock of the car's link.
        received: Frames since the last cycle.
        send: Puts a frame on the bus.

    Returns:
        Why the car is not engaged, when it was asked to be and refused; else nothing.

    Raises:
        LinkFailed: The connection to the car broke.
    """
    output = commands.step(now_ns, received, car.state)
    for frame in output.frames:
        send(frame)
    if output.decision is not None:
        car.command(
            speed_mps=output.decision.speed_mps,
            curvature_per_m=output.decision.curvature_per_m,
            age_s=output.age_s,
        )
    if output.wants_engage:
        try:
            car.engage(timeout_s=ENGAGE_S)
        except EngageRefused as refused:
            return str(refused)
    return ""
