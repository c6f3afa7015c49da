"""The report as JSON, and the pictures as files."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dbc.messages import ErrorCode, Mode
from telemetry.plots import DPI, PathPicture, plot_path, plot_signals
from telemetry.report import Baseline, DriveReport, LocalisationNumbers
from telemetry.signals import CodeSpan, ModeSpan, Signals, Trace

pytestmark = pytest.mark.whole_car

REPORT = DriveReport(
    track="campus",
    vehicle="tabby_evo",
    bus="simulated",
    lap_completed=True,
    goal_m=800.0,
    ended_early="",
    distance_m=800.1,
    duration_s=130.0,
    rmse_m=0.04,
    max_error_m=0.12,
    speed_max_mps=6.9,
    frames=120_000,
    bus_load_mean=0.2,
    bus_load_max=0.25,
    emergency_brakes=0,
    codes=("ER1", "ER5"),
    real_time_factor=50.0,
    seed=3,
    trace_sha256="ab",
    planner_period_ms=20.0,
    steering_lag_s=0.24,
    radius_m_min=13.0,
    localisation=LocalisationNumbers(
        fix_rate_hz=10.0,
        fix_sigma_m=0.02,
        fix_latency_s=0.1,
        fixes_used=100,
        fixes_rejected=1,
        error_rms_m=0.05,
        error_max_m=0.1,
    ),
    baseline=Baseline(),
)


def png_size(file: Path) -> tuple[int, int]:
    data = file.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def test_report_reads_back_as_written() -> None:
    document = json.loads(REPORT.to_json())
    assert document["rmse_m"] == 0.04 and document["codes"] == ["ER1", "ER5"]
    assert document["localisation"]["fix_sigma_m"] == 0.02
    assert document["baseline"]["rmse_m"] == 0.347 and document["baseline"]["max_error_m"] == 0.863


def test_what_is_not_known_is_null_not_nan() -> None:
    unknown = replace(REPORT, rmse_m=math.nan, max_error_m=math.inf)
    text = unknown.to_json()
    assert "NaN" not in text and "Infinity" not in text
    assert json.loads(text)["rmse_m"] is None and json.loads(text)["max_error_m"] is None


def ring(radius_m: float, count: int = 120) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    angle = np.linspace(0.0, math.tau, count, endpoint=False)
    return np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle)])


@pytest.mark.parametrize("driven", [100, 1, 0])
def test_path_picture_is_drawn_for_whole_and_for_no_drives(tmp_path: Path, driven: int) -> None:
    picture = PathPicture(
        title="a ring",
        left_edge_xy_m=ring(18.0),
        right_edge_xy_m=ring(22.0),
        planned_xy_m=ring(20.0),
        driven_xy_m=ring(20.1)[:driven],
        error_m=np.full(driven, -0.1),
        progress_m=np.arange(driven, dtype=np.float64),
    )
    file = tmp_path / "path.png"
    plot_path(file, picture)
    width, height = png_size(file)
    assert width == 13 * DPI and 5 * DPI < height < 15 * DPI
    assert file.stat().st_size > 20_000


def test_signals_picture_is_drawn_with_modes_and_codes(tmp_path: Path) -> None:
    time_s = np.linspace(0.0, 10.0, 200)
    trace = Trace(time_s=time_s, setpoint=np.sin(time_s), measured=np.cos(time_s))
    signals = Signals(
        steering_rad=trace,
        speed_mps=trace,
        brake_ratio=trace,
        modes=tuple(
            ModeSpan(start_s=float(n), end_s=n + 1.0, mode=mode) for n, mode in enumerate(Mode)
        ),
        codes=(CodeSpan(start_s=5.0, end_s=5.0, code=ErrorCode.ER4),),
        end_s=10.0,
    )
    file = tmp_path / "signals.png"
    plot_signals(file, title="t", signals=signals)
    assert png_size(file) == (13 * DPI, 9 * DPI)
    quiet = replace(signals, codes=(), modes=(ModeSpan(start_s=0.0, end_s=10.0, mode=Mode.READY),))
    plot_signals(tmp_path / "quiet.png", title="t", signals=quiet)
    assert (tmp_path / "quiet.png").read_bytes() != file.read_bytes()


def test_signals_picture_of_an_empty_log_is_drawn(tmp_path: Path) -> None:
    none = Trace(time_s=np.zeros(0), setpoint=np.zeros(0), measured=np.zeros(0))
    signals = Signals(
        steering_rad=none, speed_mps=none, brake_ratio=none, modes=(), codes=(), end_s=0.0
    )
    plot_signals(tmp_path / "signals.png", title="t", signals=signals)
    assert png_size(tmp_path / "signals.png") == (13 * DPI, 9 * DPI)
