"""What each fault asks of a car that drives itself, and how soon: its fault-tolerant time interval.

The times are the design's (docs/safety.md): what is sensed is on the bus within 20 ms and the wire,
any other fault that makes the car unsafe within 100 ms. A fault too small, too short or too
uncertain to be told from what is allowed asks for nothing: the properties of `oracle/` hold all the
same, and what it led to is reported.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from campaign.result import Demand
from oracle.settings import DRIVER_WINS_NS, HAZARD_NS, SENSED_NS, Settings
from simulation.fault_kinds import KINDS, SENSORS, FaultKind
from simulation.faults import Fault
from simulation.injector import FULL_TORQUE_NM
from vehicles.vehicle import DRIVE_NAMES

NS_PER_MS = 1_000_000
S_PER_MS = 1e-3
SILENT_MS = HAZARD_NS / NS_PER_MS
SENSED_MS = SENSED_NS / NS_PER_MS
TOUCH_MS = DRIVER_WINS_NS / NS_PER_MS
DEAF_MS = 150.0 + SENSED_MS
"""A drive that no longer hears its ECU (docs/drives.md)."""
GRIP_SHARE = 0.35
"""Of what a driver can do: above every threshold for hands and feet, by a margin, on the shipped
cars; others may have higher thresholds (`grip_share`)."""

RECOVERY_S = 10.0
"""A stop from full speed on the worst road (3 s), reset, button and engagement, and refusals for a
second or two between."""
LIED_RECOVERY_S = 50.0
"""Who was told of a great speed does not believe in a standstill before the car could have lost it
on the worst road: 92 m/s, the signal's end, at 2.5 m/s2 (`ecus/supervisor/standstill.py`)."""
LIES = frozenset({FaultKind.SPOOF, FaultKind.CORRUPT_BEFORE_CRC, FaultKind.REPLAY})
SPEEDS = frozenset({"THROTTLE_STATUS", "BRAKE_STATUS"})

