"""`dbw demo` in virtual time: what it writes, that it repeats, and how it ends early."""

from __future__ import annotations

import json
import math
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dbc.database import VEHICLE_DBC, load
from dbw.drive import DriveProgress
from dbw.main import main
from dbw.plan import RADIUS_RESERVE, make_plan
from dbw.screen import DriveScreen
from dbw.virtual_stage import VirtualStage
from planner.road import open_road
from telemetry.report import UAH_MAX_ERROR_M, UAH_RMSE_M
from vehicles import load_vehicle

pytestmark = pytest.mark.whole_car

Capture = pytest.CaptureFixture[str]
FILES = ["drive.log", "path.png", "report.json", "signals.png"]
REPORT_KEYS = {
    "track", "vehicle", "bus", "lap_completed", "distance_m", "duration_s", "rmse_m",
    "max_error_m", "speed_max_mps", "frames", "bus_load_mean", "bus_load_max",
    "emergency_brakes", "codes", "real_time_factor", "seed", "trace_sha256",
    "planner_period_ms", "localisation", "baseline",
}  # fmt: skip
LOG_LINE = re.compile(r"\(\d{10}\.\d{6}\) vcan0 ([0-9A-F]{3})#((?:[0-9A-F]{2}){0,8})")
DISTANCE_M = 12.0


