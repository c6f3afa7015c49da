"""The fault matrix: every kind of fault, at every node, alone in a car that drives itself.

As `docs/fault-matrix.md` has it, written by `make matrix`.
"""

from __future__ import annotations

from collections.abc import Sequence

from campaign.futures import CARS, FAULT_S, SEEDS
from campaign.result import Demand, InjectionResult, SeedResult
from canbus.node import NODE_IDS
from dbc.endpoint import SPEC_OF_NAME
from simulation.fault_kinds import KINDS, SENSORS, FaultKind, Strikes, described
from simulation.faults import Fault
from telemetry.why.drives import ECU_OF_DRIVE

ALL = "car, bus, planner"
COLUMNS = (*NODE_IDS, ALL)
CONTROL_NODE = {"steering": "Steering", "throttle": "Throttle", "brake": "BrakeServo",
                "button": "Supervisor", "emergency_stop": "Supervisor"}
JUDGE = {
    Demand.BRAKE: "hazard answered in time",
    Demand.HANDOVER: "the driver wins",
    Demand.GO_ON: "no emergency brake without a reason",
    Demand.ANY: "all others",
}
"""Which property of `oracle/` looks at what a fault asks for."""

HEAD = """# Fault matrix

Written by `make matrix`; a test compares it with what happens. Every kind of fault, alone, of the
kind's own size and for {fault_s:g} s, in a car that drives itself on a winding road: {seeds}
drives, each forked for every fault, all judged by the properties of `oracle/`, of which none broke.
The car is {car}; faults of motor drives strike {other}.

A cell tells what the car did, the first code on the bus, and the worst time, in whole ms, from the
fault to EMERGENCY_BRAKE on the bus or the servo's full setpoint (to MANUAL where the driver takes
over), before the time that is allowed. A fault of a message stands in its sender's column, one of a
sensor, control or drive in the column of who reads or commands it. Where not all cases of a cell
ended alike, it says how many did.

"""


def column(fault: Fault | InjectionResult) -> str:
    """The node that a fault belongs to."""
    match KINDS[FaultKind(fault.kind)].strikes:
        case Strikes.MESSAGE:
            return SPEC_OF_NAME[fault.target].sender or ALL
        case Strikes.SENSOR:
            return SENSORS[fault.target].node
        case Strikes.NODE | Strikes.ENCODER | Strikes.ACTUATOR:
            return fault.target
        case Strikes.DRIVE:
            return ECU_OF_DRIVE[fault.target]
        case Strikes.CONTROL:
            return CONTROL_NODE[fault.target]
    return ALL


def matrix(results: Sequence[SeedResult]) -> str:
    """The document.

    Raises:
        AssertionError: A property broke, or a fault was missed.
    """
    cells: dict[tuple[str, str], list[InjectionResult]] = {}
    for result in results:
        (injection,) = result.injections
        assert not result.violations and not injection.is_missed, (result.seed, injection, result)
        cells.setdefault((injection.kind, column(injection)), []).append(injection)
    lines = [
        f"| fault | {' | '.join(COLUMNS)} | judged by |",
        "|" + "---|" * (len(COLUMNS) + 2),
    ]
    for kind, spec in KINDS.items():
        found = [cells.get((str(kind), name), []) for name in COLUMNS]
        judges = {JUDGE[item.demand] for items in found for item in items}
        lines.append(
            f"| **{kind}**: {described(kind, spec.default)} | "
            f"{' | '.join(cell(items) for items in found)} | {', '.join(sorted(judges))} |"
        )
    head = HEAD.format(fault_s=FAULT_S, seeds=len(SEEDS), car=CARS[0], other=CARS[1])
    return head + "\n".join(lines) + "\n"


def cell(items: Sequence[InjectionResult]) -> str:
    """What became of one kind of fault at one node."""
    reacted = [item for item in items if item.latency_ms is not None]
    parts = []
    for verb, demands in (("MANUAL", {Demand.HANDOVER}),
                          ("brakes", {Demand.BRAKE, Demand.ANY, Demand.GO_ON})):
        some = [item for item in reacted if item.demand in demands]
        if some:
            parts.append(_reaction(verb, some, len(items)))
    silent = [item for item in items if item.latency_ms is None]
    if silent:
        codes = ", ".join(sorted({item.code for item in silent if item.code}))
        share = f"{len(silent)} of {len(items)} " if parts else ""
        parts.append(f"{share}goes on" + (f", says {codes}" if codes else ""))
    return "; ".join(parts)


def _reaction(verb: str, items: Sequence[InjectionResult], total: int) -> str:
    worst_ms = max(item.latency_ms or 0.0 for item in items)
    budgets = {item.budget_ms for item in items if item.is_due and item.budget_ms}
    of = f"/{min(budgets):.0f}" if budgets else ""
    codes = ", ".join(sorted({item.code for item in items if item.code}))
    share = f"{len(items)} of {total} " if len(items) < total else ""
    return f"{share}{verb}, {-(-worst_ms // 1):.0f}{of} ms" + (f": {codes}" if codes else "")
