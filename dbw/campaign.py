"""`dbw campaign`: thousands of simulated hours under faults."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dbw.demo import SEED_MAX, interrupt_on_sigterm
from dbw.failures import EXIT_FAILED, EXIT_OK, UserMistake, complain
from dbw.options import WholeNumber, vehicle_option

if TYPE_CHECKING:
    from rich.console import Console

    from campaign.failure import Tally
    from campaign.minimise import Minimal
    from campaign.settings import CampaignSettings
    from campaign.store import Store
    from campaign.workers import Pool
    from simulation.faults import Fault

REPLAY_SEED_MAX = 2**63 - 1
RECORDED_MAX = 5
"""So many failing seeds are minimised and recorded."""
EXTRA = frozenset({"pyarrow", "distributed", "jinja2", "scipy", "matplotlib"})
"""Libraries of the extra `campaign`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignOptions:
    """The command line of `dbw campaign`."""

    hours: float
    seed: int
    vehicle: str
    workers: str
    faults: Path | None
    out: Path


@click.command(
    epilog="""\b
Examples:
  dbw campaign --hours 10
  dbw campaign --vehicle my-car.toml --out out/my-car
  dbw campaign --hours 1000 --seed 7 --workers dask://10.0.0.2:8786 --out out/night
  dbw campaign --faults my-faults.toml --out out/mine
  dbw campaign --replay 17"""
)
@click.option(
    "--hours",
    type=float,
    default=1.0,
    show_default=True,
    help="Virtual time of all seeds together. More than before adds to what is in --out.",
)
@click.option(
    "--seed",
    type=WholeNumber(0, SEED_MAX),
    default=0,
    show_default=True,
    help="The first one. A seed is one car, one route and its faults.",
)
@vehicle_option
@click.option(
    "--workers",
    default="auto",
    show_default=True,
    metavar="auto|N|dask://HOST:PORT",
    help="A process for each core, so many processes, or a Dask cluster that is there already.",
)
@click.option(
    "--faults",
    type=click.Path(path_type=Path),
    default=None,
    metavar="FILE.toml",
    help="Faults in place of those that each seed draws.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/campaign"),
    show_default=True,
    help="Folder for the results, the report and what is recorded of failing seeds.",
)
@click.option(
    "--replay",
    type=WholeNumber(0, REPLAY_SEED_MAX),
    default=None,
    metavar="SEED",
    help="Repeat one seed and record it, instead of a campaign.",
)
@click.option("--restart", is_flag=True, help="Remove what is in --out and begin anew.")
def campaign(
    hours: float,
    seed: int,
    vehicle: str,
    workers: str,
    faults: Path | None,
    out: Path,
    replay: int | None,
    restart: bool,
) -> int:
    """Drive thousands of simulated hours under faults and report.

    Every seed drives a car of its own with the whole stack while faults come down on it; an
    oracle judges it by the bus and by the truth. Results are written as they come: the same
    command goes on where it was interrupted. The exit code is 1 if any property broke or a fault
    was not answered in time.
    """
    options = CampaignOptions(
        hours=hours, seed=seed, vehicle=vehicle, workers=workers, faults=faults, out=out
    )
    if replay is not None and restart:
        raise UserMistake("--replay repeats a seed of what is there: --restart would remove it")
    try:
        return run_campaign(options, restart) if replay is None else run_replay(options, replay)
    except KeyboardInterrupt:
        if replay is None and out.is_dir():
            click.echo(f"dbw: what is finished is in {out}: the same command goes on", err=True)
        raise
    except ModuleNotFoundError as error:
        if error.name not in EXTRA:
            raise
        raise UserMistake(
            f"{error.name} is not installed: pip install 'can-by-wire[campaign]'"
        ) from error


def settings_of(options: CampaignOptions) -> CampaignSettings:
    """What all seeds have in common.

    Raises:
        VehicleError: The vehicle is not known, or its file cannot be used: file and field.
        FaultError: The file of faults cannot be used for it: file, line and reason.
    """
    from campaign.settings import CampaignSettings
    from simulation.faults import read_faults
    from vehicles.reading import is_file, vehicle_text

    name, faults = options.vehicle, options.faults
    settings = CampaignSettings(
        vehicle=name,
        vehicle_text=vehicle_text(name) if is_file(name) else "",
        faults_text=None if faults is None else read_faults(faults),
        faults_name="" if faults is None else str(faults),
    )
    settings.check()
    return settings


