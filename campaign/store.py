"""The folder of a campaign: what it is of, what is done already, and the results."""

from __future__ import annotations

import fcntl
import hashlib
import json
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Self

from campaign.code import code_sha256
from campaign.parts import (
    DATASETS,
    part_names,
    read_hashes,
    read_result,
    read_results,
    remove_leftovers,
    write_part,
)
from campaign.result import SeedResult
from campaign.settings import CampaignSettings
from runtime.clock import monotonic_ns

HEAD = "campaign.json"
LOCK = ".lock"
REPLAYS = "replay-*"
PART_SEEDS = 500
"""A part has at most so many seeds, so that little is held in memory."""
PART_NS = 60_000_000_000
"""What is finished is on disk after so long, even if the power fails."""


class StoreError(Exception):
    """The folder cannot be used; one line with its path and the reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """What a folder holds the results of.

    Attributes:
        settings_sha256, code_sha256: What makes a seed what it is.
        vehicle, seed_s, faults_name: Of the settings, for a reader.
        first_seed: The first of the seeds.
        hours: How long, all seeds together.
        wall_s: How long it has been running until the newest part.
    """

    settings_sha256: str
    code_sha256: str
    vehicle: str
    seed_s: float
    faults_name: str
    first_seed: int
    hours: float
    wall_s: float = 0.0

    @classmethod
    def of(cls, settings: CampaignSettings, hours: float, first_seed: int) -> Self:
        """The one that the code as it is makes of the settings."""
        return cls(
            settings_sha256=settings.sha256,
            code_sha256=code_sha256(),
            vehicle=settings.vehicle,
            seed_s=settings.seed_s,
            faults_name="" if settings.faults_text is None else settings.faults_name,
            first_seed=first_seed,
            hours=hours,
        )

    def obstacle(self, wanted: Campaign) -> str:
        """Why the results of this one cannot be taken for some of another's; empty if they can."""
        if self.settings_sha256 != wanted.settings_sha256:
            return "the campaign there has other settings or another file of faults"
        if self.first_seed != wanted.first_seed:
            return f"the campaign there begins with seed {self.first_seed}"
        if self.hours > wanted.hours:
            return f"the campaign there is of {self.hours:g} hours"
        if self.code_sha256 != wanted.code_sha256:
            return "the campaign there was run with other code"
        return ""


