"""All experiments, by paper. A further paper is a further row of `PAPERS`."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from experiments.chance import generator
from experiments.result import Experiment, Outcome, Setting, settled
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
    """Runs them, a process for each of the machine's cores; each draws its picture into the folder.

    Args:
        chosen: Which; what they find comes in this order.
        seed: Of all that is left to chance.
        folder: Exists.
        begin: Told before each that is waited for.
    """
    count = min(len(os.sched_getaffinity(0)), len(chosen))
    if count < 2:
        for experiment in chosen:
            begin(experiment)
            yield run_one(experiment, seed, folder)
        return
    tasks = [(experiment.id, seed, folder) for experiment in chosen]
    # leaving the block ends the processes, whatever they do
    with multiprocessing.get_context("spawn").Pool(count, _leave_interrupts_to_parent) as pool:
        outcomes = pool.imap(_outcome, tasks)
        for experiment in chosen:
            begin(experiment)
            outcome = next(outcomes)
            yield Finished(
                experiment=experiment, outcome=outcome, picture=_picture(experiment, folder)
            )


def _leave_interrupts_to_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _outcome(task: tuple[str, int, Path]) -> Outcome:
    """What an experiment found, in another process."""
    name, seed, folder = task
    (experiment,) = [one for one in experiments_of(()) if one.id == name]
    outcome = run_one(experiment, seed, folder).outcome
    return replace(outcome, rows=tuple(settled(row) for row in outcome.rows))


def _picture(experiment: Experiment, folder: Path) -> Path:
    return folder / f"{experiment.id}.png"


def run_one(experiment: Experiment, seed: int, folder: Path) -> Finished:
    """Runs a single experiment: the same outcome as among all others."""
    rng = generator(seed, experiment.id)
    picture = _picture(experiment, folder)
    outcome = experiment.run(Setting(seed=seed, rng=rng), picture)
    return Finished(experiment=experiment, outcome=outcome, picture=picture)
