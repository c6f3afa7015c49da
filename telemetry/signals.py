"""Signals of a drive, decoded from its bus log: what the actuators were told and what they did."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dbc.codec import Decoded, decode
from dbc.endpoint import ID_OF_NAME
from dbc.messages import ErrorCode, Mode
from telemetry.bus_log import BusLog
from vehicles.vehicle import Vehicle

FloatArray = NDArray[np.float64]

CODES = tuple(ErrorCode(number) for number in range(7))
CODE_SOURCES = ("SUPERVISOR_STATE", "STEER_DRIVER", "THROTTLE_DRIVER", "BRAKE_DRIVER")
"""Messages that carry code bits."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trace:
    """One controlled quantity; arrays of shape (N,). NaN where the frame said "not available"."""

    time_s: FloatArray
    setpoint: FloatArray
    """Applied by the ECU: after its own limits."""
    measured: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Span:
    """Something that lasted from one time to another."""

    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeSpan(Span):
    """A driving mode."""

    mode: Mode


@dataclass(frozen=True, slots=True, kw_only=True)
class CodeSpan(Span):
    """An error code that a node reports or the supervisor has latched."""

    code: ErrorCode


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedSpan(Span):
    """Something else that lasted, in words."""

    name: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Staged:
    """What only a simulation can tell beside the bus. Arrays of shape (N,)."""

    time_s: FloatArray
    true_speed_mps: FloatArray
    """At the rear-axle centre."""
    faults: tuple[NamedSpan, ...]
    """In the order in which they are drawn."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signals:
    """Everything `signals.png` shows. Times count from the log's own zero."""

    steering_rad: Trace
    """Steering wheel, left positive."""
    speed_mps: Trace
    """At the rear-axle centre."""
    brake_ratio: Trace
    """Servo position, 1 is full."""
    modes: tuple[ModeSpan, ...]
    codes: tuple[CodeSpan, ...]
    end_s: float

    @property
    def emergency_brakes(self) -> int:
        """How often the supervisor entered EMERGENCY."""
        return sum(span.mode is Mode.EMERGENCY for span in self.modes)

    @property
    def code_names(self) -> tuple[str, ...]:
        """Codes that came up, in order of their number."""
        return tuple(code.name for code in CODES if any(s.code is code for s in self.codes))


def messages_of(log: BusLog, name: str) -> Iterator[tuple[float, Any]]:
    """`(time_s, message)` of every intact frame of one message."""
    for time_ns, frame in log.frames_of(ID_OF_NAME[name]):
        decoded = decode(frame)
        if isinstance(decoded, Decoded):
            yield time_ns / 1e9, decoded.message


def read_signals(log: BusLog, vehicle: Vehicle) -> Signals:
    """Decodes a log; a message that never came gives empty arrays."""
    steering = _trace(log, "STEER_STATUS", "steering_wheel_angle_rad")
    wheels = _trace(log, "THROTTLE_STATUS", "wheel_speed_radps")
    modes = tuple(_modes(log))
    end_s = max((span.end_s for span in modes), default=0.0)
    return Signals(
        steering_rad=steering,
        speed_mps=_at_rear_axle(wheels, steering, vehicle),
        brake_ratio=_trace(log, "BRAKE_STATUS", "servo_position_ratio", "applied_position_ratio"),
        modes=modes,
        codes=tuple(_codes(log)),
        end_s=end_s,
    )


def _trace(log: BusLog, name: str, measured: str, applied: str = "") -> Trace:
    applied = applied or f"applied_{measured}"
    rows = [
        (time_s, getattr(message, applied), getattr(message, measured))
        for time_s, message in messages_of(log, name)
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return Trace(time_s=table[:, 0], setpoint=table[:, 1], measured=table[:, 2])


def _at_rear_axle(wheels: Trace, steering: Trace, vehicle: Vehicle) -> Trace:
    """Wheel speed to speed of the rear axle's centre: v = omega r cos(theta) (UAH Eq. 14)."""
    if not len(wheels.time_s) or not len(steering.time_s):
        return wheels
    radius_m, ratio = vehicle.geometry.wheel_radius_m, vehicle.steering.ratio
    angle_rad = np.interp(wheels.time_s, steering.time_s, steering.measured) / ratio
    along = radius_m * np.cos(angle_rad)
    return Trace(
        time_s=wheels.time_s, setpoint=wheels.setpoint * along, measured=wheels.measured * along
    )


def _modes(log: BusLog) -> Iterator[ModeSpan]:
    start_s = end_s = 0.0
    mode: Mode | None = None
    for time_s, state in messages_of(log, "SUPERVISOR_STATE"):
        if mode is not None and state.mode is not mode:
            yield ModeSpan(start_s=start_s, end_s=time_s, mode=mode)
            start_s = time_s
        elif mode is None:
            start_s = time_s
        mode, end_s = state.mode, time_s
    if mode is not None:
        yield ModeSpan(start_s=start_s, end_s=end_s, mode=mode)


def _codes(log: BusLog) -> Iterator[CodeSpan]:
    for name in CODE_SOURCES:
        since: dict[ErrorCode, float] = {}
        time_s = 0.0
        for time_s, message in messages_of(log, name):
            for code in CODES:
                is_set = getattr(message, f"er{code.value}")
                if is_set and code not in since:
                    since[code] = time_s
                elif not is_set and code in since:
                    yield CodeSpan(start_s=since.pop(code), end_s=time_s, code=code)
        for code, start_s in since.items():
            yield CodeSpan(start_s=start_s, end_s=time_s, code=code)
