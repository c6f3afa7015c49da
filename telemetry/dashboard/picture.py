"""What the page shows, from the frames of a bus: values by name, and what to append.

Sans-I/O: fed with frames, asked a fixed number of times a second however fast the bus is. A value
whose message no longer comes as its DBC says is None, never the last one known. Memory is bounded.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from canbus.heard import Heard
from dbc.codec import Decoded, decode_data
from dbc.messages import SPECS, BrakeStatus, Reason, SteerStatus, SupervisorState, ThrottleStatus
from gateway.kinematics import Kinematics
from gateway.sentences import NODE_TEXT, REASON_TEXT
from gateway.state import codes_of, why_not_engaged
from telemetry.dashboard.track import Track
from telemetry.monitor.health import car_health, node_health
from telemetry.monitor.known import Catalogue
from telemetry.monitor.meaning import Interpreter
from telemetry.monitor.model import BusModel, Presence
from telemetry.why.incident import Incident
from telemetry.why.refusals import NOBODY
from telemetry.why.watch import CodeOnset, ModeChange, Told, Watch
from telemetry.why.words import summary
from vehicles import Vehicle

NS_PER_S: Final = 1_000_000_000
SLOW_STEPS: Final = 5
"""Nodes and bus load are looked at in one step of so many."""
LOG_MAX: Final = 300
SILENT_NS: Final = 300_000_000
"""A bus without frames for so long is told to be silent: six frames of its slowest cycle."""
DIGITS: Final = 4
PLOTTABLE: Final = {
    f"{spec.name}.{signal}": "" if unit == "1" else unit
    for spec in SPECS.values()
    if spec.cycle_ns and not spec.name.endswith("_HEARTBEAT")
    for signal, unit in spec.units.items()
}
"""Signals that can be plotted, with their units."""

Values = dict[str, Any]
"""Values as JSON has them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HumanClock:
    """What a monotonic time in ns is to people."""

    unix_s: Callable[[int], float]
    """Seconds since 1970."""
    text: Callable[[int], str]
    """Time of day, as the log's lines have it."""


