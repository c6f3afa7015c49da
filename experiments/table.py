"""All experiments, by paper. A further paper is a further row of `PAPERS`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.chance import generator
from experiments.result import Experiment, Outcome, Setting
from experiments.uah.table import EXPERIMENTS as UAH
from experiments.unicamp.table import EXPERIMENTS as UNICAMP
from experiments.uwa.table import EXPERIMENTS as UWA

PAPERS: dict[str, tuple[Experiment, ...]] = {"uah": UAH, "uwa": UWA, "unicamp": UNICAMP}
"""In the order of the papers' own sections."""

ALL = "all"


class UnknownPaper(ValueError):
    """No experiments go by this name; one line that lists those that do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """An experiment that has been run."""

    experiment: Experiment
    outcome: Outcome
    picture: Path


def experiments_of(names: Sequence[str]) -> tuple[Experiment, ...]:
    """The experiments of papers, each once, in the order of the table.

    Args:
        names: Of papers; `all`, or none at all, for every one.

    Raises:
        UnknownPaper: A name is not known.
    """
    for name in names:
        if name not in PAPERS and name != ALL:
            raise UnknownPaper(f"no paper {name!r}: allowed {', '.join([*PAPERS, ALL])}")
    is_all = not names or ALL in names
    return tuple(
        experiment
        for paper, found in PAPERS.items()
        if is_all or paper in names
        for experiment in found
    )


def run_experiments(
    chosen: Sequence[Experiment], seed: int, folder: Path, begin: Callable[[Experiment], None]
) -> Iterator[Finished]:
    """Runs one after the other; each draws its picture into the folder.

    Args:
        chosen: Which.
        seed: Of all that is left to chance.
        folder: Exists.
        begin: Told before each.
    """
    for experiment in chosen:
        begin(experiment)
        yield run_one(experiment, seed, folder)


def run_one(experiment: Experiment, seed: int, folder: Path) -> Finished:
    """Runs a single experiment: the same outcome as among all others."""
    rng = generator(seed, experiment.id)
    picture = folder / f"{experiment.id}.png"
    outcome = experiment.run(Setting(seed=seed, rng=rng), picture)
    return Finished(experiment=experiment, outcome=outcome, picture=picture)
