"""Results built by hand."""

from __future__ import annotations

import math
from dataclasses import replace

from campaign.result import Demand, InjectionResult, SeedResult, ViolationResult

SHA256 = ["ab" * 32, "cd" * 32, "ef" * 32]
CRASH = InjectionResult(
    kind="crash",
    target="Steering",
    at_s=10.0,
    for_s=math.inf,
    value=0.0,
    share=1.0,
    demand=Demand.BRAKE,
    budget_ms=100.0,
    is_clean=True,
    is_due=True,
    latency_ms=62.04,
    code="ER2 NODE_SILENT",
    is_detected=True,
    is_missed=False,
)
"""Clean, due, and answered in time."""
LOST = replace(
    CRASH, kind="drop", target="STEER_STATUS", demand=Demand.GO_ON, budget_ms=None, is_due=False,
    latency_ms=None, code="", is_detected=False,
)  # fmt: skip
"""Clean, and rightly without an answer."""
BROKEN = ViolationResult(property="braking stays", at_s=50.0, text="0.2 at 3.1 m/s")
GOOD = SeedResult(
    seed=0,
    simulated_s=120.0,
    engaged_s=90.0,
    calm_s=36.0,
    stops=1,
    false_trips=0,
    repairs_s=(6.0,),
    injections=(CRASH,),
    violations=(),
    excused=0,
    corruptions=0,
    corruptions_unseen=0,
    trace_sha256=SHA256[0],
    cpu_s=4.0,
)


def crash(latency_ms: float | None, *, missed: bool = False) -> InjectionResult:
    """A crash that was answered after so long, or never."""
    return replace(CRASH, latency_ms=latency_ms, is_missed=missed)