class Picture:
    """One bus.

    Args:
        vehicle: What its nodes believe about the car.
        channel: Its name.
        bitrate_bps: Of the bus.
        clock: What monotonic times are to people.
    """

    def __init__(
        self, vehicle: Vehicle, channel: str, bitrate_bps: int, clock: HumanClock
    ) -> None:
        self._model = BusModel(Interpreter(Catalogue()), [channel])
        self._watch = Watch(vehicle)
        self._kinematics = Kinematics.of(vehicle.geometry, vehicle.steering)
        self._bitrate_bps = bitrate_bps
        self._clock = clock
        self._track = Track()
        self._log: deque[Values] = deque(maxlen=LOG_MAX)
        self._news: list[Values] = []
        self._codes: dict[str, Values] = {}
        self._newest_ns: int | None = None
        self._steps = 0
        self._shown: Values = {}

    def feed(self, heard: Sequence[Heard], now_ns: int, offset_ns: int) -> None:
        """Frames since the last call.

        Args:
            heard: In order of time.
            now_ns: Monotonic, as everything here.
            offset_ns: Monotonic minus system time, to be added to their stamps.
        """
        self._model.feed(heard, offset_ns)
        take = self._watch.take
        for item in heard:
            time_ns = item.time_ns + offset_ns
            self._tell(take(time_ns, item.frame()))
        if heard:
            self._newest_ns = heard[-1].time_ns + offset_ns
        self._tell(self._watch.elapse(now_ns))

    def say(self, now_ns: int, kind: str, text: str) -> None:
        """A line for the log, of something that the bus does not tell."""
        line = {"at": round(self._clock.unix_s(now_ns), 3), "kind": kind, "text": text}
        self._log.append(line)
        self._news.append(line)

    def step(self, now_ns: int) -> Values:
        """What has changed since the last step, with the lines and points to append."""
        values = self._car(now_ns)
        added = self._track.take(now_ns, values.pop("speed"), values.pop("curvature"))
        values |= self._pose()
        if self._steps % SLOW_STEPS == 0:
            self._model.tick(now_ns)
            values |= self._bus(now_ns)
        self._steps += 1
        shown = self._shown
        changes = {key: value for key, value in values.items() if shown.get(key, ...) != value}
        shown |= changes
        if added:
            changes["path"] = [_point(self._track.points[-1])]
        if self._news:
            changes["log"], self._news = self._news, []
        return changes

    def whole(self) -> Values:
        """Everything as of the last step, for a page that has nothing yet."""
        points = [_point(point) for point in self._track.points]
        return {**self._shown, "path": points, "log": list(self._log)}

    def plotted(self, names: Iterable[str], now_ns: int) -> list[float | None]:
        """The newest values of signals of PLOTTABLE; an enumeration's number."""
        messages: dict[str, Any] = {}
        values = []
        for name in names:
            message, _, signal = name.partition(".")
            if message not in messages:
                messages[message] = self._newest(message, now_ns)
            values.append(_number(getattr(messages[message], signal, math.nan)))
        return values

    # What is shown --------------------------------------------------------------------------

    def _newest(self, name: str, now_ns: int) -> Any:
        """The newest message of a name; None if it is too old or cannot be believed."""
        row = self._model.row_of(name)
        if row is None or row.heard is None or row.presence(now_ns) is Presence.MISSING:
            return None
        decoded = decode_data(row.heard.can_id, row.heard.data)
        return decoded.message if isinstance(decoded, Decoded) else None

    def _car(self, now_ns: int) -> Values:
        steer: SteerStatus | None = self._newest("STEER_STATUS", now_ns)
        throttle: ThrottleStatus | None = self._newest("THROTTLE_STATUS", now_ns)
        brake: BrakeStatus | None = self._newest("BRAKE_STATUS", now_ns)
        nothing = math.nan
        wheel_rad = nothing if steer is None else steer.steering_wheel_angle_rad
        set_rad = nothing if steer is None else steer.applied_steering_wheel_angle_rad
        speed_mps = set_mps = nothing
        if throttle is not None:
            speed_mps = self._kinematics.speed_mps(wheel_rad, throttle.wheel_speed_radps)
            set_mps = self._kinematics.speed_mps(wheel_rad, throttle.applied_wheel_speed_radps)
        silent_ns = now_ns - (self._newest_ns or now_ns)
        return {
            "speed": speed_mps,
            "curvature": self._kinematics.curvature_per_m(wheel_rad),
            "speed_mps": _number(speed_mps),
            "speed_setpoint_mps": _number(set_mps),
            "wheel_rad": _number(wheel_rad),
            "wheel_setpoint_rad": _number(set_rad),
            "servo_ratio": _number(nothing if brake is None else brake.servo_position_ratio),
            **self._driver(now_ns),
            **self._supervisor(now_ns),
            "heard": self._newest_ns is not None,
            "silent_s": round(silent_ns / NS_PER_S, 1) if silent_ns > SILENT_NS else 0,
        }

    def _driver(self, now_ns: int) -> Values:
        hands, foot, brake = (
            self._newest(f"{name}_DRIVER", now_ns) for name in ("STEER", "THROTTLE", "BRAKE")
        )
        return {
            "torque_nm": _number(getattr(hands, "torque_nm", math.nan)),
            "throttle_pedal_ratio": _number(getattr(foot, "pedal_ratio", math.nan)),
            "brake_pedal_ratio": _number(getattr(brake, "pedal_ratio", math.nan)),
            "driver_active": any(
                getattr(message, "driver_active", False) for message in (hands, foot, brake)
            ),
        }

    def _supervisor(self, now_ns: int) -> Values:
        state: SupervisorState | None = self._newest("SUPERVISOR_STATE", now_ns)
        verdict = self._newest("SAFETY_VERDICT", now_ns)
        age_s = math.inf
        row = self._model.row_of("SUPERVISOR_STATE")
        if row is not None and row.count:
            age_s = (now_ns - row.newest_ns) / NS_PER_S
        return {
            "mode": None if state is None else state.mode.name,
            "why": why_not_engaged(state, verdict, age_s, NOBODY),
            "verdict": None if verdict is None else verdict.verdict.name,
            "codes": None if state is None else self._latched(state, now_ns),
        }

    def _latched(self, state: SupervisorState, now_ns: int) -> list[Values]:
        """Latched codes, each with the time since which it is, and with who said why."""
        names = [code.name for code in codes_of(state)]
        codes = self._codes
        for name in [name for name in codes if name not in names]:
            del codes[name]
        since = round(self._clock.unix_s(now_ns), 3)
        for name in names:
            codes.setdefault(name, {"code": name, "since": since, "text": ""})
        return [dict(codes[name]) for name in names]

    def _pose(self) -> Values:
        track = self._track
        return {
            "x_m": round(track.x_m, 2),
            "y_m": round(track.y_m, 2),
            "heading_rad": round(track.heading_rad, 3),
            "driven_m": round(track.driven_m, 1),
        }

    def _bus(self, now_ns: int) -> Values:
        model = self._model
        car = car_health(model, now_ns)
        channel = next(iter(model.channels.values()))
        faults = sum(row.protection.faults for row in model.rows.values() if row.protection)
        return {
            "inhibit": None if car is None else car.inhibit,
            "load": round(channel.bits_per_s / self._bitrate_bps, 3),
            "load_max": round(channel.bits_per_s_max / self._bitrate_bps, 3),
            "frames_per_s": round(channel.frames_per_s),
            "error_frames": channel.errors,
            "bad_frames": faults,
            "nodes": [
                {
                    "name": node.name,
                    "presence": node.presence.value,
                    "nmt": node.nmt,
                    "state": node.state,
                    "codes": list(node.codes),
                    "missing": list(node.missing),
                    "late": list(node.late),
                }
                for node in node_health(model, now_ns)
            ],
        }

    # What has happened ----------------------------------------------------------------------

    def _tell(self, told: Iterable[Told]) -> None:
        for item in told:
            if isinstance(item, ModeChange):
                before = "" if item.before is None else f"{item.before.name} to "
                self.say(item.time_ns, "mode", f"mode {before}{item.after.name}")
            elif isinstance(item, CodeOnset):
                self._on_code(item)
            elif isinstance(item, Incident):
                self.say(item.time_ns, item.kind.value, summary(item, self._clock.text))

    def _on_code(self, onset: CodeOnset) -> None:
        name = onset.code.name
        reason = REASON_TEXT[Reason[onset.reason]] if onset.reason else "no reason told"
        text = f"{NODE_TEXT[onset.node]}: {reason}"
        self.say(onset.time_ns, "code", f"{name} from {text}")
        if name in self._codes:
            self._codes[name]["text"] = text


def _point(point: tuple[float, float]) -> list[float]:
    return [round(point[0], 2), round(point[1], 2)]


def _number(value: Any) -> float | None:
    """As JSON has it; None for NaN."""
    number = float(value)
    return round(number, DIGITS) if math.isfinite(number) else None
