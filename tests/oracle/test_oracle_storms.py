"""Every single fault, and storms of several, in a car that drives: no property breaks."""

from __future__ import annotations

import pytest

from simulation.fault_kinds import KINDS, TARGETS, FaultKind
from simulation.faults import Fault
from tests.oracle.storms import PILOTED, Stormy, weather

pytestmark = pytest.mark.slow

SINGLES = [
    (kind, target)
    for kind, spec in KINDS.items()
    if kind not in PILOTED
    for target in TARGETS[spec.strikes]
]
SEEDS = range(40)
FOUND = (47, 149)
"""Seeds that once broke something: of the nodes, or of the oracle itself."""


@pytest.mark.parametrize(("kind", "target"), SINGLES)
def test_a_single_fault_breaks_no_property(kind: FaultKind, target: str) -> None:
    stormy = Stormy(1)
    now_s = stormy.drive.world.now_ns * 1e-9
    report = stormy.run([Fault(kind=kind, target=target, at_s=now_s, for_s=2.0)])
    assert not report.violations, f"{report}\n{stormy.drive.log()}"


@pytest.mark.parametrize("seed", [*SEEDS, *FOUND])
def test_a_storm_breaks_no_property(seed: int) -> None:
    stormy, report = weather(seed)
    faults = "\n".join(str(injection.fault) for injection in stormy.injector.injections)
    assert not report.violations, f"{report}\n{faults}\n{stormy.drive.log()}"


def test_a_storm_is_the_same_whenever_it_is_run() -> None:
    (first, _), (second, _) = weather(17), weather(17)
    assert first.drive.world.trace.sha256 == second.drive.world.trace.sha256
