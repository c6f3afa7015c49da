"""The folder of a campaign: what is written comes back, and it goes on where it was left."""

from __future__ import annotations

import json
import random
from collections.abc import Iterable
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from campaign import parts, store
from campaign.code import code_sha256
from campaign.failure import failed
from campaign.result import SeedResult
from campaign.settings import CampaignSettings
from campaign.store import Campaign, Store, StoreError, campaign_sha256, stored_result
from tests.campaign import fakes

HOURS = 1.0
FIRST = 5
SEEDS = fakes.SETTINGS.seeds(HOURS, FIRST)
CAMPAIGN = Campaign.of(fakes.SETTINGS, HOURS, FIRST)


def opened(folder: Path, campaign: Campaign = CAMPAIGN, *, restart: bool = False) -> Store:
    return Store(folder, campaign, restart=restart)


def fill(folder: Path, seeds: Iterable[int]) -> None:
    with opened(folder) as there:
        for seed in seeds:
            there.add(fakes.result_of(seed))


def shuffled(seeds: range) -> list[int]:
    """In the order in which workers might answer."""
    numbers = list(seeds)
    random.Random(1).shuffle(numbers)
    return numbers


def test_results_come_back_as_they_were_and_in_order_of_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "PART_SEEDS", 4)
    fill(tmp_path, shuffled(SEEDS))
    assert len(parts.part_names(tmp_path)) == 8
    with opened(tmp_path) as again:
        assert list(again.results()) == [fakes.result_of(seed) for seed in SEEDS]
        assert list(again.missing(SEEDS)) == []
    assert any(item.for_s == inf for seed in SEEDS for item in fakes.result_of(seed).injections)


def test_extreme_seeds_long_texts_and_violations_come_back(tmp_path: Path) -> None:
    result = failed(2**63 - 1, "no exception", 'x" \n\t é' * 1000)
    with opened(tmp_path) as there:
        there.add(result)
        assert list(there.results()) == [result]


def test_only_overlapping_parts_are_read_ahead(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "PART_SEEDS", 5)
    fill(tmp_path, SEEDS)
    read: list[str] = []
    real = parts._part

    def noted(folder: Path, name: str) -> Iterable[SeedResult]:
        read.append(name)
        return real(folder, name)

    monkeypatch.setattr(parts, "_part", noted)
    results = parts.read_results(tmp_path)
    for number in range(len(SEEDS)):
        next(results)
        assert len(read) <= number // 5 + 2


