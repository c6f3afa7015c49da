"""From a drive's samples and bus log to its report, pictures and log file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dbw.drive import DriveEnd
from dbw.plan import DrivePlan
from planner.errors import TrackingErrors, tracking_errors
from planner.gnss import LATENCY_NS, PERIOD_NS, SIGMA_M
from planner.road import FloatArray, Road
from simulation.trace import candump_lines
from telemetry.bus_log import BusLog
from telemetry.plots import PathPicture, plot_path, plot_signals
from telemetry.recording import DriveRecorder
from telemetry.report import Baseline, DriveReport, LocalisationNumbers
from telemetry.signals import Signals, read_signals

NS_PER_S = 1e9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """A drive that is over."""

    plan: DrivePlan
    end: DriveEnd
    recorder: DriveRecorder
    log: BusLog
    bus: str
    """As the report calls it."""
    channel: str
    """As the log file calls it."""
    seed: int
    trace_sha256: str
    real_time_factor: float


def summarise(drive: Drive) -> tuple[DriveReport, Signals, TrackingErrors | None]:
    """A drive in numbers, its signals, and its errors along the path (None if it never moved)."""
    plan, path = drive.plan, drive.recorder.path()
    vehicle = plan.vehicle
    signals = read_signals(drive.log, vehicle)
    moving = path.moving
    errors = (
        tracking_errors(plan.line, path.x_m[moving], path.y_m[moving]) if moving.any() else None
    )
    located = drive.recorder.localisation_error()
    load = drive.log.load(round(vehicle.bus.bitrate_bps))
    report = DriveReport(
        track=plan.road.name,
        vehicle=vehicle.name,
        bus=drive.bus,
        lap_completed=errors is not None and errors.lap_completed and not drive.end.ended_early,
        goal_m=plan.goal_m,
        ended_early=drive.end.ended_early,
        distance_m=path.distance_m,
        duration_s=path.duration_s,
        rmse_m=math.nan if errors is None else errors.rmse_m,
        max_error_m=math.nan if errors is None else errors.max_error_m,
        speed_max_mps=float(np.abs(path.speed_mps).max()) if len(path.speed_mps) else 0.0,
        frames=len(drive.log) + drive.log.left_out,
        bus_load_mean=load.mean,
        bus_load_max=load.max,
        emergency_brakes=signals.emergency_brakes,
        codes=signals.code_names,
        real_time_factor=drive.real_time_factor,
        seed=drive.seed,
        trace_sha256=drive.trace_sha256,
        planner_period_ms=plan.planner_period_ns / 1e6,
        steering_lag_s=plan.pursuit.steering_lag_s,
        radius_m_min=plan.line.radius_m_min,
        localisation=LocalisationNumbers(
            fix_rate_hz=NS_PER_S / PERIOD_NS,
            fix_sigma_m=SIGMA_M,
            fix_latency_s=LATENCY_NS / NS_PER_S,
            fixes_used=drive.end.fixes_used,
            fixes_rejected=drive.end.fixes_rejected,
            error_rms_m=math.nan if located is None else located.rms_m,
            error_max_m=math.nan if located is None else located.max_m,
        ),
        baseline=Baseline(),
    )
    return report, signals, errors


def write_results(
    folder: Path, drive: Drive, report: DriveReport, signals: Signals, errors: TrackingErrors | None
) -> None:
    """Writes report.json, path.png, signals.png and drive.log.

    Raises:
        OSError: A file cannot be written.
    """
    path, plan = drive.recorder.path(), drive.plan
    moving = path.moving
    title = f"{plan.road.name}, {plan.vehicle.name}"
    if errors is not None:
        title += (
            f": RMSE {100.0 * errors.rmse_m:.1f} cm, largest error "
            f"{100.0 * errors.max_error_m:.1f} cm over {path.distance_m:.0f} m"
        )
    left_xy_m, right_xy_m = road_edges(plan.road)
    picture = PathPicture(
        title=title,
        left_edge_xy_m=left_xy_m,
        right_edge_xy_m=right_xy_m,
        planned_xy_m=np.column_stack([plan.line.x_m, plan.line.y_m]),
        driven_xy_m=np.column_stack([path.x_m[moving], path.y_m[moving]]),
        error_m=np.zeros(0) if errors is None else errors.lateral_m,
        progress_m=np.zeros(0) if errors is None else errors.progress_m,
    )
    plot_path(folder / "path.png", picture)
    what = f"{plan.road.name}, {plan.vehicle.name}, {drive.bus} bus"
    plot_signals(folder / "signals.png", title=what, signals=signals)
    with (folder / "drive.log").open("w", encoding="ascii") as file:
        file.writelines(f"{line}\n" for line in candump_lines(drive.log.rows(), drive.channel))
    (folder / "report.json").write_text(report.to_json(), encoding="utf-8")


def road_edges(road: Road) -> tuple[FloatArray, FloatArray]:
    """Left and right edge of a road, a point for each of its centre line's."""
    centre = road.center_xy_m
    along = np.roll(centre, -1, axis=0) - np.roll(centre, 1, axis=0)
    along /= np.hypot(*along.T)[:, None]
    to_left = np.column_stack([-along[:, 1], along[:, 0]])
    left: FloatArray = centre + road.width_left_m[:, None] * to_left
    right: FloatArray = centre - road.width_right_m[:, None] * to_left
    return left, right