def run_campaign(options: CampaignOptions, restart: bool) -> int:
    """Runs what is missing, reports all; answers the exit code.

    Raises:
        UserMistake, FaultError, WorkersError, StoreError: What the user can put right.
    """
    from rich.console import Console

    from campaign.failure import Tally, run_or_tell, worker_died
    from campaign.report import write_report
    from campaign.run import run_seed
    from campaign.store import Campaign, Store, check_folder
    from campaign.workers import each_seed, open_pool
    from dbw.campaign_screen import CampaignScreen, print_summary

    settings = settings_of(options)
    try:
        seeds = settings.seeds(options.hours, options.seed)
    except ValueError as error:
        raise UserMistake(f"--{error}") from error
    wanted = Campaign.of(settings, options.hours, options.seed)
    check_folder(options.out, wanted, restart=restart)
    console = Console(highlight=False)
    task = partial(run_or_tell, run_seed, settings)
    with (
        interrupt_on_sigterm(),
        open_pool(options.workers) as pool,
        Store(options.out, wanted, restart=restart) as store,
    ):
        goal_s = len(seeds) * settings.seed_s
        with CampaignScreen(console, goal_s, Tally.of(store.results())) as screen:
            for result in each_seed(pool, task, store.missing(seeds), worker_died):
                store.add(result)
                screen.show(result)
        tally = Tally.of(store.results())
        print_summary(console, tally, store.wall_s, store.trace_sha256)
        page = write_report(store.results, settings, options.out, wall_s=store.wall_s)
        console.print(f"report: {page}", soft_wrap=True)
        if not tally.failing:
            return EXIT_OK
        tell_failures(console, settings, options.out, tally)
        record_failures(console, pool, store, settings, list(tally.failing)[:RECORDED_MAX])
    complain(f"{tally.failing_seeds} of {tally.seeds} seeds failed")
    return EXIT_FAILED


def tell_failures(
    console: Console, settings: CampaignSettings, out: Path, tally: Tally
) -> None:
    """A line for each of the first failing seeds, and the command that repeats it."""
    from campaign.report import replay_command

    for seed, failure in tally.failing.items():
        console.print(f"seed {seed}: {failure}", soft_wrap=True, markup=False)
        console.print(f"  {replay_command(settings, seed, out)}", soft_wrap=True, markup=False)
    more = tally.failing_seeds - len(tally.failing)
    if more > 0:
        console.print(f"and {more} more seeds: see the report")


def record_failures(
    console: Console, pool: Pool, store: Store, settings: CampaignSettings, seeds: list[int]
) -> None:
    """Finds the fewest faults of failing seeds, and records them with log and picture."""
    from campaign.failure import WORKER_LIVES
    from campaign.minimise import minimise
    from campaign.parts import read_result
    from campaign.run import faults_of, run_seed
    from campaign.workers import each_seed

    console.print(f"looking for the faults it takes: {len(seeds)} seeds, some minutes each")

    def give_up(seed: int) -> tuple[int, Minimal[Fault] | None]:
        return seed, None

    stored = {seed: read_result(store.folder, seed) for seed in seeds}
    safe = [  # others would kill this process as well
        seed
        for seed, result in stored.items()
        if result is not None
        and all(violation.property != WORKER_LIVES for violation in result.violations)
    ]
    task = partial(minimise, run_seed, faults_of, settings)
    for seed, fewest in each_seed(pool, task, safe, give_up):
        if fewest is None:
            console.print(f"seed {seed}: not recorded, the process that ran it died")
        else:
            record(console, store.folder, settings, seed, fewest)


def record(
    console: Console,
    out: Path,
    settings: CampaignSettings,
    seed: int,
    fewest: Minimal[Fault] | None = None,
) -> int:
    """Repeats a seed, writes it down; answers the exit code."""
    from campaign.failure import faults_or_none, first_failure
    from campaign.replay import replay, write_replay
    from campaign.run import faults_of, run_seed
    from campaign.store import stored_result

    stored = stored_result(out, settings, seed)
    faults = faults_or_none(faults_of, settings, seed)
    again = replay(run_seed, settings, faults, seed, stored)
    files = write_replay(out / f"replay-{seed}", again, fewest)
    failure = first_failure(again.result)
    console.print(f"seed {seed}: {again.comparison}", soft_wrap=True, markup=False)
    if failure:
        console.print(f"  {failure}", soft_wrap=True, markup=False)
    for fault in fewest.items if fewest else ():
        console.print(f"  it takes: {fault}", soft_wrap=True, markup=False)
    names = ", ".join(file.name for file in files)
    console.print(f"  written to {files[0].parent}/: {names}", soft_wrap=True, markup=False)
    is_other = stored is not None and not again.is_equal
    return EXIT_FAILED if failure or is_other else EXIT_OK


def run_replay(options: CampaignOptions, seed: int) -> int:
    """Repeats one seed of a campaign; answers the exit code: 1 if it fails, or differs.

    Raises:
        FaultError, StoreError, FolderError: What the user can put right.
    """
    from rich.console import Console

    settings = settings_of(options)
    with interrupt_on_sigterm():
        return record(Console(highlight=False), options.out, settings, seed)
