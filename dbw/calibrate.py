"""`dbw calibrate`: the steering's zero, measured and written into the vehicle file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from dbw.failures import EXIT_OK, UserMistake
from dbw.options import WholeNumber, span_options

if TYPE_CHECKING:
    from telemetry.decode.tables import Decoded, Decoder
    from telemetry.steering_zero import Roll, Zero
    from vehicles import Vehicle

HEADING_DEG: Final = 0.5
"""Assumption: two marks on a straight line, 1 cm beside it over a car's length."""
ROLL_WHEELBASES: Final = 40.0
"""Way of a simulated roll: four times what the default direction asks for."""
SIMULATED: Final = "simulated roll"


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateOptions:
    """The command line of `dbw calibrate`."""

    file: str
    logs: tuple[str, ...]
    simulate: bool
    seed: int
    heading_deg: float
    from_s: float
    to_s: float
    dry_run: bool


@click.command(
    epilog="""\b
Examples:
  dbw calibrate my_car.toml there.log back.log
  candump -L can0 | dbw calibrate my_car.toml - --dry-run
  dbw calibrate my_car.toml --simulate"""
)
@click.argument("file", metavar="FILE.toml|NAME")
@click.argument("logs", nargs=-1, metavar="[LOG|-]...")
@click.option("--simulate", is_flag=True, help="Instead of a log: the simulated car rolls.")
@click.option(
    "--seed", type=WholeNumber(0, 2**63 - 1), default=1, show_default=True,
    help="Of the simulated car.",
)  # fmt: skip
@click.option(
    "--heading-deg",
    type=float,
    default=HEADING_DEG,
    show_default=True,
    metavar="DEG",
    help="How well the direction at the end was that at the start (standard uncertainty).",
)
@span_options
@click.option("--dry-run", is_flag=True, help="Tell the zero, and write nothing.")
def calibrate(**given: object) -> int:
    """Measure what the steering sensor reads straight ahead, and write it into the vehicle file.

    In MANUAL, a driver rolls along a straight line and ends in the direction in which he began;
    he may correct on the way. Record that (dbw record, candump -L) with the nodes running this
    FILE, best there and back, a log each: the road's crossfall cancels. The ECUs use the zero when
    they are started with the file again. A zero that is known no better than 0.1 deg of road
    wheel, or cannot be one, is refused.
    """
    options = CalibrateOptions(**given)  # type: ignore[arg-type]
    if not options.logs and not options.simulate:
        raise UserMistake("no log: name one of a straight roll, - for a pipe, or --simulate")
    if options.logs and options.simulate:
        raise UserMistake("a log and --simulate: one of them is wanted")
    if not 0.0 < options.heading_deg <= 45.0:
        raise UserMistake(f"--heading-deg {options.heading_deg:g}: allowed above 0 up to 45")
    return run_calibrate(options)


def run_calibrate(options: CalibrateOptions) -> int:
    """Measures, tells, writes; answers the exit code.

    Raises:
        VehicleError, LogError, CalibrationError, UserMistake: What the user can put right.
    """
    from telemetry.steering_zero import CalibrationError, check_usable, combined, zero_of
    from vehicles import load_vehicle
    from vehicles.reading import is_file

    vehicle = load_vehicle(options.file)
    if not is_file(options.file) and not options.dry_run:
        raise UserMistake(
            f"{options.file} is one of the package's own files: copy it, or take --dry-run"
        )
    rolls = _rolls(options, vehicle)
    zeros = []
    for name, roll in rolls:
        try:
            zeros.append(zero_of(roll, vehicle, math.radians(options.heading_deg)))
        except CalibrationError as error:
            raise CalibrationError(f"{name}: {error}") from error
        _tell(name, zeros[-1], vehicle)
    zero = combined(zeros)
    if len(zeros) > 1:
        _tell("together", zero, vehicle)
    check_usable(zero, vehicle)
    click.echo(f"in force: {vehicle.steering.zero_rad:+.4f} rad")
    prints = " ".join(roll.fingerprint for _, roll in rolls)
    source = (
        f"dbw calibrate: {zero.way_m:.1f} m straight, within {zero.uncertainty_rad:.4f} rad"
        f" (95 %), rolls {prints}"
    )
    if options.dry_run:
        return EXIT_OK
    _write(Path(options.file), round(zero.zero_rad, 5), source)
    click.echo(f"written to {options.file}: steering.zero_rad = {zero.zero_rad:.5f}")
    return EXIT_OK


