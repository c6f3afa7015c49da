"""Storms of faults, drawn by seed.

Swarm testing (Groce et al. 2012): each seed leaves most kinds of fault out, at random, so that the
rest meets itself often and in every company. Storms of one or several faults alternate with calm
in which the car must come back by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from numpy.random import Generator

from simulation.fault_kinds import KINDS, FaultKind
from simulation.faults import Fault

FIRST_S: Final = 6.0
"""Started, engaged and up to speed."""
STORM_S: Final = 2.0
"""Faults begin within this."""
CALM_S: Final = 11.0
"""After the last fault's end: to come to a stand, to be reset, to engage, to drive."""
ON_SHARE = 0.3
"""Of the kinds, for each seed."""
CALM_SEED_SHARE = 0.1
"""Seeds without any fault: what false trips are counted over."""
ALONE_SHARE = 0.5
"""Storms of a single fault."""
FAULTS_MAX = 5
SPANS_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
VALUE_MAX = {
    FaultKind.RESTART: 1.5, FaultKind.BROWN_OUT: 1.5, FaultKind.REPLAY: 2.0,
    FaultKind.ACTUATOR_HOT: 2.0, FaultKind.PLANNER_LATE: 500.0,
}
"""Smaller than what the kind allows, so that the storm's end is the fault's end."""
CLOCK_JUMP_MS = (1.0, 3000.0)


def storms(
    duration_s: float, rng: Generator, targets: Mapping[FaultKind, tuple[str, ...]]
) -> list[Fault]:
    """All faults of one seed, in order of their beginning.

    Args:
        duration_s: Of the seed.
        rng: Its chance.
        targets: What the car can have, and where (`fault_kinds.targets_of`).
    """
    if rng.random() < CALM_SEED_SHARE:
        return []
    chosen = [kind for kind in targets if rng.random() < ON_SHARE] or list(targets)
    faults: list[Fault] = []
    begin_s = FIRST_S + float(rng.uniform(0.0, 2.0))
    while True:
        count = 1 if rng.random() < ALONE_SHARE else int(rng.integers(2, FAULTS_MAX + 1))
        storm = [_draw(begin_s, chosen, targets, rng) for _ in range(count)]
        over_s = max(_end_s(fault) for fault in storm)
        if over_s + CALM_S > duration_s:
            break
        faults += storm
        begin_s = over_s + CALM_S + float(rng.uniform(0.0, 2.0))
    return sorted(faults, key=lambda fault: fault.at_s)


def _draw(
    begin_s: float,
    kinds: list[FaultKind],
    targets: Mapping[FaultKind, tuple[str, ...]],
    rng: Generator,
) -> Fault:
    kind = kinds[int(rng.integers(len(kinds)))]
    spec, names = KINDS[kind], targets[kind]
    is_partial = spec.has_share and rng.random() < 0.5
    return Fault(
        kind=kind,
        target=names[int(rng.integers(len(names)))],
        at_s=round(begin_s + float(rng.uniform(0.0, STORM_S)), 6),
        for_s=float(rng.choice(SPANS_S)),
        value=_value(kind, rng),
        share=round(float(rng.uniform(0.05, 1.0)), 3) if is_partial else 1.0,
    )


def _value(kind: FaultKind, rng: Generator) -> float:
    """As a rule that of the kind, else any that is allowed; whole numbers where the kind counts."""
    spec = KINDS[kind]
    if spec.low == spec.high or rng.random() < 0.5:
        return spec.default
    low, high = CLOCK_JUMP_MS if kind is FaultKind.CLOCK_JUMP else (spec.low, spec.high)
    value = float(rng.uniform(low, min(high, VALUE_MAX.get(kind, high))))
    return float(f"{value:.4g}")


def _end_s(fault: Fault) -> float:
    """When it is over, and what it sets off: a restart takes its value, a replay comes so late."""
    lasts_s = fault.for_s
    if fault.kind in (FaultKind.RESTART, FaultKind.BROWN_OUT):
        lasts_s = fault.value
    elif fault.kind is FaultKind.REPLAY:
        lasts_s += fault.value
    elif fault.kind is FaultKind.DELAY:
        lasts_s += fault.value * 1e-3
    return fault.at_s + lasts_s