class Store:
    """Takes results, and tells them in order of seed. Goes on where it was left.

    Args:
        folder: Made if it is missing.
        campaign: More hours than before add to what is there.
        restart: Removes what is there.

    Attributes:
        wall_s: How long the campaign has been running until the newest part, all runs together.
    """

    def __init__(self, folder: Path, campaign: Campaign, *, restart: bool = False) -> None:
        self.folder = folder
        self._campaign = campaign
        self._is_restart = restart
        self._held: list[SeedResult] = []
        self._start_ns = self._written_ns = 0
        self._earlier_s = self.wall_s = 0.0
        self._lock: IO[str] | None = None

    def __enter__(self) -> Self:
        """Makes or checks the folder.

        Raises:
            StoreError: It cannot be written, another campaign is in it, or one that still runs.
        """
        check_folder(self.folder, self._campaign, restart=self._is_restart)
        try:
            self._begin()
        except OSError as error:
            self._unlock()
            raise _unusable(self.folder, error) from error
        return self

    def _begin(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lock = (self.folder / LOCK).open("w")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._unlock()
            raise StoreError(f"{self.folder}: another campaign is writing there") from error
        if self._is_restart:
            remove_campaign(self.folder)
        for name in DATASETS:
            (self.folder / name).mkdir(exist_ok=True)
        remove_leftovers(self.folder)
        found = campaign_in(self.folder)
        self._earlier_s = self.wall_s = 0.0 if found is None else found.wall_s
        self._write_head()
        self._start_ns = self._written_ns = monotonic_ns()

    def _write_head(self) -> None:
        head = asdict(replace(self._campaign, wall_s=round(self.wall_s, 3)))
        unfinished = self.folder / f".{HEAD}"
        unfinished.write_text(json.dumps(head, indent=1) + "\n", encoding="utf-8")
        unfinished.replace(self.folder / HEAD)

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.close()

    def __exit__(self, *exception: object) -> None:
        """Writes what is still held."""
        try:
            self.flush()
        finally:
            self._unlock()

    def add(self, result: SeedResult) -> None:
        """Takes a result, in any order; writes a part now and then.

        Raises:
            StoreError: It cannot be written.
        """
        self._held.append(result)
        is_old = monotonic_ns() - self._written_ns >= PART_NS
        if is_old or len(self._held) >= PART_SEEDS:
            self.flush()

    def flush(self) -> None:
        """Writes all results that are held.

        Raises:
            StoreError: They cannot be written.
        """
        self._written_ns = monotonic_ns()
        if self._held:
            self.wall_s = self._earlier_s + (self._written_ns - self._start_ns) * 1e-9
            try:
                write_part(self.folder, self._held)
                self._write_head()
            except OSError as error:
                raise _unusable(self.folder, error) from error
            self._held = []

    def missing(self, seeds: range) -> Iterator[int]:
        """Those of the seeds that have no result on disk yet, in order."""
        is_done = bytearray(len(seeds))
        for seed, _ in read_hashes(self.folder):
            if seed in seeds:
                is_done[seed - seeds.start] = True
        return (seed for seed, done in zip(seeds, is_done, strict=True) if not done)

    def results(self) -> Iterator[SeedResult]:
        """All results, in order of seed."""
        self.flush()
        return read_results(self.folder)

    @property
    def trace_sha256(self) -> str:
        """Of the whole campaign: two that are equal had equal frames at equal times."""
        self.flush()
        return campaign_sha256(sha256 for _, sha256 in read_hashes(self.folder))


def campaign_sha256(hashes: Iterable[str]) -> str:
    """Of the `trace_sha256` of all seeds, in order of seed."""
    digest = hashlib.sha256()
    for sha256 in hashes:
        digest.update(sha256.encode())
    return digest.hexdigest()


def check_folder(folder: Path, wanted: Campaign, *, restart: bool = False) -> None:
    """Whether a campaign may go on there; writes nothing.

    Raises:
        StoreError: It may not: path and reason.
    """
    if folder.exists() and not folder.is_dir():
        raise StoreError(f"{folder} is a file: a folder is wanted")
    if restart:
        return
    found = campaign_in(folder)
    if found is None:
        if part_names(folder):
            raise StoreError(f"{folder} has results but no {HEAD}; --restart removes them")
        return
    obstacle = found.obstacle(wanted)
    if obstacle:
        raise StoreError(f"{folder}: {obstacle}; --restart begins anew, --out takes another folder")


def campaign_in(folder: Path) -> Campaign | None:
    """What a folder holds the results of; None for no campaign at all.

    Raises:
        StoreError: Its head cannot be read.
    """
    path = folder / HEAD
    try:
        return Campaign(**json.loads(path.read_text(encoding="utf-8")))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, TypeError) as error:
        raise StoreError(f"{path}: not the head of a campaign; --restart begins anew") from error


def stored_result(folder: Path, settings: CampaignSettings, seed: int) -> SeedResult | None:
    """The result of a seed with these settings and this code; None if the folder has none."""
    found = campaign_in(folder)
    wanted = (settings.sha256, code_sha256())
    if found is None or (found.settings_sha256, found.code_sha256) != wanted:
        return None
    return read_result(folder, seed)


def remove_campaign(folder: Path) -> None:
    """Removes all that a campaign writes, and nothing else."""
    (folder / HEAD).unlink(missing_ok=True)
    for path in (*(folder / name for name in DATASETS), *folder.glob(REPLAYS)):
        if path.is_dir():
            shutil.rmtree(path)


def _unusable(path: Path, error: OSError) -> StoreError:
    return StoreError(f"{path} cannot be written: {error.strerror or error}")
