"""`dbw reproduce`: the papers' experiments, run again and then with this stack."""

from __future__ import annotations

from pathlib import Path

import click

from dbw.demo import SEED_MAX, interrupt_on_sigterm
from dbw.failures import EXIT_FAILED, EXIT_OK, UserMistake, complain
from dbw.options import WholeNumber


@click.command(
    epilog="""\b
Examples:
  dbw reproduce
  dbw reproduce uah --out out/uah"""
)
@click.argument("papers", nargs=-1, metavar="[uah|uwa|unicamp|all ...]")
@click.option(
    "--seed",
    type=WholeNumber(0, SEED_MAX),
    default=0,
    show_default=True,
    help="Of everything left to chance.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/reproduce"),
    show_default=True,
    help="Folder for report.html, report.json and a picture for each experiment.",
)
def reproduce(papers: tuple[str, ...], seed: int, out: Path) -> int:
    """Run the papers' experiments, with their controllers and with this stack.

    Everything happens in virtual time. The exit code is 1 if a figure misses its goal.
    """
    from rich.console import Console

    from dbw.progress import ProgressBar
    from experiments.page import figure, json_of, page_of, rows_of
    from experiments.result import Experiment
    from experiments.table import Finished, UnknownPaper, experiments_of, run_experiments
    from telemetry.folder import ResultFolder

    try:
        chosen = experiments_of(papers)
    except UnknownPaper as error:
        raise UserMistake(str(error)) from error
    console = Console(highlight=False)
    finished: list[Finished] = []
    with (
        interrupt_on_sigterm(),
        ResultFolder(out) as folder,
        ProgressBar(console, len(chosen)) as bar,
    ):

        def begin(experiment: Experiment) -> None:
            bar.draw(len(finished), experiment.title)

        for one in run_experiments(chosen, seed, folder.path, begin):
            finished.append(one)
        folder.path.joinpath("report.json").write_text(json_of(finished), encoding="utf-8")
        folder.path.joinpath("report.html").write_text(page_of(finished, seed), encoding="utf-8")
        folder.commit()
    rows = rows_of(finished)
    for row in rows:
        click.echo(
            f"{'met   ' if row.passed else 'missed'} {row.quantity}, {row.unit}: "
            f"paper {figure(row.paper_value)}, baseline {figure(row.baseline_value)}, "
            f"ours {figure(row.ours_value)}"
        )
    click.echo(f"written to {out}/: report.html, report.json, {len(finished)} pictures")
    missed = sum(not row.passed for row in rows)
    if missed:
        complain(f"{missed} of {len(rows)} figures miss their goal")
        return EXIT_FAILED
    return EXIT_OK
