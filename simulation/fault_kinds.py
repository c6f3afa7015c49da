"""Every kind of fault there is, as a table: what it strikes, how much is allowed, what it does."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, StrEnum

from canbus.node import NODE_IDS
from dbc.messages import SPECS
from vehicles import Vehicle
from vehicles.vehicle import DRIVE_NAMES


class FaultKind(StrEnum):
    """What goes wrong."""

    # one message, on its way
    DROP = "drop"
    DELAY = "delay"
    DUPLICATE = "duplicate"
    CORRUPT_BEFORE_CRC = "corrupt_before_crc"
    CORRUPT_ON_WIRE = "corrupt_on_wire"
    TRUNCATE = "truncate"
    REPLAY = "replay"
    SPOOF = "spoof"
    # one node, its computer or its controller
    CRASH = "crash"
    FREEZE = "freeze"
    SLOW_STEP = "slow_step"
    JITTER = "jitter"
    RESTART = "restart"
    CLOCK_JUMP = "clock_jump"
    CLOCK_DRIFT = "clock_drift"
    MUTE = "mute"
    DEAF = "deaf"
    BUS_OFF = "bus_off"
    BABBLE = "babble"
    # the bus, or all nodes
    FLOOD = "flood"
    NOISE = "noise"
    BROWN_OUT = "brown_out"
    # one reading
    SENSOR_STUCK = "sensor_stuck"
    SENSOR_OFFSET = "sensor_offset"
    SENSOR_NOISE = "sensor_noise"
    SENSOR_OUT_OF_BOUNDS = "sensor_out_of_bounds"
    SENSOR_NAN = "sensor_nan"
    SENSOR_SWAPPED = "sensor_swapped"
    ENCODER_DEAD = "encoder_dead"
    # one actuator
    ACTUATOR_STUCK = "actuator_stuck"
    ACTUATOR_WEAK = "actuator_weak"
    ACTUATOR_SLOW = "actuator_slow"
    ACTUATOR_HOT = "actuator_hot"
    # one motor drive on the bus
    DRIVE_FAULT = "drive_fault"
    DRIVE_DEAD = "drive_dead"
    DRIVE_MUTE = "drive_mute"
    DRIVE_DEAF = "drive_deaf"
    # the planner
    PLANNER_FROZEN = "planner_frozen"
    PLANNER_LATE = "planner_late"
    PLANNER_ABSURD = "planner_absurd"
    PLANNER_OSCILLATING = "planner_oscillating"
    PLANNER_NAN = "planner_nan"
    # the driver and the road
    DRIVER_GRABS = "driver_grabs"
    FRICTION = "friction"
    SLOPE = "slope"
    LOAD = "load"


class Strikes(Enum):
    """What a kind of fault can be aimed at."""

    MESSAGE = "message"
    NODE = "node"
    SENSOR = "sensor"
    ENCODER = "encoder"
    ACTUATOR = "actuator"
    DRIVE = "drive"
    CONTROL = "control"
    NOTHING = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec:
    """One analogue reading.

    Attributes:
        node: the ECU that reads it.
        field: in that ECU's `ports.py`.
        full_scale: what a share of its range means, in its own unit.
    """

    node: str
    field: str
    full_scale: float


SENSORS = {
    f"{spec.node}.{spec.field}": spec
    for spec in (
        SensorSpec(node="Steering", field="column_angle_rad", full_scale=9.25),
        SensorSpec(node="Steering", field="driver_torque_nm", full_scale=10.0),
        SensorSpec(node="Throttle", field="pedal_ratio", full_scale=1.0),
        SensorSpec(node="BrakeServo", field="servo_position_ratio", full_scale=1.0),
        SensorSpec(node="BrakeServo", field="pedal_ratio", full_scale=1.0),
    )
}
"""Analogue readings by `Node.field`; the encoders have a fault of their own."""

ANGLE = "Steering.column_angle_rad"
PATTERN_ANGLE_RAD_MAX = 9.6
"""Beyond it the sensor of the car with the full scale above (TABBY EVO) counts as broken."""

SWAPPED_WITH = {
    "Steering.column_angle_rad": "driver_torque_nm",
    "Steering.driver_torque_nm": "column_angle_rad",
    "Throttle.pedal_ratio": "encoder_edge_age_s",
    "BrakeServo.servo_position_ratio": "pedal_ratio",
    "BrakeServo.pedal_ratio": "servo_position_ratio",
}
"""Which of its node's inputs a sensor is plugged into by mistake."""

assert SWAPPED_WITH.keys() == SENSORS.keys()

