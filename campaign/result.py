"""What one seed of a campaign came to: plain data, the same on every machine.

Only `cpu_s` differs from run to run; it is no part of what is compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


class Demand(StrEnum):
    """What a fault asks of a car that drives itself."""

    BRAKE = "brake"
    """The emergency brake must be called within the fault's time."""
    HANDOVER = "handover"
    """The driver must have the car within the fault's time."""
    ANY = "any"
    """It may brake, or show in a report alone, or not at all: no property may break."""
    GO_ON = "go on"
    """It must not stop the car: the timing, or the design, allows for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectionResult:
    """One injected fault and what followed.

    Attributes:
        kind, target: Of `simulation.fault_kinds`.
        at_s, for_s, value, share: As in `simulation.faults.Fault`; `for_s` infinite: until healed.
        demand: What it asked for.
        budget_ms: Its fault-tolerant time interval, for BRAKE and HANDOVER.
        is_clean: It began in a car that drove itself, with no other fault there or lately, and none
            came until it was answered.
        is_due: It asked for something, of a car that drove itself, and lasted for that time.
        latency_ms: From its beginning to what it asked for; for ANY and GO_ON, if it is clean, to
            the emergency brake. None: that never came, or may be another fault's.
        code: What the first EMERGENCY_BRAKE after it said (`ER2 NODE_SILENT`), or the first code
            that was reported; empty: nothing was said.
        is_detected: Something was said, or done, about it.
        is_missed: It was due and not answered in time, or stopped a car it must not stop.
    """

    kind: str
    target: str
    at_s: float
    for_s: float
    value: float
    share: float
    demand: Demand
    budget_ms: float | None
    is_clean: bool
    is_due: bool
    latency_ms: float | None
    code: str
    is_detected: bool
    is_missed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ViolationResult:
    """A property that broke.

    Attributes:
        property: Its name (`oracle/`), or that of one of the campaign's own.
        at_s: When it was found broken, in true time.
        text: In words, with numbers.
    """

    property: str
    at_s: float
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedResult:
    """One seed.

    Attributes:
        seed: Repeats it.
        simulated_s: Virtual time from power-on.
        engaged_s: Of it, the car drove itself.
        calm_s: Of `engaged_s`, no fault was there or lately: what false trips are counted over.
        stops: Drives that ended in EMERGENCY.
        false_trips: Of those, without any cause.
        repairs_s: For each drive that ended otherwise than by wish, the time from its end to the
            next drive; those that the seed's end cut off are left out.
        injections: In order of their beginning.
        violations: At most a handful of each property.
        excused: Violations that an active fault puts beyond a property, by design.
        corruptions: Frames changed on their way that yet went through.
        corruptions_unseen: Of those, with a fitting CRC-8.
        trace_sha256: Of every frame, with its time.
        cpu_s: Processor time it took.
    """

    seed: int
    simulated_s: float
    engaged_s: float
    calm_s: float
    stops: int
    false_trips: int
    repairs_s: tuple[float, ...]
    injections: tuple[InjectionResult, ...]
    violations: tuple[ViolationResult, ...]
    excused: int
    corruptions: int
    corruptions_unseen: int
    trace_sha256: str
    cpu_s: float = field(compare=False)