def test_a_result_is_on_disk_after_a_while(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with opened(tmp_path) as there:
        there.add(fakes.result_of(FIRST))
        assert parts.part_names(tmp_path) == []
        monkeypatch.setattr(store, "PART_NS", 0)
        there.add(fakes.result_of(FIRST + 1))
        assert len(parts.part_names(tmp_path)) == 1


def test_every_dataset_is_read_by_any_tool_with_its_seeds(tmp_path: Path) -> None:
    fill(tmp_path, SEEDS)
    results = [fakes.result_of(seed) for seed in SEEDS]
    table = pq.read_table(tmp_path / "injections")
    assert table.column("seed").to_pylist() == [r.seed for r in results for _ in r.injections]
    demands = [str(item.demand) for r in results for item in r.injections]
    assert table.column("demand").to_pylist() == demands
    assert pq.read_table(tmp_path / "violations").num_rows == 0


def test_an_interrupted_campaign_goes_on_and_has_the_hash_of_one_that_was_not(
    tmp_path: Path,
) -> None:
    fill(tmp_path / "whole", SEEDS)
    order = shuffled(SEEDS)
    with pytest.raises(KeyboardInterrupt), opened(tmp_path / "cut") as there:
        for seed in order[:13]:
            there.add(fakes.result_of(seed))
        raise KeyboardInterrupt
    with opened(tmp_path / "cut") as there:
        assert list(there.missing(SEEDS)) == sorted(order[13:])
        for seed in order[13:]:
            there.add(fakes.result_of(seed))
        cut_sha256 = there.trace_sha256
    with opened(tmp_path / "whole") as there:
        assert there.trace_sha256 == cut_sha256
    assert cut_sha256 == campaign_sha256(fakes.result_of(seed).trace_sha256 for seed in SEEDS)
    assert cut_sha256 != campaign_sha256(fakes.result_of(seed).trace_sha256 for seed in SEEDS[1:])


@pytest.mark.parametrize("dataset", parts.DATASETS)
def test_a_part_that_was_cut_off_is_as_if_it_never_was(
    dataset: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(tmp_path, SEEDS[:5])
    real = parts._write

    def cut_off(path: Path, table: object) -> None:
        if path.parent.name == dataset:
            path.with_name(parts.UNFINISHED + path.name).write_bytes(b"PAR1 and no more")
            raise SystemExit
        real(path, table)

    with monkeypatch.context() as patched:
        patched.setattr(parts, "_write", cut_off)
        with pytest.raises(SystemExit):
            fill(tmp_path, SEEDS[5:9])
    with opened(tmp_path) as there:
        assert list(there.missing(SEEDS)) == list(SEEDS[5:])
        assert list(there.results()) == [fakes.result_of(seed) for seed in SEEDS[:5]]
    for name in parts.DATASETS:
        assert len(list((tmp_path / name).iterdir())) == 1


def test_more_hours_add_to_what_is_there(tmp_path: Path) -> None:
    fill(tmp_path, SEEDS)
    more = fakes.SETTINGS.seeds(2 * HOURS, FIRST)
    with opened(tmp_path, replace(CAMPAIGN, hours=2 * HOURS)) as there:
        assert list(there.missing(more)) == list(more)[len(SEEDS) :]


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"settings_sha256": "0"}, "other settings or another file of faults"),
        ({"code_sha256": "0"}, "run with other code"),
        ({"first_seed": 6}, "begins with seed 5"),
        ({"hours": 0.5}, "is of 1 hours"),
    ],
)
def test_a_folder_of_another_campaign_is_refused_or_begun_anew(
    other: dict[str, Any], said: str, tmp_path: Path
) -> None:
    fill(tmp_path, SEEDS)
    (tmp_path / "mine.txt").write_text("not the campaign's")
    (tmp_path / "replay-7").mkdir()
    wanted = replace(CAMPAIGN, **other)
    with pytest.raises(StoreError, match=f"{tmp_path}: .*{said}; --restart begins anew"):
        opened(tmp_path, wanted).__enter__()
    with opened(tmp_path, CAMPAIGN) as untouched:
        assert list(untouched.missing(SEEDS)) == []
    with opened(tmp_path, wanted, restart=True) as anew:
        assert list(anew.results()) == [] and anew.wall_s == 0.0
    assert (tmp_path / "mine.txt").exists() and not (tmp_path / "replay-7").exists()


def test_a_folder_in_which_a_campaign_runs_is_refused(tmp_path: Path) -> None:
    with (
        opened(tmp_path),
        pytest.raises(StoreError, match="another campaign is writing there"),
        opened(tmp_path),
    ):
        pass
    with opened(tmp_path):
        pass


@pytest.mark.parametrize("head", ["{", "[]", '{"hours": 1}', "\ufeff"])
def test_a_head_that_cannot_be_read_is_refused(head: str, tmp_path: Path) -> None:
    (tmp_path / "campaign.json").write_text(head, encoding="utf-8")
    with pytest.raises(StoreError, match=r"campaign.json: not the head of a campaign"):
        opened(tmp_path).__enter__()


def test_results_without_a_head_are_refused(tmp_path: Path) -> None:
    fill(tmp_path, SEEDS)
    (tmp_path / "campaign.json").unlink()
    with pytest.raises(StoreError, match=r"has results but no campaign.json"):
        opened(tmp_path).__enter__()


def test_the_head_tells_what_and_how_long(tmp_path: Path) -> None:
    fill(tmp_path, SEEDS[:3])
    first_s = json.loads((tmp_path / "campaign.json").read_text())["wall_s"]
    fill(tmp_path, SEEDS[3:])
    head = json.loads((tmp_path / "campaign.json").read_text())
    assert head["first_seed"] == FIRST and head["hours"] == HOURS
    assert head["settings_sha256"] == fakes.SETTINGS.sha256
    assert head["code_sha256"] == code_sha256()
    assert head["wall_s"] >= first_s >= 0.0


def test_one_result_is_found_for_the_same_settings_alone(tmp_path: Path) -> None:
    assert stored_result(tmp_path, fakes.SETTINGS, FIRST) is None
    fill(tmp_path, SEEDS)
    assert stored_result(tmp_path, fakes.SETTINGS, 17) == fakes.result_of(17)
    assert stored_result(tmp_path, fakes.SETTINGS, SEEDS.stop) is None
    assert stored_result(tmp_path, CampaignSettings(seed_s=60.0), 17) is None