TARGETS: dict[Strikes, tuple[str, ...]] = {
    Strikes.MESSAGE: tuple(spec.name for spec in SPECS.values() if spec.data_id is not None),
    Strikes.NODE: tuple(NODE_IDS),
    Strikes.SENSOR: tuple(SENSORS),
    Strikes.ENCODER: ("Throttle", "BrakeServo"),
    Strikes.ACTUATOR: ("Steering", "Throttle", "BrakeServo"),
    Strikes.DRIVE: DRIVE_NAMES,
    Strikes.CONTROL: ("steering", "throttle", "brake", "button", "emergency_stop"),
    Strikes.NOTHING: ("",),
}
"""What may be named as a target."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KindSpec:
    """What one kind of fault means.

    Attributes:
        strikes: what its target names.
        does: in words; `{value}` with its unit is how much.
        unit: of the value; empty: it has none.
        low, high: allowed values, both included.
        default: the value when none is given.
        has_share: whether it may strike only a share of the frames or readings.
        is_instant: it happens once and has no span.
    """

    strikes: Strikes
    does: str
    unit: str = ""
    low: float = 0.0
    high: float = 0.0
    default: float = 0.0
    has_share: bool = False
    is_instant: bool = False


def _message(does: str, unit: str = "", low: float = 0.0, high: float = 0.0,
             default: float = 0.0) -> KindSpec:
    return KindSpec(strikes=Strikes.MESSAGE, does=does, unit=unit, low=low, high=high,
                    default=default, has_share=True)


def _node(does: str, unit: str = "", low: float = 0.0, high: float = 0.0,
          default: float = 0.0, *, is_instant: bool = False) -> KindSpec:
    return KindSpec(strikes=Strikes.NODE, does=does, unit=unit, low=low, high=high,
                    default=default, is_instant=is_instant)


def _sensor(does: str, unit: str = "", low: float = 0.0, high: float = 0.0,
            default: float = 0.0) -> KindSpec:
    return KindSpec(strikes=Strikes.SENSOR, does=does, unit=unit, low=low, high=high,
                    default=default)


def _actuator(does: str, unit: str = "", low: float = 0.0, high: float = 0.0,
              default: float = 0.0) -> KindSpec:
    return KindSpec(strikes=Strikes.ACTUATOR, does=does, unit=unit, low=low, high=high,
                    default=default)


def _drive(does: str) -> KindSpec:
    return KindSpec(strikes=Strikes.DRIVE, does=does)


def _other(does: str, unit: str = "", low: float = 0.0, high: float = 0.0,
           default: float = 0.0, *, has_share: bool = False, is_instant: bool = False) -> KindSpec:
    return KindSpec(strikes=Strikes.NOTHING, does=does, unit=unit, low=low, high=high,
                    default=default, has_share=has_share, is_instant=is_instant)


_K = FaultKind
KINDS: dict[FaultKind, KindSpec] = {
    _K.DROP: _message("never reaches anybody"),
    _K.DELAY: _message("leaves {value} late", "ms", 0.1, 1000.0, 20.0),
    _K.DUPLICATE: _message("is followed by {value} more of the same", "", 1.0, 10.0, 1.0),
    _K.CORRUPT_BEFORE_CRC: _message("has {value} of its bits flipped in its sender's memory", "",
                                    1.0, 64.0, 1.0),
    _K.CORRUPT_ON_WIRE: _message("is disturbed on the wire, at bit {value}", "", 0.0, 127.0, 40.0),
    _K.TRUNCATE: _message("arrives with {value} of its bytes", "", 0.0, 7.0, 4.0),
    _K.REPLAY: _message("is sent again by a stranger {value} later", "s", 0.001, 60.0, 1.0),
    _K.SPOOF: _message("is followed by a stranger's, in sequence and with the right CRC"),
    _K.CRASH: _node("stops for good, its actuator's watchdog starves"),
    _K.FREEZE: _node("does nothing, then goes on with all that has come meanwhile"),
    _K.SLOW_STEP: _node("takes {value} for every step", "ms", 0.1, 200.0, 20.0),
    _K.JITTER: _node("begins each cycle up to {value} late", "ms", 0.1, 200.0, 4.0),
    _K.RESTART: _node("loses its power for {value}", "s", 0.001, 10.0, 0.2, is_instant=True),
    _K.CLOCK_JUMP: _node("finds its clock {value} ahead", "ms", 0.001, 10_000.0, 100.0,
                         is_instant=True),
    _K.CLOCK_DRIFT: _node("has a clock that drifts by {value}", "ppm", -9000.0, 9000.0, 5000.0),
    _K.MUTE: _node("is heard by nobody"),
    _K.DEAF: _node("hears nobody"),
    _K.BUS_OFF: _node("is driven off the bus", is_instant=True),
    _K.BABBLE: _node("repeats its last frame {value}", "per s", 1.0, 10_000.0, 2000.0),
    _K.FLOOD: _other("a stranger sends identifier 0 {value}", "per s", 1.0, 20_000.0, 20_000.0),
    _K.NOISE: _other("frames are disturbed on the wire", has_share=True),
    _K.BROWN_OUT: _other("all nodes lose their power for {value}", "s", 0.001, 10.0, 0.3,
                         is_instant=True),
    _K.SENSOR_STUCK: _sensor("stays where it is"),
    _K.SENSOR_OFFSET: _sensor("is {value} off", "of its range", -2.0, 2.0, 0.2),
    _K.SENSOR_NOISE: _sensor("jumps about with {value}", "of its range", 0.0, 2.0, 0.1),
    _K.SENSOR_OUT_OF_BOUNDS: _sensor("shows {value}", "of its range", 1.05, 100.0, 1.5),
    _K.SENSOR_NAN: _sensor("cannot be read"),
    _K.SENSOR_SWAPPED: _sensor("shows what another of the node's sensors reads"),
    _K.ENCODER_DEAD: KindSpec(strikes=Strikes.ENCODER, does="sends no edges any more"),
    _K.ACTUATOR_STUCK: _actuator("keeps its command"),
    _K.ACTUATOR_WEAK: _actuator("does {value} of what is asked", "", 0.0, 1.0, 0.3),
    _K.ACTUATOR_SLOW: _actuator("follows with a lag of {value}", "s", 0.001, 10.0, 0.5),
    _K.ACTUATOR_HOT: _actuator("loses all power within {value}", "s", 0.001, 100.0, 2.0),
    _K.DRIVE_FAULT: _drive("trips, and cannot be reset meanwhile"),
    _K.DRIVE_DEAD: _drive("has no power"),
    _K.DRIVE_MUTE: _drive("is heard by nobody"),
    _K.DRIVE_DEAF: _drive("hears nobody"),
    _K.PLANNER_FROZEN: _other("decides nothing any more"),
    _K.PLANNER_LATE: _other("decides every {value}", "ms", 20.0, 5000.0, 80.0),
    _K.PLANNER_ABSURD: _other("jumps between the ends of what is allowed"),
    _K.PLANNER_OSCILLATING: _other("swings its curvature {value}", "per s", 0.05, 25.0, 1.0),
    _K.PLANNER_NAN: _other("asks for NaN"),
    _K.DRIVER_GRABS: KindSpec(
        strikes=Strikes.CONTROL, does="the driver uses it with {value} of his strength",
        low=0.0, high=1.0, default=1.0,
    ),
    _K.FRICTION: _other("the tyres' friction is {value}", "", 0.05, 1.5, 0.3),
    _K.SLOPE: _other("the road climbs by {value}", "rad", -0.3, 0.3, 0.1),
    _K.LOAD: _other("the car carries {value} more", "kg", 0.0, 1000.0, 300.0),
}
"""All kinds."""

assert KINDS.keys() == set(FaultKind)
assert all(spec.low <= spec.default <= spec.high for spec in KINDS.values())


NOT_WIRED: dict[Strikes, frozenset[str]] = {
    Strikes.ACTUATOR: frozenset({"Steering", "Throttle"}),
    Strikes.ENCODER: frozenset({"Throttle"}),
}
"""What an ECU has no wire to where motor drives on the bus do it."""


def targets_of(vehicle: Vehicle) -> dict[FaultKind, tuple[str, ...]]:
    """Kinds of fault that a car can have, with what each may strike there."""
    if vehicle.drives is None:
        others = {k: spec for k, spec in KINDS.items() if spec.strikes is not Strikes.DRIVE}
        return {kind: TARGETS[spec.strikes] for kind, spec in others.items()}
    return {
        kind: tuple(
            name for name in TARGETS[spec.strikes]
            if name not in NOT_WIRED.get(spec.strikes, frozenset())
        )
        for kind, spec in KINDS.items()
    }


def full_scale(vehicle: Vehicle, target: str) -> float:
    """What a sensor's whole range is, in its own unit: of the steering angle's, by the vehicle."""
    size = SENSORS[target].full_scale
    if target == ANGLE:
        size *= vehicle.steering.sensor_angle_rad_max / PATTERN_ANGLE_RAD_MAX
    return size


def described(kind: FaultKind, value: float) -> str:
    """What a fault does, with its number."""
    spec = KINDS[kind]
    number = "NaN" if math.isnan(value) else f"{value:g}"
    return spec.does.replace("{value}", f"{number} {spec.unit}".strip())
