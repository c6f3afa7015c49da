"""The live line and the table."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from dbc.messages import ErrorCode, Mode
from dbw.drive import DriveProgress
from dbw.screen import DriveScreen, print_report, state_line
from gateway.state import CarState
from simulation.link import SimulationLink
from simulation.world import World
from telemetry.report import Baseline, DriveReport, LocalisationNumbers
from vehicles import load_vehicle


@pytest.fixture(scope="module")
def state() -> CarState:
    return SimulationLink(World(load_vehicle("tabby_evo"), 0)).state()


def test_live_line_tells_speed_steering_mode_and_codes(state: CarState) -> None:
    driving = replace(
        state,
        speed_mps=5.94,
        steering_wheel_angle_rad=-math.pi,
        mode=Mode.AUTOMATIC,
        codes=(ErrorCode.ER1, ErrorCode.ER5),
    )
    assert state_line(driving) == " 5.9 m/s  steer  -180 deg  AUTOMATIC  codes ER1 ER5"
    assert state_line(replace(driving, codes=())).endswith("codes none")


def test_live_line_does_not_invent_what_is_not_heard(state: CarState) -> None:
    assert state_line(state) == "? m/s  steer ? deg  unknown  codes ?"


def test_bar_is_drawn_on_a_terminal_within_80_columns(state: CarState) -> None:
    shown = io.StringIO()
    console = Console(file=shown, force_terminal=True, width=80, color_system=None)
    driving = replace(state, speed_mps=5.9, steering_wheel_angle_rad=-8.0, mode=Mode.AUTOMATIC)
    with DriveScreen(console, 800.0) as screen:
        screen.show(DriveProgress(progress_m=412.0, state=replace(driving, codes=())))
    assert "412/800 m" in shown.getvalue() and "codes none" in shown.getvalue()


def test_log_file_gets_no_bar(state: CarState) -> None:
    shown = io.StringIO()
    with DriveScreen(Console(file=shown), 800.0) as screen:
        screen.show(DriveProgress(progress_m=412.0, state=state))
    assert shown.getvalue() == ""


def test_table_shows_the_drive_beside_the_papers(tmp_path: Path) -> None:
    report = DriveReport(
        track="ring", vehicle="tabby_evo", bus="simulated", lap_completed=False, goal_m=9.0,
        ended_early="x", distance_m=4.0, duration_s=3.0, rmse_m=math.nan, max_error_m=0.012,
        speed_max_mps=5.0, frames=7, bus_load_mean=0.2, bus_load_max=0.3, emergency_brakes=1,
        codes=("ER2",), real_time_factor=50.0, seed=0, trace_sha256="", planner_period_ms=20.0,
        steering_lag_s=0.2, radius_m_min=12.0, baseline=Baseline(),
        localisation=LocalisationNumbers(
            fix_rate_hz=10.0, fix_sigma_m=0.02, fix_latency_s=0.1, fixes_used=0,
            fixes_rejected=0, error_rms_m=math.nan, error_max_m=math.nan,
        ),
    )  # fmt: skip
    shown = io.StringIO()
    print_report(Console(file=shown, width=100), report, [tmp_path / "report.json"])
    rows = {line.split("  ")[0]: line.split()[-3:] for line in shown.getvalue().splitlines()}
    assert rows["error, RMSE"] == ["-", "0.347", "m"]
    assert "0.012 m" in shown.getvalue() and "18.0 km/h" in shown.getvalue()
    assert "ER2" in shown.getvalue() and f"written to {tmp_path}/: report.json" in shown.getvalue()
