"""Stand-ins for a seed that are quick; functions of a module, so that workers find them."""

from __future__ import annotations

import hashlib
import os
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path

from campaign.failure import run_or_tell
from campaign.result import Demand, InjectionResult, SeedResult, ViolationResult
from campaign.settings import CampaignSettings
from simulation.fault_kinds import FaultKind
from simulation.faults import Fault
from simulation.world import World

SETTINGS = CampaignSettings()
KILLER = 11
RAISER = 7
FAILING = (3, 8)
DEMANDS = (Demand.BRAKE, Demand.HANDOVER, Demand.ANY, Demand.GO_ON)


def result_of(seed: int) -> SeedResult:
    """Something of everything, different for every seed."""
    injections = tuple(
        InjectionResult(
            kind="crash",
            target="Steering",
            at_s=1.5 * number,
            for_s=inf if number else 0.5,
            value=0.0,
            share=1.0,
            demand=DEMANDS[seed % len(DEMANDS)],
            budget_ms=200.0 if number else None,
            is_clean=True,
            is_due=True,
            latency_ms=71.25 + seed if number else None,
            code="ER2 NODE_SILENT" if number else "",
            is_detected=bool(number),
            is_missed=False,
        )
        for number in range(seed % 3)
    )
    return SeedResult(
        seed=seed,
        simulated_s=120.0,
        engaged_s=90.0 + seed,
        calm_s=10.0,
        stops=seed % 4,
        false_trips=0,
        repairs_s=(0.5,) * (seed % 2),
        injections=injections,
        violations=(),
        excused=1,
        corruptions=seed,
        corruptions_unseen=0,
        trace_sha256=hashlib.sha256(str(seed).encode()).hexdigest(),
        cpu_s=0.001,
    )


def run_seed(
    settings: CampaignSettings,
    seed: int,
    *,
    faults: Sequence[Fault] | None = None,
    watch: Callable[[World], None] | None = None,
) -> SeedResult:
    """Never fails."""
    return result_of(seed)


def run_failing(
    settings: CampaignSettings,
    seed: int,
    *,
    faults: Sequence[Fault] | None = None,
    watch: Callable[[World], None] | None = None,
) -> SeedResult:
    """Some seeds fail, when a CRASH and a FREEZE come together; a recorder sees half a second."""
    result = result_of(seed)
    if watch is not None:
        world = World(settings.car, seed, keep_frames=False)
        watch(world)
        world.run_for(0.5)
    given = faults_of(settings, seed) if faults is None else faults
    kinds = {fault.kind for fault in given}
    if seed not in FAILING or not {FaultKind.CRASH, FaultKind.FREEZE} <= kinds:
        return result
    broken = ViolationResult(property="no crash and freeze", at_s=30.0, text="both at once")
    return replace(result, violations=(broken,))


def faults_of(settings: CampaignSettings, seed: int) -> list[Fault]:
    """A dozen; a CRASH and a FREEZE among them."""
    kinds = [FaultKind.RESTART] * 4 + [FaultKind.CRASH] + [FaultKind.MUTE] * 3
    kinds += [FaultKind.FREEZE] + [FaultKind.DEAF] * 3
    return [
        Fault(kind=kind, target="Steering", at_s=3.0 * number, for_s=0.25)
        for number, kind in enumerate(kinds)
    ]


def run_raising(
    settings: CampaignSettings, seed: int, *, faults: Sequence[Fault] | None = None
) -> SeedResult:
    """One seed raises."""
    if seed == RAISER:
        raise ZeroDivisionError("one over nothing")
    return result_of(seed)


def run_killing(
    folder: Path,
    times: int,
    settings: CampaignSettings,
    seed: int,
    *,
    faults: Sequence[Fault] | None = None,
) -> SeedResult:
    """One seed kills its process, so many times; each attempt leaves a file."""
    if seed == KILLER:
        attempt = len(list(folder.iterdir()))
        (folder / str(attempt)).touch()
        if attempt < times:
            os.kill(os.getpid(), signal.SIGKILL)
    return result_of(seed)


def run_forever(
    folder: Path, settings: CampaignSettings, seed: int, *, faults: Sequence[Fault] | None = None
) -> SeedResult:
    """The first seeds are quick, the others leave the number of their process and never end."""
    if seed >= 4:
        pid_then_forever(folder, seed)
    return result_of(seed)


def pid_then_forever(folder: Path, seed: int) -> int:
    """Leaves the number of its process, and never ends."""
    (folder / str(os.getpid())).touch()
    threading.Event().wait()
    return seed


def task_of(run: Callable[..., SeedResult]) -> Callable[[int], SeedResult]:
    """What workers are given."""
    return partial(run_or_tell, run, SETTINGS)