def run(out: Path, *options: str) -> dict[str, Any]:
    """Drives a short way; answers the report."""
    arguments = ["demo", "--distance-m", str(DISTANCE_M), "--out", str(out), *options]
    assert main(arguments) == 0
    report: dict[str, Any] = json.loads((out / "report.json").read_text())
    return report


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the results of one short drive, seed 0."""
    out = tmp_path_factory.mktemp("demo") / "out" / "demo"
    run(out)
    return out


def report_in(folder: Path) -> dict[str, Any]:
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report


def test_drive_leaves_four_files_and_nothing_else(driven: Path) -> None:
    assert sorted(item.name for item in driven.iterdir()) == FILES
    assert [item.name for item in driven.parent.iterdir()] == ["demo"]


def test_report_has_every_key_and_believable_numbers(driven: Path) -> None:
    report = report_in(driven)
    assert report.keys() >= REPORT_KEYS
    assert (report["track"], report["vehicle"]) == ("campus", "tabby_evo")
    assert report["bus"] == "simulated" and report["seed"] == 0
    assert report["lap_completed"] is False and report["ended_early"] == ""
    assert abs(report["distance_m"] - DISTANCE_M) < 1.5
    assert 5.0 < report["duration_s"] < 20.0
    assert 0.0 < report["rmse_m"] < report["max_error_m"] < 0.15
    assert 2.0 < report["speed_max_mps"] < 4.0
    assert 0.1 < report["bus_load_mean"] <= report["bus_load_max"] < 0.5
    assert report["emergency_brakes"] == 0 and report["codes"] == []
    assert report["real_time_factor"] > 1.0
    assert re.fullmatch(r"[0-9a-f]{64}", report["trace_sha256"])
    assert report["localisation"]["fix_latency_s"] == 0.1
    assert report["baseline"] == {
        "source": report["baseline"]["source"],
        "rmse_m": UAH_RMSE_M,
        "max_error_m": UAH_MAX_ERROR_M,
    }


def test_log_is_candumps_and_every_frame_decodes_by_our_dbc(driven: Path) -> None:
    database = load(VEHICLE_DBC)
    lines = (driven / "drive.log").read_text().splitlines()
    assert len(lines) == report_in(driven)["frames"] > 5000
    seen = set()
    newest = ""
    for line in lines:
        found = LOG_LINE.fullmatch(line)
        assert found, line
        assert line[:19] >= newest
        newest = line[:19]
        can_id, data = int(found[1], 16), bytes.fromhex(found[2])
        database.decode_message(can_id, data, decode_choices=False, allow_truncated=False)
        seen.add(can_id)
    assert seen >= {0x181, 0x182, 0x183, 0x184, 0x185, 0x201, 0x202, 0x203, 0x204, 0x706}


@pytest.mark.parametrize("name", ["path.png", "signals.png"])
def test_pictures_are_pngs_of_a_readable_size(driven: Path, name: str) -> None:
    data = (driven / name).read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n") and data.endswith(b"IEND\xaeB`\x82")
    width, height = struct.unpack(">II", data[16:24])
    assert 1200 <= width <= 3000 and 700 <= height <= 3000
    assert 30_000 < len(data) < 2_000_000


def test_same_seed_is_the_same_drive_and_another_seed_another(driven: Path, tmp_path: Path) -> None:
    again, other = run(tmp_path / "again"), run(tmp_path / "other", "--seed", "1")
    first = report_in(driven)
    assert again["trace_sha256"] == first["trace_sha256"]
    assert again["rmse_m"] == first["rmse_m"]
    assert (tmp_path / "again/drive.log").read_bytes() == (driven / "drive.log").read_bytes()
    assert other["trace_sha256"] != first["trace_sha256"]


def test_own_road_and_slow_planner_drive_a_whole_lap(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "ring.csv"
    rows = [
        f"{16 * math.cos(a):.5f},{16 * math.sin(a):.5f},3,3"
        for a in (math.tau * n / 90 for n in range(90))
    ]
    file.write_text("\n".join(rows))
    out = tmp_path / "out"
    arguments = ["demo", "--track", str(file), "--out", str(out), "--planner-period-ms", "50"]
    assert main(arguments) == 0
    report = report_in(out)
    assert report["track"] == "ring" and report["lap_completed"] is True
    assert report["planner_period_ms"] == 50.0 and report["max_error_m"] < 0.5
    assert report["goal_m"] == pytest.approx(math.tau * 16.0, rel=0.02)
    shown = capsys.readouterr()
    assert "lap completed" in shown.out and "0.863 m" in shown.out and shown.err == ""


def press_stop_at(metres: float) -> Callable[[VirtualStage, DriveProgress], None]:
    def act(stage: VirtualStage, now: DriveProgress) -> None:
        stage.world.car.driver.emergency_stop_pressed = now.progress_m > metres

    return act


def touch_brake_at(metres: float) -> Callable[[VirtualStage, DriveProgress], None]:
    def act(stage: VirtualStage, now: DriveProgress) -> None:
        stage.world.car.driver.brake_pedal_ratio = 0.5 if now.progress_m > metres else 0.0

    return act


def intervene(
    monkeypatch: pytest.MonkeyPatch, act: Callable[[VirtualStage, DriveProgress], None]
) -> None:
    """Has somebody in the car act at every tick of the drive."""
    stages: list[VirtualStage] = []
    enter = VirtualStage.__enter__

    def remember(stage: VirtualStage) -> VirtualStage:
        stages.append(stage)
        return enter(stage)

    monkeypatch.setattr(VirtualStage, "__enter__", remember)
    monkeypatch.setattr(DriveScreen, "show", lambda self, now: act(stages[-1], now))


def test_emergency_brake_is_written_down_and_explained(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    intervene(monkeypatch, press_stop_at(4.0))
    out = tmp_path / "out"
    assert main(["demo", "--distance-m", "20", "--out", str(out)]) == 1
    assert sorted(item.name for item in out.iterdir()) == FILES
    report = report_in(out)
    assert report["emergency_brakes"] == 1 and "ER1" in report["codes"]
    assert report["lap_completed"] is False and "EMERGENCY" in report["ended_early"]
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and line.startswith("dbw: error: the drive ended early after 4")
    assert "codes ER1" in line
    assert "why: The car braked" in line and "the emergency stop was pressed" in line


def test_driver_who_takes_over_ends_the_drive_without_an_emergency(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    intervene(monkeypatch, touch_brake_at(4.0))
    out = tmp_path / "out"
    assert main(["demo", "--distance-m", "20", "--out", str(out)]) == 1
    report = report_in(out)
    assert report["emergency_brakes"] == 0 and report["ended_early"].startswith("mode MANUAL")
    assert "first:" not in capsys.readouterr().err


def test_interrupted_drive_leaves_nothing(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(stage: VirtualStage, now: DriveProgress) -> None:
        raise KeyboardInterrupt

    intervene(monkeypatch, interrupt)
    assert main(["demo", "--out", str(tmp_path / "a" / "b")]) == 130
    assert list(tmp_path.iterdir()) == []


def test_stack_that_does_not_get_ready_is_explained(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    enter = VirtualStage.__enter__

    def without_brake(stage: VirtualStage) -> VirtualStage:
        stage.world.stations["BrakeServo"].is_alive = False
        return enter(stage)

    monkeypatch.setattr(VirtualStage, "__enter__", without_brake)
    assert main(["demo", "--out", str(tmp_path / "out")]) == 1
    line = capsys.readouterr().err
    assert line.startswith("dbw: error: the car did not get ready: ") and line.count("\n") == 1
    assert "brake-servo" in line
    assert list(tmp_path.iterdir()) == []


def test_line_planned_keeps_a_fifth_of_the_steering_in_reserve() -> None:
    vehicle = load_vehicle("tabby_evo")
    plan = make_plan(vehicle=vehicle, road=open_road("campus"), planner_period_ns=20_000_000)
    assert RADIUS_RESERVE / vehicle.curvature_per_m_max == pytest.approx(12.0, abs=0.1)
    assert plan.line.radius_m_min > 12.0
    assert plan.is_whole_lap and plan.goal_m == pytest.approx(800.0, abs=1.0)
    assert plan.speeds_mps.max() == pytest.approx(25.0 / 3.6)


@pytest.mark.slow
def test_campus_lap_stays_within_a_third_of_the_papers_errors(tmp_path: Path) -> None:
    assert main(["demo", "--out", str(tmp_path)]) == 0
    report = report_in(tmp_path)
    assert report["lap_completed"] is True
    assert report["rmse_m"] < UAH_RMSE_M / 3
    assert report["max_error_m"] < UAH_MAX_ERROR_M / 3
    assert report["emergency_brakes"] == 0 and report["codes"] == []
    assert report["speed_max_mps"] == pytest.approx(25.0 / 3.6, rel=0.03)


def test_a_car_with_motor_drives_on_the_bus_is_driven(tmp_path: Path) -> None:
    report = run(tmp_path, "--vehicle", "baja_5b")
    assert (report["emergency_brakes"], report["codes"]) == (0, [])
    assert report["max_error_m"] < 0.2
    log = (tmp_path / "drive.log").read_text()
    for can_id in (0x211, 0x312, 0x313, 0x191, 0x292, 0x293):  # targets, and what became of them
        assert log.count(f" {can_id:03X}#") > 100


def test_a_vehicle_file_of_ones_own_is_driven(tmp_path: Path, capsys: Capture) -> None:
    text = load_vehicle("tabby_evo").text.replace('name = "tabby_evo"', 'name = "mine"')
    file = tmp_path / "mine.toml"
    file.write_text(text.replace("mass_kg = { value = 880.0", "mass_kg = { value = 1500.0"))
    arguments = ["demo", "--vehicle", str(file), "--distance-m", "20", "--out", str(tmp_path / "o")]
    assert main(arguments) == 0
    assert "campus, mine" in capsys.readouterr().out
