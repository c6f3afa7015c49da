"""`dbw vehicle`: what the nodes believe about a car, checked before anything runs."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from dbw.failures import EXIT_OK, EXIT_USER, complain
from dbw.main import PlainGroup

if TYPE_CHECKING:
    from vehicles import Vehicle

ASSUMPTION = "assumption"
"""How the source of a number begins that nobody has measured or published."""


GRAVITY_MPS2 = 9.80665
"""Standard gravity (ISO 80000-3)."""


@click.group(
    cls=PlainGroup,
    epilog="""\b
Example:
  dbw vehicle check my_car.toml""",
)
def vehicle() -> None:
    """Check vehicle files: what the nodes believe about a car."""


@vehicle.command(
    epilog="""\b
Examples:
  dbw vehicle check my_car.toml
  dbw vehicle check tabby_evo"""
)
@click.argument("file", metavar="FILE.toml|NAME")
def check(file: str) -> int:
    """Name every problem of a vehicle file, or tell what follows from it.

    One line for each problem: file, line, field, value and allowed range. The exit code is 2 if
    there is any.
    """
    from vehicles.reading import read_vehicle, vehicle_text

    found, problems = read_vehicle(vehicle_text(file))
    for problem in problems:
        click.echo(f"{file}:{problem.line}: {problem.text}")
    if found is None:
        complain(f"{file}: {len(problems)} problem{'s' * (len(problems) > 1)}")
        return EXIT_USER
    click.echo(f"{file}: {found.name} can be used")
    for name, value in _consequences(found):
        click.echo(f"  {name:<34} {value}")
    return EXIT_OK


def _consequences(vehicle: Vehicle) -> Iterator[tuple[str, str]]:
    """What a reader would have to work out."""
    sections = [part for part in tomllib.loads(vehicle.text).values() if isinstance(part, dict)]
    sources = [entry["source"] for section in sections for entry in section.values()]
    guesses = sum(source.startswith(ASSUMPTION) for source in sources)
    steering, traction, brake = vehicle.steering, vehicle.traction, vehicle.brake
    yield "entries", f"{len(sources)}, {guesses} of them assumptions"
    road_wheel_deg = math.degrees(steering.wheel_angle_rad_max / steering.ratio)
    yield "road wheel, largest angle", f"{road_wheel_deg:.2f} deg"
    yield "smallest radius", f"{1.0 / vehicle.curvature_per_m_max:.2f} m"
    yield "top speed", f"{3.6 * traction.speed_mps_max:.1f} km/h"
    reverse_kmph = 3.6 * traction.reverse_speed_mps_max
    yield "top speed backwards", f"{reverse_kmph:.1f} km/h" if reverse_kmph else "no reverse"
    yield "longest emergency stop", f"{vehicle.longest_stop_s:.2f} s"
    steepest = min(brake.hold_ratio * brake.deceleration_mps2_full / GRAVITY_MPS2, 1.0)
    yield "steepest slope held at a stop", f"{math.degrees(math.asin(steepest)):.1f} deg"
    yield "brake servo's on-time limit (ER3)", f"{brake.on_time_s_max:g} s"
    age_ms = 1000.0 * vehicle.times.command_timeout_s
    yield "oldest decision ever obeyed (ER5)", f"{age_ms:.0f} ms"
