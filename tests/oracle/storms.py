"""Faults by the dozen in a car that drives, judged by the oracle."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from oracle.report import OracleReport
from simulation.fault_kinds import KINDS, TARGETS, FaultKind
from simulation.faults import Fault
from simulation.injector import Injector
from tests.oracle.watched import Watched

PILOTED = frozenset({
    FaultKind.PLANNER_NAN, FaultKind.PLANNER_LATE, FaultKind.PLANNER_ABSURD,
    FaultKind.PLANNER_OSCILLATING,
})
"""These only a planner can play; a frozen one is `is_planner_silent`."""
STORM_S, CALM_S = 3.0, 3.0
BEHIND_THE_SERVO = frozenset({
    FaultKind.ACTUATOR_STUCK, FaultKind.ACTUATOR_WEAK, FaultKind.ACTUATOR_SLOW,
    FaultKind.ACTUATOR_HOT,
})
BRAKE_IS_BROKEN = frozenset({
    "brake kept in an emergency", "hazard ends braked at a standstill",
    "no drive torque while emergency braking",
})
"""What no software keeps when the servo itself does not do as it is told."""


class Stormy:
    """A watched drive with faults."""

    def __init__(self, seed: int, speed_mps: float = 4.0, curvature_per_m: float = 0.03) -> None:
        self.drive = Watched(seed).away(speed_mps, curvature_per_m)
        self.injector = Injector(self.drive.world, self.drive.world.fault_rng)
        self.injector.listeners.append(self._tell)

    def _tell(self, true_ns: int, fault: Fault, is_begin: bool) -> None:
        is_servo = fault.kind in BEHIND_THE_SERVO and fault.target == "BrakeServo"
        excuses = BRAKE_IS_BROKEN if is_servo else frozenset[str]()
        self.drive.oracle.on_fault(
            true_ns, fault.kind, fault.target, is_begin, budget_ns=None, excuses=excuses
        )
        if fault.kind is FaultKind.PLANNER_FROZEN:
            self.drive.is_planner_silent = is_begin

    def run(self, faults: list[Fault]) -> OracleReport:
        """The storm, all faults healed, and some calm."""
        self.injector.plan(faults)
        self.drive.run(STORM_S)
        self.injector.heal()
        self.drive.run(CALM_S)
        return self.drive.oracle.finish(self.drive.world.now_ns)


def storm(rng: Generator, begin_s: float) -> list[Fault]:
    """One to four faults of any kind, size and length, at any time of two seconds."""
    kinds = [kind for kind in FaultKind if kind not in PILOTED]
    return [_any(rng, begin_s, kinds) for _ in range(int(rng.integers(1, 5)))]


def _any(rng: Generator, begin_s: float, kinds: list[FaultKind]) -> Fault:
    kind = kinds[int(rng.integers(len(kinds)))]
    spec = KINDS[kind]
    targets = TARGETS[spec.strikes]
    is_extreme, is_partial = rng.random() < 0.5, spec.has_share and rng.random() < 0.5
    return Fault(
        kind=kind,
        target=targets[int(rng.integers(len(targets)))],
        at_s=begin_s + float(rng.uniform(0.0, 2.0)),
        for_s=float(rng.choice([0.02, 0.1, 0.5, 2.0])),
        value=float(rng.uniform(spec.low, spec.high)) if is_extreme else spec.default,
        share=float(rng.uniform(0.05, 1.0)) if is_partial else 1.0,
    )


def weather(seed: int) -> tuple[Stormy, OracleReport]:
    """A whole storm by its seed."""
    rng = np.random.default_rng((seed, 9))
    speed_mps, curvature_per_m = float(rng.uniform(1.0, 6.0)), float(rng.uniform(-0.04, 0.04))
    stormy = Stormy(seed, speed_mps, curvature_per_m)
    faults = storm(rng, stormy.drive.world.now_ns * 1e-9)
    return stormy, stormy.run(faults)