def _rolls(options: CalibrateOptions, vehicle: Vehicle) -> list[tuple[str, Roll]]:
    """Each log's roll, or the simulated one.

    Raises:
        CalibrationError: One cannot be used, or has been used already.
    """
    from telemetry.databases import load_databases
    from telemetry.decode.tables import Decoder
    from telemetry.steering_zero import ANGLE, SPEED, CalibrationError, roll_of

    databases = load_databases(())
    only = [databases.named(name) for name, _ in (ANGLE, SPEED)]
    found: list[tuple[str, Roll]] = []
    for name in options.logs or (SIMULATED,):
        decoder = Decoder(databases, only)
        if options.simulate:
            decoded, truth_rad = simulated_roll(vehicle, options.seed, decoder)
            click.echo(f"the simulated car's own zero: {truth_rad:+.4f} rad")
        else:
            decoded = _logged(name, options, decoder)
        try:
            roll = roll_of(decoded, vehicle)
        except CalibrationError as error:
            raise CalibrationError(f"{name}: {error}") from error
        if any(roll.fingerprint == other.fingerprint for _, other in found):
            raise CalibrationError(f"{name}: the same roll a second time")
        if roll.fingerprint in vehicle.text:
            raise CalibrationError(
                f"{name}: {options.file} has its zero from this roll already: what the log tells"
                " is the angle before that; roll again with the nodes running the file as it is"
            )
        found.append((name, roll))
    return found


def _logged(name: str, options: CalibrateOptions, decoder: Decoder) -> Decoded:
    from dbw.reading import open_log
    from telemetry.logs.frames import joined

    log = open_log(name)
    decoded = decoder.decode(joined(list(log.between(options.from_s, options.to_s))))
    for line in log.problems.lines():
        click.echo(f"dbw: {name}: {line}", err=True)
    return decoded


def simulated_roll(vehicle: Vehicle, seed: int, decoder: Decoder) -> tuple[Decoded, float]:
    """What the simulated car says on the bus while it rolls, and its sensor's true zero, rad."""
    from simulation.straight_roll import roll_straight
    from telemetry.logs.frames import ChannelNames, FrameFlag, LogFrame, columns_of

    way_m = ROLL_WHEELBASES * vehicle.geometry.wheelbase_m
    world = roll_straight(vehicle, seed, way_m)
    frames = [
        LogFrame(true_ns, "sim", frame.can_id, FrameFlag(0), len(frame.data), frame.data)
        for true_ns, _, frame in world.trace.rows
    ]
    decoded = decoder.decode(columns_of(frames, range(1, len(frames) + 1), ChannelNames()))
    return decoded, world.car.params.sensors.column_angle_zero_rad


def _tell(name: str, zero: Zero, vehicle: Vehicle) -> None:
    ratio = vehicle.steering.ratio
    click.echo(
        f"{name}: {zero.way_m:.1f} m, zero {zero.zero_rad:+.4f} ± {zero.uncertainty_rad:.4f} rad"
        f" of steering wheel ({math.degrees(zero.zero_rad / ratio):+.3f} ±"
        f" {math.degrees(zero.uncertainty_rad / ratio):.3f} deg of road wheel, 95 %)"
    )


def _write(path: Path, zero_rad: float, source: str) -> None:
    """Writes the zero into the file and keeps all else in it.

    Raises:
        VehicleError: It would not be a vehicle file any more.
        UserMistake: It cannot be written.
    """
    from vehicles import parse_vehicle
    from vehicles.writing import replace_text, with_number

    try:
        text = path.read_bytes().decode()
        changed = with_number(text, "steering", "zero_rad", zero_rad, source)
        parse_vehicle(changed, str(path))
        replace_text(path, changed)
    except OSError as error:
        raise UserMistake(f"{path} cannot be written: {error.strerror or error}") from error
