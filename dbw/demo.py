"""`dbw demo`: a drive from a road to its pictures."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import click

from canbus.interface_errors import SOCKETCAN
from dbw.dashboard import DEFAULT_PORT, PORT_MAX
from dbw.failures import EXIT_FAILED, EXIT_OK, UserMistake, complain
from dbw.options import VIRTUAL, WholeNumber, bus_options, check_two_buses, vehicle_option

if TYPE_CHECKING:
    from dbw.plan import DrivePlan
    from dbw.virtual_stage import VirtualStage
    from dbw.wall_stage import WallStage
    from telemetry.bus_log import BusLog
    from vehicles import Vehicle

NS_PER_MS = 1_000_000
SEED_MAX = 2**32 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoOptions:
    """The command line of `dbw demo`."""

    track: str
    vehicle: str
    seed: int
    out: Path
    realtime: bool
    interface: str
    channel: str
    harness_channel: str
    planner_period_ms: int
    distance_m: float | None
    dashboard_port: int | None = None


@click.command(
    epilog="""\b
Examples:
  dbw demo
  dbw demo --track zandvoort --seed 7 --out out/zandvoort
  dbw demo --realtime --distance-m 60
  dbw demo --realtime --dashboard
  dbw demo --realtime --interface socketcan --channel vcan0 --harness-channel vcan1"""
)
@click.option(
    "--track",
    default="campus",
    show_default=True,
    metavar="NAME|FILE.csv",
    help="campus, norisring, oschersleben, zandvoort, or a CSV of "
    "x_m,y_m,w_tr_right_m,w_tr_left_m (closed loop).",
)
@vehicle_option
@click.option(
    "--seed",
    type=WholeNumber(0, SEED_MAX),
    default=0,
    show_default=True,
    help="Of everything left to chance; in virtual time one seed is one drive.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/demo"),
    show_default=True,
    help="Folder for report.json, path.png, signals.png and drive.log.",
)
@click.option("--realtime", is_flag=True, help="Against the wall clock, on a real bus.")
@click.option(
    "--interface",
    type=click.Choice([VIRTUAL, SOCKETCAN]),
    default=VIRTUAL,
    show_default=True,
    help="With --realtime: all nodes in this process, or one process per node on SocketCAN.",
)
@bus_options
@click.option(
    "--planner-period-ms",
    type=int,
    default=20,
    show_default=True,
    help="How often the planner decides; the age limit of its decisions follows from it.",
)
@click.option(
    "--distance-m", type=float, default=None, help="Drive this far and stop; default: a whole lap."
)
@click.option(
    "--dashboard",
    "dashboard_port",
    type=WholeNumber(0, PORT_MAX),
    is_flag=False,
    flag_value=str(DEFAULT_PORT),
    default=None,
    metavar="[PORT]",
    help=f"With --realtime: the drive as a web page, as `dbw dashboard`.  [port: {DEFAULT_PORT}]",
)
def demo(
    track: str,
    vehicle: str,
    seed: int,
    out: Path,
    realtime: bool,
    interface: str,
    channel: str,
    harness_channel: str,
    planner_period_ms: int,
    distance_m: float | None,
    dashboard_port: int | None,
) -> int:
    """Drive a road with the reference planner and draw what happened.

    Plans a line inside the road's width that the vehicle can steer, starts the whole stack,
    drives through the public gateway API with the errors of a real satellite receiver, and
    measures against the true position. Without --realtime everything runs in virtual time.
    """
    options = DemoOptions(
        track=track,
        vehicle=vehicle,
        seed=seed,
        out=out,
        realtime=realtime,
        interface=interface,
        channel=channel,
        harness_channel=harness_channel,
        planner_period_ms=planner_period_ms,
        distance_m=distance_m,
        dashboard_port=dashboard_port,
    )
    if dashboard_port is not None and not realtime:
        raise UserMistake("--dashboard needs --realtime: virtual time is over before you look")
    if interface != VIRTUAL and not realtime:
        raise UserMistake(f"--interface {interface} needs --realtime: virtual time has its own bus")
    if interface != VIRTUAL:
        check_two_buses(channel, harness_channel)
    return run_demo(options)


def run_demo(options: DemoOptions) -> int:
    """Drives and writes; answers the exit code.

    Raises:
        UserMistake, RoadError, VehicleError, FolderError, BusError, LaunchError: What the user
            can put right; nothing is written then.
    """
    from rich.console import Console

    from dbw.drive import drive
    from dbw.results import Drive, summarise, write_results
    from dbw.screen import DriveScreen, print_report
    from dbw.stage import DriveFailed
    from runtime.clock import monotonic_ns
    from telemetry.folder import ResultFolder

    plan = plan_of(options)
    console = Console(highlight=False)
    with ResultFolder(options.out) as folder, interrupt_on_sigterm():
        bus, stage = stage_of(options, plan)
        start_ns = monotonic_ns()
        try:
            with (
                stage,
                dashboard_of(options, plan),
                DriveScreen(console, plan.goal_m) as screen,
            ):
                end = drive(stage, plan, screen.show)
        except DriveFailed as error:
            complain(error)
            return EXIT_FAILED
        wall_s = (monotonic_ns() - start_ns) * 1e-9
        done = Drive(
            plan=plan,
            end=end,
            recorder=stage.recorder,
            log=stage.log,
            bus=bus,
            channel=options.channel,
            seed=options.seed,
            trace_sha256=stage.trace_sha256,
            real_time_factor=stage.log.end_s / wall_s,
        )
        report, signals, errors = summarise(done)
        write_results(folder.path, done, report, signals, errors)
        files = folder.commit()
    print_report(console, report, files)
    if not report.ended_early:
        return EXIT_OK
    codes = f"; codes {' '.join(report.codes)}" if report.codes else ""
    where = f"after {report.distance_m:.1f} m"
    why = _why(stage.log, plan.vehicle)
    complain(f"the drive ended early {where}: {report.ended_early}{codes}{why}")
    return EXIT_FAILED


def _why(log: BusLog, vehicle: Vehicle) -> str:
    """What `dbw why` says of the first thing that went wrong; empty if nothing did."""
    from telemetry.why.incident import Incident
    from telemetry.why.watch import Watch
    from telemetry.why.words import summary

    told = Watch(vehicle).follow(log.frames())
    incident = next((item for item in told if isinstance(item, Incident)), None)
    if incident is None:
        return ""
    return f"; why: {summary(incident, lambda time_ns: f'{time_ns / 1e9:.3f} s')}"


def plan_of(options: DemoOptions) -> DrivePlan:
    """Checks vehicle, period, road and distance, in this order, and plans."""
    from dbw.plan import make_plan
    from gateway.commands import PLANNER_PERIOD_NS_MIN, planner_period_ns_max
    from planner.road import open_road
    from vehicles import load_vehicle

    vehicle = load_vehicle(options.vehicle)
    low_ms, high_ms = (
        limit // NS_PER_MS for limit in (PLANNER_PERIOD_NS_MIN, planner_period_ns_max(vehicle))
    )
    if not low_ms <= options.planner_period_ms <= high_ms:
        raise UserMistake(
            f"--planner-period-ms {options.planner_period_ms}: allowed {low_ms} to {high_ms} ms "
            f"for {vehicle.name}"
        )
    return make_plan(
        vehicle=vehicle,
        road=open_road(options.track),
        planner_period_ns=options.planner_period_ms * NS_PER_MS,
        distance_m=options.distance_m,
    )


def stage_of(options: DemoOptions, plan: DrivePlan) -> tuple[str, VirtualStage | WallStage]:
    """The stage asked for, and what the report calls its bus."""
    if not options.realtime:
        from dbw.virtual_stage import VirtualStage

        return "simulated", VirtualStage(plan, options.seed)
    from dbw.wall_stage import in_process_stage, process_stage
    from runtime.launch import StackSettings

    if options.interface == VIRTUAL:
        return "virtual", in_process_stage(plan, options.seed, options.channel)
    settings = StackSettings(
        interface=options.interface,
        channel=options.channel,
        harness_channel=options.harness_channel,
        vehicle=options.vehicle,
    )
    return f"{options.interface} {options.channel}", process_stage(
        plan, options.seed, settings, lambda text: click.echo(text, err=True)
    )


@contextmanager
def dashboard_of(options: DemoOptions, plan: DrivePlan) -> Iterator[None]:
    """The page, while the drive lasts: its driver, and not its planner."""
    if options.dashboard_port is None:
        yield
        return
    from dbw.dashboard import DEFAULT_HOST, announce, require_server

    require_server()
    from dbw.dashboard_server import Setup, dashboard_beside
    from runtime.in_process import harness_channel_of
    from telemetry.dashboard.access import Access, new_token

    is_virtual = options.interface == VIRTUAL
    setup = Setup(
        interface=options.interface,
        channel=options.channel,
        vehicle=plan.vehicle,
        harness_channel=(
            harness_channel_of(options.channel) if is_virtual else options.harness_channel
        ),
        host=DEFAULT_HOST,
        port=options.dashboard_port,
        access=Access(new_token()),
    )
    with dashboard_beside(setup) as running:
        announce(setup, running)
        yield


@contextmanager
def interrupt_on_sigterm() -> Iterator[None]:
    """SIGTERM does what Ctrl-C does: the car stops, children end, nothing half-written stays."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    old = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, old)