CYCLIC = frozenset({
    "SUPERVISOR_STATE", "STEER_STATUS", "THROTTLE_STATUS", "BRAKE_STATUS", "SAFETY_VERDICT",
    "STEER_COMMAND", "THROTTLE_COMMAND", "BRAKE_COMMAND",
})
"""Messages without which the car must not drive."""
FULL_LOAD_PER_S = 12_000.0
"""More frames of identifier 0 than 500 kbit/s carry: nothing else gets through."""
PATH = "path error bounded"
OF_MODES = frozenset({
    "modes in order", "engaged in order", "emergency latched until the reset",
    "codes latched until the reset", "a node rejoins only by re-arming",
    "start-up ends in MANUAL with PERMIT",
})
"""What is judged by the supervisor's word, when that is heard too late."""
COASTS = frozenset({"steering coasts on ER4 and ER6"})
TORQUE_STAYS = frozenset({"no drive torque while emergency braking"})
BRAKE_IS_BROKEN = frozenset({
    "brake kept in an emergency", "hazard ends braked at a standstill",
    "no drive torque while emergency braking", "hazard answered in time",
    "no old decision is obeyed",
})
"""What no software keeps when the servo itself does not do as it is told."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """What one fault asks for.

    Attributes:
        demand: What must follow.
        budget_ms: Within this from its beginning; None: nothing must.
        excuses: Properties that this fault is beyond, by physics.
        recovery_s: After its end the car drives itself again within this.
        is_planners: Nothing but the planner's decisions is missing: a controlled stop needs none.
    """

    demand: Demand = Demand.ANY
    budget_ms: float | None = None
    excuses: frozenset[str] = frozenset()
    recovery_s: float = RECOVERY_S
    is_planners: bool = False


ANYTHING = Expectation()
GOES_ON = Expectation(demand=Demand.GO_ON)
BRAKES_IF_SILENT = Expectation(demand=Demand.BRAKE, budget_ms=SILENT_MS)
BRAKES_IF_SENSED = Expectation(demand=Demand.BRAKE, budget_ms=SENSED_MS)
HANDS_OVER = Expectation(demand=Demand.HANDOVER, budget_ms=TOUCH_MS)
OFF_THE_PATH = Expectation(excuses=frozenset({PATH}))

Rule = Callable[[Fault], Expectation]


def _always(expectation: Expectation) -> Rule:
    return lambda fault: expectation


def _if(condition: Callable[[Fault], bool], then: Expectation, otherwise: Expectation) -> Rule:
    return lambda fault: then if condition(fault) else otherwise


def _of_message(fault: Fault) -> Expectation:
    """All frames of a message that the car needs are gone, or useless."""
    is_all = fault.share == 1.0 and fault.target in CYCLIC
    return BRAKES_IF_SILENT if is_all else ANYTHING


def _delay(fault: Fault) -> Expectation:
    """What is heard late is heard in another order than it was said and done."""
    if fault.target == "SUPERVISOR_STATE":
        return Expectation(excuses=OF_MODES)
    if fault.target.endswith("_STATUS"):
        return Expectation(excuses=frozenset({"only intact commands are applied"}))
    return ANYTHING


def _grab(fault: Fault) -> Expectation:
    if fault.target == "emergency_stop":
        return BRAKES_IF_SENSED if fault.value > 0.0 else ANYTHING
    if fault.target == "button":
        return ANYTHING
    return HANDS_OVER


def _actuator(fault: Fault) -> Expectation:
    return {
        "BrakeServo": Expectation(excuses=BRAKE_IS_BROKEN),
        "Steering": OFF_THE_PATH,
        "Throttle": Expectation(excuses=TORQUE_STAYS),
    }.get(fault.target, ANYTHING)


def _drive(fault: Fault) -> Expectation:
    """Heard of within its ECU's 60 ms; a steering without drive, or with one that turns where it
    was told last, leaves the path first."""
    return replace(BRAKES_IF_SILENT, excuses=frozenset({PATH}))


def _deaf_drive(fault: Fault) -> Expectation:
    """It goes on as it was told last, and says so when it has missed its ECU for 150 ms."""
    stays = COASTS if fault.target == DRIVE_NAMES[0] else TORQUE_STAYS
    return Expectation(demand=Demand.BRAKE, budget_ms=DEAF_MS, excuses=stays | {PATH})


def _reading(fault: Fault) -> Expectation:
    return OFF_THE_PATH if SENSORS[fault.target].node == "Steering" else ANYTHING


_K = FaultKind
RULES: dict[FaultKind, Rule] = {
    _K.DROP: _of_message,
    _K.DELAY: _delay,
    _K.DUPLICATE: _always(ANYTHING),
    _K.CORRUPT_BEFORE_CRC: _always(ANYTHING),
    _K.CORRUPT_ON_WIRE: _always(ANYTHING),
    _K.TRUNCATE: _of_message,
    _K.REPLAY: _always(ANYTHING),
    _K.SPOOF: _of_message,
    _K.CRASH: _always(BRAKES_IF_SILENT),
    _K.FREEZE: _always(BRAKES_IF_SILENT),
    _K.SLOW_STEP: _if(  # a decision steps the gateway at once, however slow its own cycle is
        lambda fault: fault.value > SILENT_MS and fault.target != "Gateway",
        BRAKES_IF_SILENT, ANYTHING,
    ),
    _K.JITTER: _if(lambda fault: fault.value <= 4.0, GOES_ON, ANYTHING),
    _K.RESTART: _if(lambda f: f.value >= SILENT_MS * S_PER_MS, BRAKES_IF_SILENT, ANYTHING),
    _K.CLOCK_JUMP: _always(ANYTHING),
    _K.CLOCK_DRIFT: _always(ANYTHING),
    _K.MUTE: _always(BRAKES_IF_SILENT),
    _K.DEAF: _if(lambda fault: fault.target != "Gateway", BRAKES_IF_SILENT, ANYTHING),
    _K.BUS_OFF: _always(BRAKES_IF_SILENT),
    _K.BABBLE: _always(ANYTHING),
    _K.FLOOD: _if(lambda fault: fault.value >= FULL_LOAD_PER_S, BRAKES_IF_SILENT, ANYTHING),
    _K.NOISE: _if(lambda fault: fault.share == 1.0, BRAKES_IF_SILENT, ANYTHING),
    _K.BROWN_OUT: _if(lambda f: f.value >= SILENT_MS * S_PER_MS, BRAKES_IF_SILENT, ANYTHING),
    _K.SENSOR_STUCK: _reading,
    _K.SENSOR_OFFSET: _reading,
    _K.SENSOR_NOISE: _reading,
    _K.SENSOR_OUT_OF_BOUNDS: _if(
        lambda fault: fault.target == "Steering.driver_torque_nm", HANDS_OVER, BRAKES_IF_SENSED
    ),
    _K.SENSOR_NAN: _always(BRAKES_IF_SENSED),
    _K.SENSOR_SWAPPED: _reading,
    _K.ENCODER_DEAD: _always(ANYTHING),
    _K.ACTUATOR_STUCK: _actuator,
    _K.ACTUATOR_WEAK: _actuator,
    _K.ACTUATOR_SLOW: _actuator,
    _K.ACTUATOR_HOT: _actuator,
    _K.DRIVE_FAULT: _drive,
    _K.DRIVE_DEAD: _drive,
    _K.DRIVE_MUTE: _drive,
    _K.DRIVE_DEAF: _deaf_drive,
    _K.PLANNER_FROZEN: _always(BRAKES_IF_SILENT),
    _K.PLANNER_LATE: _always(ANYTHING),
    _K.PLANNER_ABSURD: _always(OFF_THE_PATH),
    _K.PLANNER_OSCILLATING: _always(OFF_THE_PATH),
    _K.PLANNER_NAN: _always(BRAKES_IF_SILENT),
    _K.DRIVER_GRABS: _grab,
    _K.FRICTION: _always(OFF_THE_PATH),
    _K.SLOPE: _always(ANYTHING),
    _K.LOAD: _always(ANYTHING),
}
"""By kind of fault."""

assert RULES.keys() == set(FaultKind)


def grip_share(settings: Settings) -> float:
    """The share of a driver's strength that is felt for certain, by whatever he uses."""
    return max(
        GRIP_SHARE,
        settings.driver_torque_nm / FULL_TORQUE_NM,
        settings.throttle_pedal_ratio,
        settings.brake_pedal_ratio,
    )


