"""A seed that is repeated is the same, and what is written of it tells why it failed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path

import pytest

from campaign.failure import EXCEPTION, run_or_tell, worker_died
from campaign.minimise import Minimal
from campaign.replay import FAULTS, FEWEST, LOG, PICTURE, TEXT, fault_file, replay, write_replay
from campaign.result import SeedResult
from campaign.run import faults_of, run_seed
from campaign.settings import CampaignSettings
from campaign.workers import LocalPool, each_seed
from simulation.fault_kinds import KINDS, TARGETS
from simulation.faults import Fault, parse_faults
from simulation.world import World

CRASH = '[[fault]]\nkind = "crash"\ntarget = "Steering"\nat_s = 2.5\nfor_s = 0.5\n'
SETTINGS = CampaignSettings(seed_s=4.0, faults_text=CRASH)
EVERY = {kind: TARGETS[spec.strikes] for kind, spec in KINDS.items()}
PNG = b"\x89PNG\r\n\x1a\n"


def test_a_real_seed_is_the_same_in_a_worker_and_when_it_is_recorded(tmp_path: Path) -> None:
    task = partial(run_or_tell, run_seed, SETTINGS)
    with LocalPool(1) as pool:
        stored = next(iter(each_seed(pool, task, [17], worker_died)))
    assert stored.trace_sha256 and stored.simulated_s == 4.0
    again = replay(run_seed, SETTINGS, faults_of(SETTINGS, 17), 17, stored)
    assert again.is_equal and again.comparison.startswith("equal to the stored result, trace ")
    files = write_replay(tmp_path / "replay-17", again)
    assert [file.name for file in files] == [LOG, FAULTS, TEXT, PICTURE]
    lines = (tmp_path / "replay-17" / LOG).read_text().splitlines()
    assert len(lines) == len(again.recorder.log) > 1000
    assert lines[0].startswith("(0000000000.") and " vcan0 " in lines[0]
    assert (tmp_path / "replay-17" / PICTURE).read_bytes().startswith(PNG)
    text = (tmp_path / "replay-17" / TEXT).read_text()
    assert "seed 17, 4 s: equal to the stored result" in text
    assert "at 2.5 s for 0.5 s: crash of Steering" in text and "it never came" not in text


def test_a_result_that_differs_is_told(tmp_path: Path) -> None:
    again = replay(run_seed, replace(SETTINGS, seed_s=0.5), [], 1, None)
    assert again.comparison == "no stored result to compare with" and not again.is_equal
    other = replace(again, stored=replace(again.result, trace_sha256="f" * 64))
    assert "differs from the stored result: trace " in other.comparison
    assert other.comparison.endswith("stored ffffffffffffffff")
    same_trace = replace(again, stored=replace(again.result, stops=9))
    assert "with the same trace" in same_trace.comparison and not same_trace.is_equal
    assert replace(again, stored=replace(again.result, cpu_s=9.9)).is_equal


def test_a_seed_that_raises_is_recorded_until_then(tmp_path: Path) -> None:
    def raising(
        settings: CampaignSettings,
        seed: int,
        *,
        faults: Sequence[Fault] | None = None,
        watch: Callable[[World], None] | None = None,
    ) -> SeedResult:
        def look(world: World) -> None:
            assert watch is not None
            watch(world)
            world.kernel.at(300_000_000, 0, fail)

        def fail(true_ns: int) -> None:
            raise ZeroDivisionError("at 0.3 s")

        return run_seed(settings, seed, faults=faults, watch=look)

    faults = faults_of(SETTINGS, 2)
    again = replay(raising, SETTINGS, faults, 2, None)
    assert again.result.violations[0].property == EXCEPTION
    assert 0.25 < again.recorder.log.end_s <= 0.3
    fewest = Minimal(items=tuple(faults), runs=3, is_minimal=False)
    files = write_replay(tmp_path, again, fewest)
    assert FEWEST in [file.name for file in files]
    text = (tmp_path / TEXT).read_text()
    assert "ZeroDivisionError: at 0.3 s" in text and "it never came" in text
    assert "fewer faults, the runs were used up that still fail, after 3 runs" in text


def test_a_seed_without_a_world_is_written_all_the_same(tmp_path: Path) -> None:
    again = replay(run_seed, CampaignSettings(faults_text="[[fault]]\nkind = 1"), [], 2, None)
    files = write_replay(tmp_path, again)
    assert [file.name for file in files] == [LOG, TEXT, PICTURE]
    assert (tmp_path / LOG).read_text() == ""


@pytest.mark.parametrize("kind", list(KINDS))
def test_a_file_of_faults_holds_exactly_what_was_injected(kind: str) -> None:
    spec = KINDS[kind]  # type: ignore[index]
    low = spec.low if spec.low == spec.low else 0.0
    faults = tuple(
        Fault(
            kind=kind,  # type: ignore[arg-type]
            target=TARGETS[spec.strikes][-1],
            at_s=100.0 / 3.0,
            for_s=for_s,
            value=value,
            share=1.0 / 7.0 if spec.has_share else 1.0,
        )
        for for_s in (inf, 1e-5)
        for value in (low, spec.default)
    )
    assert parse_faults(fault_file(faults), "f", EVERY).fixed == faults
