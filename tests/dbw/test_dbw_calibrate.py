"""`dbw calibrate`: the zero of each car found and written, and every mistake in one line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from dbw.main import main
from simulation.plant.derived import plant_of
from simulation.straight_roll import roll_straight
from simulation.trace import candump_lines
from simulation.world import World
from vehicles import known_vehicles, load_vehicle

pytestmark = pytest.mark.whole_car

Capture = pytest.CaptureFixture[str]
NAMES = known_vehicles()
BAJA = load_vehicle("baja_5b")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two rolls of the small car."""
    folder = tmp_path_factory.mktemp("rolls")
    found = []
    for seed in (1, 2):
        world = roll_straight(BAJA, seed, way_m=10.0)
        found.append(folder / f"roll{seed}.log")
        found[-1].write_text("\n".join(candump_lines(world.trace.rows, "can0")) + "\n")
    return found


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "my_car.toml"
    path.write_text(BAJA.text)
    return path


def mistake(capsys: Capture, *arguments: str | Path) -> str:
    assert main(["calibrate", *map(str, arguments)]) == 2
    (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("dbw: error: ")]
    return line.removeprefix("dbw: error: ")


@pytest.mark.parametrize("name", NAMES)
def test_the_zero_of_each_car_is_found_within_its_uncertainty_and_used_from_then_on(
    name: str, tmp_path: Path, capsys: Capture
) -> None:
    vehicle = load_vehicle(name)
    truth_rad = plant_of(vehicle).sensors.column_angle_zero_rad
    path = tmp_path / "car.toml"
    path.write_text(vehicle.text)
    assert main(["calibrate", str(path), "--simulate"]) == 0
    told = capsys.readouterr().out
    found = re.search(r"zero ([+-][\d.]+) ± ([\d.]+) rad of steering wheel", told)
    assert found is not None
    zero_rad, uncertainty_rad = float(found[1]), float(found[2])
    assert abs(zero_rad - truth_rad) <= uncertainty_rad
    assert uncertainty_rad <= 0.1 / 57.2958 * vehicle.steering.ratio  # 0.1 deg of road wheel
    calibrated = load_vehicle(str(path))
    assert calibrated.steering.zero_rad == pytest.approx(zero_rad, abs=0.0001)
    world = World(calibrated, seed=3)
    world.run_for(1.0)
    steering: Any = world.stations["Steering"].node
    left_rad = steering._status().steering_wheel_angle_rad - world.car.truth.column_angle_rad
    noise_rad = 3.0 * world.car.params.sensors.column_angle_noise_rad
    assert abs(left_rad - (truth_rad - calibrated.steering.zero_rad)) <= noise_rad


def test_two_logs_give_one_zero_and_all_else_in_the_file_stays(
    file: Path, logs: list[Path], capsys: Capture
) -> None:
    assert main(["calibrate", str(file), *map(str, logs)]) == 0
    told = capsys.readouterr().out
    assert "together: " in told and f"written to {file}: steering.zero_rad = " in told
    lines = file.read_text().splitlines()
    (line,) = set(lines) - set(BAJA.text.splitlines())
    assert re.fullmatch(
        r'zero_rad = \{ value = -?[\d.]+, source = "dbw calibrate: 2\d\.\d m straight, within'
        r' 0\.00\d\d rad \(95 %\), rolls [0-9a-f]{8} [0-9a-f]{8}" \}', line
    )  # fmt: skip
    assert [x for x in lines if x != line] == BAJA.text.splitlines()


def test_the_same_log_twice_would_count_its_zero_twice(
    file: Path, logs: list[Path], capsys: Capture
) -> None:
    assert "the same roll a second time" in mistake(capsys, file, logs[0], logs[0])
    assert main(["calibrate", str(file), str(logs[0])]) == 0
    text = file.read_text()
    assert "has its zero from this roll already" in mistake(capsys, file, logs[0])
    assert file.read_text() == text


def test_a_dry_run_writes_nothing(file: Path, logs: list[Path], capsys: Capture) -> None:
    assert main(["calibrate", str(file), str(logs[0]), "--dry-run"]) == 0
    assert "written" not in capsys.readouterr().out
    assert file.read_text() == BAJA.text


def test_a_line_walked_carelessly_needs_a_longer_roll(
    file: Path, logs: list[Path], capsys: Capture
) -> None:
    told = mistake(capsys, file, logs[0], "--heading-deg", "2")
    assert "wanted 0.0052 rad (0.1 deg of road wheel): roll 2" in told
    assert file.read_text() == BAJA.text


def test_a_part_of_the_log_in_which_the_car_stands_is_refused(
    file: Path, logs: list[Path], capsys: Capture
) -> None:
    assert "the car did not roll" in mistake(capsys, file, logs[0], "--to", "1")


def test_a_zero_for_which_the_sensor_has_no_room_is_refused_and_not_written(
    file: Path, logs: list[Path], capsys: Capture
) -> None:
    text = BAJA.text.replace("value = 1.3,", "value = 1.2,")  # the range itself
    file.write_text(text)
    assert "steering.sensor_angle_rad_max = 1.2: must be at least" in mistake(
        capsys, file, logs[0]
    )
    assert file.read_text() == text


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("none.toml", "x.log"), "none.toml: cannot be read"),
        (("beetle", "--simulate"), "vehicle 'beetle' is not known"),
        (("baja_5b", "--simulate"), "one of the package's own files: copy it, or take --dry-run"),
        (("baja_5b",), "no log: name one of a straight roll"),
        (("baja_5b", "x.log", "--simulate"), "a log and --simulate: one of them"),
        (("baja_5b", "none.log", "--dry-run"), "none.log"),
        (("baja_5b", "--simulate", "--heading-deg", "nan"), "--heading-deg nan: allowed above 0"),
        (("baja_5b", "--simulate", "--heading-deg", "0"), "--heading-deg 0: allowed above 0"),
        (("baja_5b", "--simulate", "--seed", "x"), "a whole number from 0"),
    ],
)
def test_a_mistake_is_told_in_one_line(
    arguments: tuple[str, ...], told: str, capsys: Capture
) -> None:
    assert told in mistake(capsys, *arguments)


def test_a_log_without_the_vehicle_bus_is_refused(
    file: Path, tmp_path: Path, capsys: Capture
) -> None:
    other = tmp_path / "other.log"
    other.write_text("(0.000000) can0 123#00\n")
    told = mistake(capsys, file, other)
    assert told == f"{other}: no frame of STEER_STATUS: is it the vehicle bus?"


def test_a_file_that_is_read_only_is_left_alone(
    file: Path, logs: list[Path], capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also for the super-user, who may write what is read-only: refused as for anybody else."""
    opened = Path.open

    def refuse(path: Path, mode: str = "r", **rest: Any) -> Any:
        if path == file and "+" in mode:
            raise PermissionError(13, "Permission denied")
        return opened(path, mode, **rest)

    monkeypatch.setattr(Path, "open", refuse)
    told = mistake(capsys, file, logs[0])
    assert told == f"{file} cannot be written: Permission denied"
    assert file.read_text() == BAJA.text and sorted(file.parent.iterdir()) == [file]
