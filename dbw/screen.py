"""What `dbw demo` shows: a progress bar with a live line, and a short table at the end."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console
from rich.progress import TextColumn
from rich.table import Table

from dbw.drive import DriveProgress
from dbw.progress import ProgressBar
from gateway.state import CarState
from runtime.clock import monotonic_ns
from telemetry.report import UAH_MAX_ERROR_M, UAH_RMSE_M, DriveReport

REFRESH_NS = 200_000_000
"""A refresh costs some ms of processor time, which in real time the nodes need too."""


def state_line(state: CarState) -> str:
    """One line for a person: speed, steering wheel, mode, codes."""
    speed = _number(state.speed_mps, "4.1f")
    steering = _number(math.degrees(state.steering_wheel_angle_rad), "+5.0f")
    mode = "unknown" if state.mode is None else state.mode.name
    codes = "?" if state.codes is None else " ".join(code.name for code in state.codes) or "none"
    return f"{speed} m/s  steer {steering} deg  {mode}  codes {codes}"


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "?"


class DriveScreen(ProgressBar):
    """Progress of one drive.

    Args:
        console: Where to.
        goal_m: Length of the bar.
    """

    def __init__(self, console: Console, goal_m: float) -> None:
        super().__init__(console, goal_m, TextColumn("{task.completed:4.0f}/{task.total:.0f} m"))
        self._goal_m = goal_m
        self._newest_ns = 0

    def show(self, now: DriveProgress) -> None:
        """Takes a tick; draws it if the last one drawn is old enough."""
        now_ns = monotonic_ns()
        if now_ns - self._newest_ns < REFRESH_NS:
            return
        self._newest_ns = now_ns
        self.draw(min(max(now.progress_m, 0.0), self._goal_m), state_line(now.state))


def print_report(console: Console, report: DriveReport, files: list[Path]) -> None:
    """The short table, and where the files are."""
    table = Table(show_header=True, header_style="bold", box=None, pad_edge=False)
    table.add_column(f"{report.track}, {report.vehicle}")
    table.add_column("this drive", justify="right")
    table.add_column("UAH", justify="right", style="dim")
    table.add_row("lap completed", "yes" if report.lap_completed else "no", "yes")
    table.add_row("distance", f"{report.distance_m:.1f} m", "about 800 m")
    table.add_row("duration", f"{report.duration_s:.1f} s", "")
    table.add_row("error, RMSE", _metres(report.rmse_m), _metres(UAH_RMSE_M))
    table.add_row("error, largest", _metres(report.max_error_m), _metres(UAH_MAX_ERROR_M))
    table.add_row("speed, largest", f"{3.6 * report.speed_max_mps:.1f} km/h", "25 km/h")
    load = f"{100 * report.bus_load_mean:.1f} / {100 * report.bus_load_max:.1f} %"
    table.add_row("bus load, mean / largest", load, "")
    table.add_row("frames", str(report.frames), "")
    table.add_row("emergency brakes", str(report.emergency_brakes), "")
    table.add_row("codes", " ".join(report.codes) or "none", "")
    table.add_row("time against the wall clock", f"{report.real_time_factor:.1f} x", "1 x")
    console.print(table)
    folder = files[0].parent if files else Path()
    names = ", ".join(file.name for file in files)
    console.print(f"written to {folder}/: {names}", highlight=False, soft_wrap=True)


def _metres(value: float) -> str:
    return f"{value:.3f} m" if math.isfinite(value) else "-"