def expected(fault: Fault, grip: float = GRIP_SHARE) -> Expectation:
    """What this fault asks for; one that is over before its time asks for nothing.

    Args:
        fault: Injected.
        grip: Of the car's driver, `grip_share`.
    """
    expectation = RULES[fault.kind](fault)
    if expectation is HANDS_OVER and fault.kind is FaultKind.DRIVER_GRABS and fault.value < grip:
        expectation = OFF_THE_PATH
    budget_ms = expectation.budget_ms
    if budget_ms is not None and _lasts_ms(fault) < budget_ms:
        expectation = Expectation(excuses=expectation.excuses)
    if _is_planners(fault):
        expectation = replace(expectation, is_planners=True)
    if fault.kind in LIES and fault.target in SPEEDS:
        expectation = replace(expectation, recovery_s=LIED_RECOVERY_S)
    return expectation


def _is_planners(fault: Fault) -> bool:
    """Whether the planner, the gateway or its commands are all that is struck."""
    of_planner = fault.kind in (FaultKind.PLANNER_FROZEN, FaultKind.PLANNER_NAN)
    return of_planner or fault.target == "Gateway" or fault.target.endswith("_COMMAND")


def _lasts_ms(fault: Fault) -> float:
    """How long it is there; one that happens at an instant stays."""
    return math.inf if KINDS[fault.kind].is_instant else fault.for_s / S_PER_MS
